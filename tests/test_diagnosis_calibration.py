"""What a diagnosis may re-tune before anything is missing physics: the scenario's own effects that
are to be fitted, an unknown heading; and where a curve's harmonics are said to be.
"""

import numpy as np
import pytest
from diagnosis_fixtures import bench, honest, recorded, shorter, turns

from tiltcal.core.errors import TiltcalError
from tiltcal.diagnosis.conclusions.statements import harmonic_of
from tiltcal.diagnosis.data_faults.heading import with_heading
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.hypotheses.hypothesis import adjustable
from tiltcal.effects.learned import LearnedReading
from tiltcal.laboratory.scenario import Scenario, parse_scenario
from tiltcal.statistics.noise_spectrum import WhiteFlickerWalk

K2 = {"id": "acc_K2", "sensor": "accel", "k2_x_ug_g2": 300.0}


def with_effects(scenario: Scenario, *effects: dict) -> Scenario:
    table = scenario.model_dump(exclude={"effect"}, exclude_defaults=True, by_alias=True)
    return parse_scenario({"schema": 1, **table, "effect": list(effects)})


def test_an_effect_that_is_known_roughly_is_fitted_and_is_no_finding():
    truth = shorter(bench(K2), 14)
    known = with_effects(honest(truth), {**K2, "k2_x_ug_g2": 150.0, "fit": True})
    answer = diagnose(known, [recorded(truth, 3)])
    assert answer.verdict == "match"
    (fitted,) = (e for e in answer.amended["effect"] if e["id"] == "acc_K2")
    assert fitted["k2_x_ug_g2"] == pytest.approx(300.0, abs=40.0)
    assert fitted["fit"]
    assert fitted["role"] == "calibration"


def test_an_effect_that_is_adjustable_anyway_is_one_term():
    known = with_effects(bench(), {"id": "acc_bias", "bias_x_ug": 100.0, "fit": True})
    places = [h.place for h in adjustable(known)]
    assert len(places) == len(set(places)) == 3


def test_noise_that_is_to_be_fitted_is_no_term():
    known = with_effects(
        bench(), {"id": "acc_noise", "sensor": "accel", "white_ug_rthz": 25.0, "fit": True}
    )
    assert len(adjustable(known)) == len(adjustable(bench()))


def north_table(heading: object) -> Scenario:
    """A vertical table with a FOG that lies 37 deg off level."""
    return parse_scenario(
        {
            "schema": 1,
            "name": "north",
            "site": {"gravity_m_s2": 9.81, "latitude_deg": 45.0, "heading_deg": heading},
            "rig": {"table": "vertical"},
            "sensor": [
                {
                    "name": "fog",
                    "kind": "fog",
                    "axes": ["a"],
                    "input_axis": [0.8, 0.0, 0.6],
                    "rate_hz": 10.0,
                    "adjustable": ["bias", "scale"],
                }
            ],
            "effect": [{"id": "gyr_noise", "sensor": "fog", "white_deg_rth": 0.02}],
            "sequence": turns(),
        }
    )


@pytest.mark.parametrize("heading", [37.0, 180.0, 251.0])
def test_an_unknown_heading_is_found_and_told(heading):
    recording = recorded(north_table(heading), 4)
    unknown = honest(north_table("unknown"))
    found, (note,) = with_heading(unknown, [recording], WhiteFlickerWalk)
    sigma = float(note.split("+- ")[1].split()[0])
    assert abs(found.site.heading_deg - heading) < 4 * sigma
    assert sigma < 1.0


def test_a_diagnosis_of_an_unknown_heading_uses_it():
    answer = diagnose(honest(north_table("unknown")), [recorded(north_table(180.0), 4)])
    assert not any("magnetic" in str(f.effect) or f.stage == "data" for f in answer.findings)
    assert answer.amended["site"]["heading_deg"] == pytest.approx(180.0, abs=3.0)


def test_a_heading_that_no_sensor_feels_stays_unknown():
    unknown = honest(north_table("unknown"))
    sensors = [s.model_copy(update={"input_axis": (0.0, 0.0, 1.0)}) for s in unknown.sensor]
    level = unknown.model_copy(update={"sensor": tuple(sensors)})
    truth = north_table(37.0)
    upright = [s.model_copy(update={"input_axis": (0.0, 0.0, 1.0)}) for s in truth.sensor]
    recording = recorded(truth.model_copy(update={"sensor": tuple(upright)}), 4)
    assert with_heading(level, [recording], WhiteFlickerWalk) == (level, ())


def test_a_missing_latitude_is_noted():
    """Without it the Earth's rate is found as an error of the FOG."""
    truth = north_table(37.0)
    recording = recorded(truth, 4)
    site = truth.site.model_copy(update={"latitude_deg": None})
    nowhere = truth.model_copy(update={"site": site})
    found, (note,) = with_heading(nowhere, [recording], WhiteFlickerWalk)
    assert found == nowhere
    assert note.startswith("latitude_deg is not stated: the model of fog has no Earth's rate")


def test_unknown_may_be_written_as_the_heading():
    table = north_table(0.0).model_dump(exclude_defaults=True, by_alias=True)
    site = {"gravity_m_s2": 9.81, "latitude_deg": 45.0}
    written = parse_scenario({"schema": 1, **table, "site": {**site, "heading": "unknown"}})
    assert written.site.heading_deg == "unknown"
    with pytest.raises(TiltcalError, match="heading"):
        parse_scenario({"schema": 1, **table, "site": {**site, "heading": 12.0}})


@pytest.mark.parametrize(
    ("axis", "coordinate", "orders"),
    [("x", "table_outer", (5, 0)), ("x", "table_inner", (0, 5)), ("y", "table_outer", (5, 0))],
)
def test_a_harmonic_is_of_the_angle_that_it_follows(axis, coordinate, orders):
    """Not of the sensor's axis that reads it."""
    waves = dict(zip((f"c{k}" for k in range(10)), np.eye(10)[8], strict=True))
    curve = LearnedReading(waves, "accel", axis, coordinate=coordinate)
    assert harmonic_of(curve, bench().rig) == orders
