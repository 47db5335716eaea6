"""Forms that a grid of curves is slow to say: a saw by its period and its jump, a memory by its
lag, a law by one number.
"""

import numpy as np
import pytest
from diagnosis_fixtures import bench, honest, recorded, rewritten

from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.hypotheses.curve_forms import curve_over, even_knots
from tiltcal.diagnosis.search.best_shape import RESOLUTIONS, resolutions
from tiltcal.effects.learned import LearnedReading
from tiltcal.effects.spans import CoordinateRanges
from tiltcal.laboratory.scenario import parse_scenario

G = 9.81
WHITE = 25e-6 * G * np.sqrt(10.0 / 2)  # of a sample, m/s2


def saw(angle, period, at):
    """From -1/2 to 1/2, with a jump back at ``at`` and every ``period``."""
    return (angle - at) / period - np.floor((angle - at) / period) - 0.5


@pytest.mark.parametrize(
    ("table", "sensor", "column", "size", "unit"),
    [
        ("dual", "accel", "accel_z_m_s2", 2e-3, 1.0),
        ("vertical", "incl", "incl_x_deg", 0.02, np.radians(1.0) * G),
    ],
)
def test_a_saw_over_an_angle_is_learned_as_a_saw(table, sensor, column, size, unit):
    """Each jump is told to what the table turns from sample to sample, the period by the first and
    the last of them.
    """
    period = np.radians(80.0)
    truth = bench(table=table, sensor=sensor)
    whole = recorded(truth, 5)
    angle = np.radians(whole.column("table_outer_deg"))
    read = whole.column(column) + size * saw(angle, period, np.radians(17.0))
    found = diagnose(honest(truth), [rewritten(whole, **{column: read})])
    assert found.verdict == "unlisted"
    assert [f.where.coordinate for f in found.findings] == ["table_outer"]
    (effect,) = [e for e in found.amended["effect"] if e["id"] == "learned"]
    travel = np.abs(np.diff(angle)).max()
    assert effect["period"] == pytest.approx(period, abs=2 * travel / (np.ptp(angle) / period - 1))
    # of the height of a saw, whose rms is that over the root of 12
    sigma = WHITE * np.sqrt(12 / len(whole))
    assert np.ptp(effect["coefficients"]) == pytest.approx(size * unit, abs=4 * sigma)


def test_a_scale_factor_that_jumps_back_with_the_temperature_repeats_over_it():
    """A laser that hops between its modes: 600 ppm over 0.9 degC, then back. Temperature swings by
    3 degC to either side.
    """
    truth = bench(swing_degC=3.0, period_s=140.0)
    whole = recorded(truth, 5)
    warm = whole.column("temperature_degC")
    column = "accel_z_m_s2"
    read = whole.column(column) * (1 + 6e-4 * saw(warm, 0.9, 22.7))
    found = diagnose(honest(truth), [rewritten(whole, **{column: read})])
    assert found.verdict == "unlisted"
    (finding,) = found.findings
    assert "scale factor of accel z that follows temperature, with a period" in finding.statement
    (effect,) = [e for e in found.amended["effect"] if e["id"] == "learned"]
    assert effect["period"] == pytest.approx(0.9, rel=0.01)


@pytest.mark.xfail(reason="a step and another scale factor say the same, with one shape less")
def test_a_saw_of_which_one_jump_is_seen_goes_before_a_name_of_any_form():
    """A sweep of 110 degrees there and back, teeth of 90: a converter's curve says as much, with
    more numbers.
    """
    steps = [*range(-55, 56, 10), *range(45, -56, -10)]
    sweep = [
        {"action": "move", "outer_deg": float(k), "rate_deg_s": 10.0, "dwell_s": 3.0} for k in steps
    ]
    stand = bench(table="placing", sensor="incl").model_dump(
        exclude={"sequence"}, exclude_defaults=True, by_alias=True
    )
    truth = parse_scenario({"schema": 1, **stand, "sequence": sweep})
    whole = recorded(truth, 5)
    angle = np.radians(whole.column("table_outer_deg"))
    read = whole.column("incl_x_deg") + 0.05 * saw(angle, np.radians(90.0), np.radians(-8.0))
    found = diagnose(honest(truth), [rewritten(whole, incl_x_deg=read)])
    assert [(f.effect, f.where.coordinate, f.axes) for f in found.findings] == [
        (None, "table_outer", ("x",))
    ]
    (effect,) = [e for e in found.amended["effect"] if e["id"] == "learned"]
    assert effect["period"] > np.radians(63.0)  # no further jump in what was swept


def test_a_bump_is_no_saw():
    truth = bench()
    whole = recorded(truth, 5)
    angle = np.radians(whole.column("table_outer_deg"))
    read = whole.column("accel_z_m_s2") + 3e-3 * np.exp(-(((angle - 0.7) / 0.5) ** 2))
    found = diagnose(honest(truth), [rewritten(whole, accel_z_m_s2=read)])
    (effect,) = [e for e in found.amended["effect"] if e["id"] == "learned"]
    assert "period" not in effect
    assert effect["coordinate"] == "table_outer"


