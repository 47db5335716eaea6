"""What a recording is said to hold: how many causes, and under which names.

Many small laws together do what one does, and one law at several shapes is still one.
"""

import numpy as np
import pytest
from diagnosis_fixtures import bench, honest, recorded, rewritten

from tiltcal.diagnosis.conclusions.finding import Diagnosis
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.model.fitted_model import FittedTerm
from tiltcal.diagnosis.search.explanation import possible
from tiltcal.effects import CATALOGUE

K2 = {"id": "acc_K2", "sensor": "accel", "k2_x_ug_g2": 800.0}
STEP = {"id": "acc_bias_step", "sensor": "accel", "bias_step_x_ug": 1500.0, "time_s": 100.0}


def told(*left_out: dict, seed: int = 8, **how) -> Diagnosis:
    """What is said of a recording from which these were left out."""
    truth = bench(*left_out, **how)
    return diagnose(honest(truth), [recorded(truth, seed)])


def told_late(truth, lag) -> Diagnosis:
    """The same where the temperature that is recorded is felt so many seconds late."""
    sound = recorded(truth, 8)
    felt = sound.column("temperature_degC")
    ahead = felt + lag * np.gradient(felt, sound.time)
    return diagnose(honest(truth), [rewritten(sound, temperature_degC=ahead)])


def names_of(found: Diagnosis) -> list[str | None]:
    return sorted(f.effect or "" for f in found.findings)


def hum(size: float, frequency: float) -> dict:
    return {
        "id": "mains_pickup",
        "sensor": "accel",
        "pickup_x_ug": size,
        "frequency_hz": frequency,
    }


def shake(size: float, frequency: float) -> dict:
    return {"id": "base_vibration", "ec_ug": size, "frequency_hz": frequency}


@pytest.mark.parametrize(
    "lines",
    [
        (hum(60.0, 2.0), hum(30.0, 2.03)),
        (hum(60.0, 2.0), hum(30.0, 2.2)),
        (shake(500.0, 3.40), shake(400.0, 3.41)),
    ],
    ids=["nearer than the mains wander", "farther", "two lines of the base"],
)
def test_one_name_at_one_place_is_one_finding(lines):
    found = told(*lines)
    assert names_of(found) == [lines[0]["id"]]


def test_steps_at_two_instants_are_two_findings_and_no_slip_of_the_mount():
    """A slip turns two axes and has two sizes where a step of one bias has one."""
    found = told({**STEP, "time_s": 40.0}, STEP)
    assert names_of(found) == ["acc_bias_step", "acc_bias_step"]
    began = sorted(f.where.interval[0] for f in found.findings)
    assert began == pytest.approx([40.0, 100.0], abs=0.1)


@pytest.mark.parametrize(
    ("id", "name", "value", "good"),
    [
        ("acc_bandwidth", "tau", 5e-3, True),
        ("acc_bandwidth", "tau", -5e-3, False),
        ("table_backlash", "width", 2e-4, True),
        ("table_backlash", "width", -2e-4, False),
        ("data_drop", "samples", 0.02, False),
        ("data_drop", "samples", 0.9, True),
        ("data_drop", "samples", 3.0, True),
    ],
)
def test_a_size_is_one_that_a_file_may_give(id, name, value, good):
    """No time constant or width below nothing, no small part of a sample."""
    law = CATALOGUE[id]
    effect = law({name: 1e-3, "time": 5.0}, "accel" if law.kinds else None, "outer")
    assert possible(FittedTerm(Hypothesis(effect, (name,)), (name,), (value,))) is good


def test_several_laws_are_a_finding_each_with_all_of_their_sizes_and_bring_no_others():
    """Two of the input, one with two sizes, and one of the base."""
    second = {**K2, "k2_y_ug_g2": 400.0}
    found = told(
        second, {"id": "acc_K3", "sensor": "accel", "k3_z_ug_g3": 800.0}, shake(500.0, 3.4)
    )
    assert names_of(found) == ["acc_K2", "acc_K3", "base_vibration"]
    (finding,) = [f for f in found.findings if f.effect == "acc_K2"]
    assert finding.parameters.keys() == {"k2_x_ug_g2", "k2_y_ug_g2"}
    for name, truth in (("k2_x_ug_g2", 800.0), ("k2_y_ug_g2", 400.0)):
        value, sigma = finding.parameters[name]
        assert abs(value - truth) < 4 * sigma


def test_an_odd_quadratic_that_fits_is_no_cubic():
    (finding,) = told({"id": "acc_Koq", "sensor": "accel", "koq_x_ug_g2": 800.0}).findings
    assert finding.names == ("acc_Koq",)


