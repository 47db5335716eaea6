"""What belongs to one finding, and which hypotheses are looked at for a set-up."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_fixtures import bench, honest, recorded, rewritten, shorter

from tiltcal.diagnosis.data_faults.prepare import prepare
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.hypotheses.coordinate_ranges import ranges_of
from tiltcal.diagnosis.hypotheses.curves import curves
from tiltcal.diagnosis.hypotheses.hypothesis import (
    CREEP_TIMES_S,
    listed_hypotheses,
    step_hypotheses,
    steps_at,
)
from tiltcal.diagnosis.hypotheses.instants import Instant
from tiltcal.diagnosis.model.channel_noise import noise_under
from tiltcal.diagnosis.model.finding_tests import ALPHA, finding_log_p_values
from tiltcal.diagnosis.model.fitted_model import FittedTerm
from tiltcal.diagnosis.model.refitting import refit
from tiltcal.effects.spans import CoordinateRanges, SpectralLines
from tiltcal.laboratory.scenario import parse_scenario

SPAN = CoordinateRanges(
    200.0, 10.0, SpectralLines(shakes=(3.4,), ripples=(12,)), {"temperature": (-2.0, 3.0)}
)


def test_every_step_may_set_in_at_once_or_creep():
    found = [s for s in steps_at(honest(bench()), Instant(50.0)) if s.id == "acc_bias_step"]
    assert sorted(s.effect.values.get("creep", 0.0) for s in found) == [0.0, *CREEP_TIMES_S]
    assert all(s.effect.values["time"] == 50.0 for s in found)


def test_what_shakes_the_base_is_a_suspect_at_the_lines_of_the_world():
    found = [s for s in listed_hypotheses(honest(bench()), SPAN) if s.id == "base_vibration"]
    assert [s.effect.values["frequency"] for s in found] == [3.4]


def test_ripples_and_widths_come_from_the_recording():
    hypotheses = list(listed_hypotheses(honest(bench()), SPAN))
    assert any(s.id == "table_encoder_sde" and s.effect.values["lines"] == 12 for s in hypotheses)
    widths = [s.effect.values["width"] for s in hypotheses if s.id == "acc_thermal_hysteresis"]
    np.testing.assert_allclose(sorted(widths), [0.5, 1.0, 1.75, 2.5, 4.0])


def test_known_lines_are_not_looked_at_again():
    new = SpectralLines(tones=(1.0, 5.0), ripples=(12, 36)).without(
        SpectralLines(tones=(5.001,), ripples=(36,)), 0.005
    )
    assert new == SpectralLines(tones=(1.0,), ripples=(12,))


def test_a_slow_effect_that_stood_in_the_noise_of_a_larger_one_is_found_after_it():
    """Beside a drift of the floor a step of one bias is a random walk to the noise that is left."""
    truth = bench(
        {"id": "floor_tilt_drift", "tilt_east_arcsec": 60.0, "tilt_north_arcsec": 20.0},
        {"id": "acc_bias_step", "sensor": "accel", "bias_step_z_ug": 60.0, "time_s": 100.0},
    )
    found = diagnose(honest(truth), [recorded(truth, 1)]).findings
    assert {f.effect for f in found} == {"floor_tilt_drift", "acc_bias_step"}


def test_a_play_that_is_crossed_gradually_keeps_its_name_and_width():
    """With the sign of the last motion in place of the play other laws are needed beside it, or
    another name.
    """
    truth = bench(
        {"id": "table_backlash", "axis": "outer", "width_arcsec": 50.0, "crossing_deg": 40.0}
    )
    (finding,) = diagnose(honest(truth), [recorded(truth, 1)]).findings
    assert finding.effect == "table_backlash"
    width, sigma = finding.parameters["width_arcsec"]
    assert abs(width - 50.0) < 4 * sigma


@pytest.mark.parametrize(
    ("rows", "ends", "good"), [(1, (0,), False), (3, (0, 3), False), (None, (0,), True)]
)
def test_a_step_has_to_show_without_the_samples_next_to_it(rows, ends, good):
    """A few values that are off are two steps that cancel; beside a walk the first of them is half
    of it by itself.
    """
    truth = bench(
        {"id": "acc_noise", "sensor": "accel", "white_ug_rthz": 1.0, "walk_ug_rts": 10.0},
        noise=False,
    )
    sound = recorded(truth, 3)
    x = sound.column("accel_x_m_s2").copy()
    at = 1000
    x[at : at + rows if rows else None] += 10 * np.median(np.abs(np.diff(x)))
    found = prepare(honest(truth), [rewritten(sound, accel_x_m_s2=x)])
    times = [Instant(float(sound.time[at + end] - sound.time[0]) - 0.05) for end in ends]
    steps = [
        s for s in step_hypotheses(found.observations.scenario, times) if s.id == "acc_bias_step"
    ]
    fitted = refit(
        replace(found.start, terms=tuple(FittedTerm.start(s, ("bias_step_x",)) for s in steps)),
        found.whitened,
    )
    noise = [f.model for f in noise_under(fitted, found.whitened.columns)]
    whitened = found.whitened.under(noise)
    fitted = refit(fitted, whitened)
    assert len(fitted.terms) == len(ends)
    assert [
        bool(log_p < np.log(ALPHA)) for log_p in finding_log_p_values(fitted, whitened, 1000)
    ] == [good] * len(ends)


def test_one_value_far_off_is_no_finding():
    truth = bench(
        {"id": "acc_noise", "sensor": "accel", "white_ug_rthz": 1.0, "walk_ug_rts": 10.0},
        noise=False,
    )
    truth = shorter(truth, 5)
    sound = recorded(truth, 3)
    x = sound.column("accel_x_m_s2").copy()
    x[200] += 40 * np.std(np.diff(x)[100:130])
    assert diagnose(honest(truth), [rewritten(sound, accel_x_m_s2=x)]).findings == ()


def coefficients_of(sensor: str) -> set[tuple[str, str, float, str]]:
    """Law, coordinate, power and factor of the readings of a sensor that two things multiply."""
    truth = parse_scenario(
        {
            "schema": 1,
            "name": "three",
            "site": {"gravity_m_s2": 9.81},
            "rig": {"table": "three"},
            "climate": {"start_degC": 22.0, "ramp_degC_h": 20.0},
            "sensor": [
                {"name": "accel", "kind": "accelerometer", "rate_hz": 10.0},
                {"name": "gyro", "kind": "gyro", "rate_hz": 10.0},
            ],
            "sequence": [
                {"action": "move", axis: 80.0, "rate_deg_s": 20.0, "dwell_s": 2.0}
                for axis in ("outer_deg", "middle_deg", "inner_deg")
            ],
        }
    )
    found = prepare(truth, [recorded(truth, 1)])
    span = ranges_of(found.observations, SpectralLines())
    return {
        (h.id, h.effect.coordinate, h.effect.power, h.effect.times)
        for h in curves(found.observations, span)
        if h.effect.sensor == sensor and h.effect.axis == "x" and h.effect.times and h.effect.power
    }


def test_a_product_that_no_name_stands_for_has_none():
    """A gyro's bias may grow with force and temperature, or with two rates; with two forces it is
    the quadratic one that is listed.
    """
    found = coefficients_of("gyro")
    assert ("learned", "force_y", 1.0, "temperature") in found
    assert ("learned", "rate_y", 1.0, "rate_z") in found
    assert ("learned", "input", 1.0, "force_z") in found
    assert ("gyr_g2sens", "force_x", 1.0, "force_y") in found
    assert ("learned", "force_x", 1.0, "force_y") not in found


def test_the_products_and_misalignments_of_the_catalogue_are_offered_once():
    found = coefficients_of("accel")
    assert not any(c.startswith("force") and t.startswith("force") for _, c, _, t in found)
    assert ("learned", "force_y", 1.0, "temperature") not in found
    assert ("learned", "force_y", 1.0, "time") in found
    assert ("learned", "rate_y", 1.0, "temperature") in found
