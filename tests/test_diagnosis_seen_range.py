"""How far a learned curve was seen."""

from dataclasses import replace

import numpy as np
import pytest
from builders import effect_of
from diagnosis_fixtures import bench, honest, recorded

from tiltcal.core.units import G0
from tiltcal.diagnosis.conclusions.concluding import _beyond_seen
from tiltcal.diagnosis.conclusions.seen_range import seen_range
from tiltcal.diagnosis.data_faults.prepare import prepare
from tiltcal.diagnosis.hypotheses.coordinate_ranges import over_felt, range_felt_late, ranges_of
from tiltcal.diagnosis.hypotheses.motion_curves import motion_of_readings
from tiltcal.effects.hysteresis_and_lag import first_order_lag
from tiltcal.effects.learned import LearnedReading
from tiltcal.effects.spans import SpectralLines
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import parse_scenario

KNOTS = (-1.0, 0.0, 1.0)
CURVE = LearnedReading({"c0": 1.0, "c1": 0.0}, "accel", "x", "found")


@pytest.fixture(scope="module")
def run():
    truth = bench()
    whole = recorded(truth, 3)
    return whole, prepare(honest(truth), [whole]).observations


@pytest.mark.parametrize(
    ("coordinate", "knots", "unit", "beyond"),
    [
        ("table_outer", (0.0, 1.0), "deg", "holds"),
        ("temperature", (0.0, 1.0), "degC", "continues"),
        ("time", (0.0, 1.0), "s", "left_out"),
        ("moves", (0.0, 1.0), "moves", "left_out"),
        ("input", (0.0, 1.0), "g", "holds"),
        ("rate_x", (), "deg_s", "repeats"),
    ],
)
def test_a_curve_says_where_it_was_seen(run, coordinate, knots, unit, beyond):
    whole, observations = run
    effect = LearnedReading(CURVE.values, "accel", "x", "found", coordinate=coordinate, knots=knots)
    seen = seen_range(effect, observations)
    assert (seen.unit, seen.beyond) == (unit, beyond)
    if coordinate == "table_outer":
        angle = whole.column("table_outer_deg")
        assert (seen.low, seen.high) == pytest.approx((np.nanmin(angle), np.nanmax(angle)))
    if coordinate == "time":
        assert (seen.low, seen.high) == pytest.approx((0.0, np.ptp(whole.time)))
    assert ("holds its last value" in seen.words) == (beyond == "holds")
    assert ("only its mean is predicted" in seen.words) == (beyond == "left_out")
    assert f"to {seen.high:.0f}" in seen.words or seen.high < 10


def test_a_late_rate_was_seen_as_far_as_it_was_felt(run):
    """A move that is short beside the memory is felt as a part of its rate."""
    _, observations = run
    raw, late = (
        LearnedReading(CURVE.values, "accel", "x", coordinate="rate_x", knots=KNOTS, lag=lag)
        for lag in (0.0, 8.0)
    )
    (watch,) = observations.watches(())
    sense = watch.sense["accel"]
    felt = np.degrees(first_order_lag(sense.time, sense.rate[:, 0], 8.0))
    seen = seen_range(late, observations)
    assert (seen.low, seen.high) == pytest.approx((-np.abs(felt).max(), np.abs(felt).max()))
    assert seen.high < 0.6 * seen_range(raw, observations).high


def test_the_knots_of_a_late_rate_are_over_what_was_felt(run):
    """Beyond them a curve holds its last value: further out they would be a guess."""
    _, observations = run
    span = ranges_of(observations, SpectralLines())
    sensor = observations.scenario.named("accel")
    rig = observations.scenario.rig
    late = [
        h
        for h in motion_of_readings(rig, sensor, "x", ("rate_x",), span)
        if h.effect.coordinate == "rate_x" and h.effect.lag and h.effect.knots
    ]
    assert late
    for h in late:
        felt = range_felt_late("rate_x", h.effect.lag, observations)
        assert (h.effect.knots[0], h.effect.knots[-1]) == pytest.approx(felt)
        other = over_felt(replace(h, effect=replace(h.effect, lag=2.0)), observations)
        assert other.effect.knots[-1] == pytest.approx(
            range_felt_late("rate_x", 2.0, observations)[1]
        )
        assert len(other.effect.knots) == len(h.effect.knots)


def test_a_course_of_time_that_two_recordings_show_is_one_that_repeats(run):
    whole, alone = run
    both = prepare(alone.scenario, [whole, recorded(bench(), 4)]).observations
    effect = LearnedReading(CURVE.values, "accel", "x", coordinate="time", knots=(0.0, 1.0))
    assert seen_range(effect, both).beyond == "holds"


def test_a_product_of_two_angles_has_no_range(run):
    effect = LearnedReading(
        CURVE.values, "accel", "x", "found", coordinate="table_outer", beside="table_inner"
    )
    assert seen_range(effect, run[1]) is None


def test_a_sawtooth_repeats(run):
    effect = LearnedReading(
        CURVE.values, "accel", "x", "found", coordinate="table_outer", knots=(0.0, 1.0), period=1.0
    )
    assert seen_range(effect, run[1]).beyond == "repeats"


def test_beyond_what_was_seen_a_textbook_form_goes_on_and_what_completes_it_holds():
    """A curve that is the law itself, or that follows no temperature, is left as it is."""
    form = effect_of("acc_temp_bias", bench(), "accel", temp_bias_x_ug_degC=20.0)
    warm, turned = (
        LearnedReading(CURVE.values, "accel", "x", "found", coordinate=c, knots=(0.0, 1.0))
        for c in ("temperature", "table_outer")
    )
    kept, held, same = _beyond_seen([form, warm, turned])
    assert (kept, same) == (form, turned)
    assert held == replace(warm, holds=True)
    assert _beyond_seen([warm, turned]) == [warm, turned]


def test_the_input_of_an_inclinometer_is_the_force_that_tilts_it():
    """It reads an angle, and feels g times its sine: 30 deg are g / 2."""
    sensor = {"name": "incl", "kind": "inclinometer", "rate_hz": 10, "axes": ["x", "y"]}
    tilts = (0, 30, -30)
    table = {
        "schema": 1,
        "site": {"gravity_m_s2": 9.81},
        "rig": {"table": "dual"},
        "sensor": [sensor],
        "sequence": [
            {"action": "move", "outer_deg": tilt, "rate_deg_s": 30, "dwell_s": 2} for tilt in tilts
        ],
    }
    told = parse_scenario(table)
    observations = prepare(told, [SimulatedLaboratory().record(told)]).observations
    curve = LearnedReading(CURVE.values, "incl", "x", coordinate="input", knots=KNOTS)
    seen = seen_range(curve, observations)
    half = 0.5 * 9.81 / G0
    assert (seen.low, seen.high, seen.unit) == (pytest.approx(-half), pytest.approx(half), "g")