@pytest.mark.parametrize(("seed", "step", "slow"), [(0, 3e-5, []), (1, 3e-4, [""])])
def test_a_random_walk_beside_a_law_is_noise_as_long_as_some_instrument_has_it(seed, step, slow):
    """Some warm-ups and curves would take it; under the noise that is left it is a walk. One of 40
    times what the worst grade has is no noise.
    """
    truth, rng = bench(K2), np.random.default_rng(seed)
    whole = recorded(truth, 8)
    walk = np.cumsum(rng.normal(0, step, len(whole.time)))
    read = rewritten(whole, accel_x_m_s2=whole.column("accel_x_m_s2") + walk)
    assert names_of(diagnose(honest(truth), [read])) == [*slow, "acc_K2"]


def test_small_ripples_of_encoders_are_named_beside_a_curve_of_one():
    """Of the encoder that has the curve, and of that of another axis."""
    found = told(
        {"id": "table_encoder_2rev", "axis": "outer", "cos_arcsec": 40.0},
        *(
            {"id": "table_encoder_sde", "axis": axis, "cos_arcsec": 10.0, "lines": 36.0}
            for axis in ("outer", "inner")
        ),
    )
    assert sorted((f.effect, f.where.coordinate) for f in found.findings) == [
        ("table_encoder_2rev", "table_outer"),
        ("table_encoder_sde", "table_inner"),
        ("table_encoder_sde", "table_outer"),
    ]


@pytest.mark.parametrize(
    ("drift", "table", "sensor"), [("y", "dual", "accel"), ("x", "vertical", "incl")]
)
def test_a_drift_and_a_step_are_two_findings_though_a_step_that_bends_does_the_same(
    drift, table, sensor
):
    """A step with what creeps on after it and a curve follows any drift, with more numbers; each
    keeps its own axis only.
    """
    found = told(
        {"id": "acc_drift", "sensor": sensor, f"drift_{drift}_ug": 1000.0},
        {**STEP, "sensor": sensor},
        table=table,
        sensor=sensor,
    )
    assert {tuple(f.parameters) for f in found.findings} == {
        (f"drift_{drift}_ug",),
        ("bias_step_x_ug",),
    }


@pytest.mark.parametrize(("latency_ms", "count"), [(0.0, 1), (-8.0, 2)])
def test_a_clock_that_is_fast_needs_a_delay_beside_it_only_where_there_is_one(latency_ms, count):
    """A delay does much of what a skew does."""
    found = told(
        {"id": "clock_skew", "sensor": "accel", "skew_ppm": 40.0},
        {"id": "data_latency", "sensor": "accel", "latency_ms": latency_ms},
    )
    assert names_of(found) == ["clock_skew", "data_latency"][:count]


def test_among_equals_a_size_that_some_instrument_has_is_preferred():
    """On a vertical table a thermal tilt of 27 arcsec/degC and a bias of 130 ug/degC read the
    same: the bias is of this world. What is stated first is the most probable.
    """
    (finding,) = told(
        {"id": "acc_temp_bias", "sensor": "incl", "temp_bias_y_ug_degC": 130.0},
        table="vertical",
        sensor="incl",
        swing_degC=6.0,
        period_s=150.0,
    ).findings
    chance = finding.name_probability
    assert {"acc_temp_bias", "mount_thermal_tilt"} <= set(finding.names)
    assert chance["acc_temp_bias"] > chance["mount_thermal_tilt"]
    assert finding.effect == max(chance, key=lambda name: chance[name])


def test_a_reference_that_is_felt_late_is_named_before_scale_factors():
    """One number and one lag do on all axes what scale factors need three numbers for."""
    truth = bench(
        {"id": "reference_drift", "sensor": "accel", "gain_ppm_degC": 60.0},
        swing_degC=6.0,
        period_s=150.0,
    )
    found = told_late(truth, 16.0)
    first = found.findings[0]
    assert first.effect == "reference_drift"
    assert first.parameters["gain_ppm_degC"][0] == pytest.approx(60.0, rel=0.05)
    (lag,) = [e["lag_s"] for e in found.amended["effect"] if e["id"] == "reference_drift"]
    assert lag == pytest.approx(16.0, rel=0.15)


def test_an_axis_direction_that_feels_the_temperature_late_keeps_its_name():
    truth = bench(
        {"id": "acc_temp_misalign", "sensor": "accel", "temp_cross_xy_ppm_degC": 40.0},
        swing_degC=6.0,
        period_s=150.0,
    )
    (finding,) = told_late(truth, 14.0).findings
    assert finding.effect == "acc_temp_misalign"
    assert "unlisted" not in finding.names
    assert "No curve over temperature alone explains it" in finding.statement