def test_a_gimbal_that_another_axis_opens_follows_the_rate_of_that_axis():
    """80 arcsec about the inner axis at 1 rad/s of the outer one, by the square of its rate: both
    axes turn at once, so that the speed of turn tells it less well.
    """
    truth = bench()
    whole = recorded(truth, 5)
    rate = np.gradient(np.radians(whole.column("table_outer_deg")), whole.time)
    opened = np.radians(80 / 3600) * rate**2
    axis = np.eye(3)["xyz".index(dict(truth.rig.axes)["inner"])]
    names = [f"accel_{a}_m_s2" for a in "xyz"]
    force = np.column_stack([whole.column(name) for name in names])
    force = force + opened[:, None] * np.cross(force, axis)
    found = diagnose(honest(truth), [rewritten(whole, **dict(zip(names, force.T, strict=True)))])
    assert found.verdict == "unlisted"
    assert "that follows the rate of the outer angle" in found.findings[0].statement
    assert (len(found.findings), found.findings[0].where.coordinate) == (1, "rate")


def forgotten(u, time, lag):
    """u felt late by a lag, s, from nothing, by the exact step between even samples."""
    keep = np.exp(-np.diff(time, prepend=time[0]) / lag)
    late = np.zeros(len(u))
    for k in range(1, len(u)):
        late[k] = keep[k] * late[k - 1] + (1 - keep[k]) * (u[k] + u[k - 1]) / 2
    return late


def test_a_memory_of_the_rate_is_learned_with_its_lag_and_one_number():
    """12 s lie between lags of the grid, and what is in proportion to the rate needs no curve. Both
    to 3 sigma of a fit of both.

    Sigma from the derivatives of the closed form in white noise, beside a bias.
    """
    truth = bench(table="vertical", sensor="incl")
    whole = recorded(truth, 5)
    size, lag = 0.05, 12.0
    rate = np.gradient(np.radians(whole.column("table_outer_deg")), whole.time)
    late = forgotten(rate, whole.time, lag)
    found = diagnose(
        honest(truth), [rewritten(whole, incl_x_deg=whole.column("incl_x_deg") + size * late)]
    )
    assert (found.verdict, [f.where.coordinate for f in found.findings]) == ("unlisted", ["rate"])
    (effect,) = [e for e in found.amended["effect"] if e["id"] == "learned"]
    assert (effect["power"], effect["odd"], effect["coordinate"]) == (1.0, True, "rate_z")
    slope = (forgotten(rate, whole.time, lag + 0.01) - late) / 0.01
    columns = np.column_stack([late, size * slope, np.ones_like(late)])
    sigma = np.sqrt(np.diag(np.linalg.inv(columns.T @ columns))) * np.degrees(WHITE / G)
    assert effect["lag_s"] == pytest.approx(lag, abs=3 * sigma[1])
    assert effect["coefficients"][0] == pytest.approx(
        np.radians(size) * G, abs=3 * np.radians(sigma[0]) * G
    )


def test_a_step_that_creeps_on_is_one_event_with_one_time_constant():
    """60 % at once and 40 % with 15 s, between time constants of the grid; what a new recording
    finds is their sum.
    """
    event = {"id": "acc_bias_step", "sensor": "accel", "time_s": 100.03}
    truth = bench(
        {**event, "bias_step_y_ug": 1200.0}, {**event, "bias_step_y_ug": 800.0, "creep_s": 15.0}
    )
    found = diagnose(honest(truth), [recorded(truth, 5)])
    steps = [e for e in found.amended["effect"] if e["id"] == "acc_bias_step"]
    assert [f.effect for f in found.findings] == ["acc_bias_step"]
    # a sample
    assert [e["time_s"] for e in steps if "creep_s" not in e] == [pytest.approx(100.03, abs=0.1)]
    assert [e["creep_s"] for e in steps if "creep_s" in e] == [pytest.approx(15.0, rel=0.15)]
    assert sum(e["bias_step_y_ug"] for e in steps) == pytest.approx(2000.0, rel=0.02)


def test_a_cross_axis_term_that_changes_at_an_instant_is_a_step_of_that_term():
    """A correction that is lost: 600 ppm of y in x from then on."""
    truth = bench()
    whole = recorded(truth, 5)
    instant = 0.55 * whole.time[-1]
    lost = 6e-4 * whole.column("accel_y_m_s2") * (whole.time > instant)
    read = whole.column("accel_x_m_s2") + lost
    found = diagnose(honest(truth), [rewritten(whole, accel_x_m_s2=read)])
    assert found.verdict == "unlisted"
    (finding,) = found.findings
    assert finding.axes == ("x",)
    assert "follows time, in proportion to the force along body y" in finding.statement
    (effect,) = [e for e in found.amended["effect"] if e.get("times") and e.get("lasts", True)]
    assert effect["times"] == "force_y"


def test_a_curve_has_a_line_and_other_resolutions_and_each_counts():
    """What is in proportion pays for one number; of a parabola there is no other resolution."""
    curve = curve_over(LearnedReading, "time", (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0), sensor="fog")
    line, *others = resolutions([curve])
    assert (line.names, line.effect.power, line.effect.knots) == (("c0",), 1.0, ())
    assert [len(h.effect.knots) for h in others] == [4, 10, 14, 21]
    assert 2 + len(others) == RESOLUTIONS
    assert not list(resolutions([curve_over(LearnedReading, "time", (0.0, 1.0, 2.0))]))


@pytest.mark.parametrize("reach", [0.0, 4e-15])
def test_there_is_no_curve_over_what_varies_by_rounding_alone(reach):
    span = CoordinateRanges(60.0, 10.0, ranges={"tilt": (9.81, 9.81 + reach), "time": (0.0, 60.0)})
    assert even_knots("tilt", span, 9) == ()
    assert even_knots("time", span, 3) == (0.0, 30.0, 60.0)
