"""Rates of a readout that is only read in angle."""

import numpy as np
import pytest

from tiltcal.recordings import rest_edges
from tiltcal.recordings.differentiation import differentiate
from tiltcal.recordings.starting_courses import side_of

NOISE = 3e-7  # rad, of the readout
STEP = 0.02  # s


def test_differentiation_of_a_readout_is_smooth_and_zero_at_rest():
    time = np.linspace(0, 10, 1001)
    v, a, *_ = differentiate(time, np.sin(time), np.zeros(1001, bool))
    np.testing.assert_allclose(v[20:-20], np.cos(time)[20:-20], atol=1e-5)
    np.testing.assert_allclose(a[20:-20], -np.sin(time)[20:-20], atol=1e-3)
    assert not differentiate(time, np.sin(time), np.ones(1001, bool))[0].any()
    assert not differentiate(time[:5], time[:5], np.zeros(5, bool))[0].any()


def test_a_few_rows_of_a_motion_between_two_pauses_tell_no_rate():
    """Seven rows: their rate has the error of any rate, which no reading can be blamed for."""
    time = np.concatenate([np.arange(500), np.arange(600, 607), np.arange(700, 1200)]) * STEP
    angle = 0.3 * np.sin(time)
    parted = np.array([500, 507])
    found = differentiate(time, angle, np.zeros(len(time), bool), parted)
    few = slice(500, 507)
    assert np.abs(found.rate[few] - 0.3 * np.cos(time[few])).max() < found.noise[few].min()
    assert found.acceleration_noise[few].min() > 1.0
    others = np.r_[20:480, 527:980]
    np.testing.assert_allclose(found.rate[others], 0.3 * np.cos(time[others]), atol=1e-5)
    assert found.noise[others].max() < 1e-3


@pytest.mark.parametrize("corner", [0.0, 0.3])
def test_a_rate_is_told_on_its_own_side_of_a_corner(corner, rng):
    """Beside a jump of the acceleration a window around the sample blurs it; one on its own side
    does not.
    """
    time = np.arange(0, 20, STEP)
    at = np.where(time < 10, time - 10, corner * (time - 10))
    angle, truth = 0.05 * at**2, 0.1 * at * np.where(time < 10, 1, corner)
    resting = np.arange(len(time)) < 60  # where the readout's noise is taken from
    level = np.where(np.arange(len(time)) < 60, angle[0], angle)
    v, *_ = differentiate(time, level + NOISE * rng.standard_normal(len(time)), resting)
    near = slice(480, 520)
    # no worse than one difference of readings: 15 at one side
    assert np.abs(v - truth)[near].max() < 4 * 0.97 * NOISE / STEP


def moves(time, start, jerk=0.4, long=1.2):
    """Angle and rate of an axis that rests, goes by a smooth move from ``start`` on, and rests
    again.
    """
    u = np.clip((time - start) / long, 0, 1)
    # rate jerk long2 u2 (1 - u)2: zero with a bend at both ends
    angle = jerk * long**3 * (u**3 / 3 - u**4 / 2 + u**5 / 5)
    return angle, jerk * long**2 * u**2 * (1 - u) ** 2


@pytest.mark.parametrize("start", [2.0031, 2.0093, 2.0188])
@pytest.mark.parametrize("turned", [False, True])
def test_beside_a_rest_a_rate_is_as_good_as_inside_a_move(start, turned, rng):
    """A window across the instant at which an axis sets out rings by per cents of its first
    rates.
    """
    time = np.arange(0, 6, STEP)
    at = np.maximum(time - start, 0.0)
    # a step of the acceleration
    angle, truth = (
        0.05 * at**2 + 0.01 * at**3,
        0.1 * at + 0.03 * at**2,
    )
    if turned:
        angle, truth = angle[::-1], -truth[::-1]
    still = angle == angle.min()
    v, *_ = differentiate(time, angle + NOISE * rng.standard_normal(len(time)), still)
    near = np.abs(time - (time[-1] - start if turned else start)) < 5 * STEP
    assert np.abs(v - truth)[near].max() < 5 * NOISE / STEP
    assert not v[still & (np.abs(time - (time[-1] - start if turned else start)) > 2 * STEP)].any()


def test_samples_that_hide_in_a_rest_have_the_rate_with_which_the_axis_set_out(rng):
    """A move that begins slowly is taken for rest while its angle is within the readout's noise."""
    time = np.arange(0, 6, STEP)
    angle, truth = moves(time, 2.007)
    still = (angle < 6 * NOISE) | (angle > angle.max() - 6 * NOISE)
    v, *_ = differentiate(time, angle + NOISE * rng.standard_normal(len(time)), still)
    assert np.abs(truth[still]).max() > 4 * NOISE / STEP
    assert np.abs(v - truth)[still].max() < 2 * NOISE / STEP


@pytest.mark.parametrize("tick", [0.0, 1e-4])
def test_few_samples_of_a_fast_move_tell_how_it_sets_out(tick, rng):
    """Twelve samples of a move without a jump of the acceleration; its stamps scatter, and may be
    rounded.
    """
    time = np.arange(200) / 12.5 + rng.normal(0, 8e-4, 200)
    angle, truth = moves(time, 6.03, jerk=12.0, long=1.0)
    still = (angle == 0) | (angle == angle.max())
    stamps = np.rint(time / tick) * tick if tick else time
    v, *_ = differentiate(stamps, angle + NOISE * rng.standard_normal(200), still)
    begins = np.flatnonzero(~still)[0] + np.arange(-2, 3)
    narrow = 12.5 * np.hypot(NOISE, tick / np.sqrt(12) * truth)
    # by powers from the square on 350 and 180 times as much
    assert (np.abs(v - truth)[begins] < 2 * narrow[begins] + 2 * 12.5 * NOISE).all()


@pytest.mark.parametrize("tick", [0.0, 1e-4])
def test_few_samples_tell_how_a_steady_turn_ends(tick, rng):
    """A turn of 30 deg/s that a cosine of one second brings to rest, twelve samples a second."""
    time = np.arange(400) / 12.5 + rng.normal(0, 8e-4, 400)
    u = np.clip(time - 16.03, 0, 1)
    begun = np.minimum(time, 16.03)
    angle = np.radians(30) * (begun + (u + np.sin(np.pi * u) / np.pi) / 2)
    truth = np.radians(30) * (1 + np.cos(np.pi * u)) / 2
    stamps = np.rint(time / tick) * tick if tick else time
    still = u == 1
    v, *_ = differentiate(stamps, angle + NOISE * rng.standard_normal(400), still)
    ends = np.flatnonzero(u > 0)[0] + np.arange(-3, 3)
    narrow = 12.5 * np.hypot(NOISE, tick / np.sqrt(12) * truth)
    # by windows on one side of the corner 140 and 4
    assert (np.abs(v - truth)[ends] < 3 * narrow[ends]).all()


def test_stamps_that_jitter_leave_the_rates_of_a_swing_alone(rng):
    time = np.arange(0, 20, STEP) + STEP * rng.uniform(-0.3, 0.3, 1000)
    angle, truth = 0.3 * np.sin(4 * time), 1.2 * np.cos(4 * time)
    v, *_ = differentiate(
        time, angle + NOISE * rng.standard_normal(len(time)), np.zeros(len(time), bool)
    )
    # on straight lines between the rows: 33
    assert np.std((v - truth)[20:-20]) < 0.6 * NOISE / STEP


def test_a_fast_swing_is_told_by_a_longer_window_of_a_higher_degree(rng):
    time = np.arange(0, 20, STEP)
    angle, truth = 0.3 * np.sin(9 * time), 2.7 * np.cos(9 * time)
    v, *_ = differentiate(
        time, angle + NOISE * rng.standard_normal(len(time)), np.zeros(len(time), bool)
    )
    assert np.std((v - truth)[20:-20]) < 1.5 * NOISE / STEP  # by quartics alone: 4.6


def test_rounded_stamps_ask_for_longer_windows(rng):
    """The instants scatter and their stamps are rounded: of a fast turn that is as much as noise of
    the readout.
    """
    true = np.arange(1500) / 50 + rng.normal(0, 5e-4, 1500)
    rate = 1.2 * np.sin(0.4 * true) ** 2
    angle = 0.6 * true - 0.75 * np.sin(0.8 * true) + rng.normal(0, 4e-7, 1500)
    tick = 2.0**-14
    v, *_ = differentiate(np.rint(true / tick) * tick, angle, np.zeros(1500, bool))
    narrow = tick / np.sqrt(12) * 50 * np.sqrt(2) * rate.max()
    assert np.std((v - rate)[30:-30]) < narrow / 4  # with the noise of the readout alone: 0.35


@pytest.mark.parametrize("turned", [False, True])
def test_a_log_that_ends_under_way_tells_its_last_rates(turned, rng):
    """No window is around the last rows, and of some logs no one-sided window fits well either:
    then the narrowest one is taken, and its noise told. Sixty logs of a swing of 0.2 rad.
    """
    beyond = []
    for _ in range(60):
        time = np.arange(0, 8, 1 / 16)
        swing = 1.3 * np.maximum(time - 6.03, 0)
        angle, rate, bend = 0.2 * (1 - np.cos(swing)), 0.26 * np.sin(swing), 0.338 * np.cos(swing)
        read, still = angle + NOISE * rng.standard_normal(len(time)), angle == 0
        if turned:
            read, rate, bend, still = read[::-1], -rate[::-1], bend[::-1], still[::-1]
        v, a, noise, other = differentiate(time, read, still)
        last = slice(0, 2) if turned else slice(-2, None)
        beyond += list(np.abs(v - rate)[last] / noise[last])
        beyond += list(np.abs(a - bend)[last] / other[last])
    assert max(beyond) < 5.0
    assert np.mean(np.square(beyond)) < 1.5


@pytest.mark.parametrize("tick", [0.0, 1e-4])
def test_the_noise_of_a_rate_is_what_it_is_off_by(tick, rng):
    """Of a turn with ramps and of a swing, with stamps that scatter and may be rounded: the means
    over 16 rows, in which the errors that overlapping windows share are left.
    """
    time = np.arange(3000) / 20 + rng.normal(0, 8e-4, 3000)
    u, begun = np.clip(time - 40.03, 0, 1), np.minimum(time, 40.03)
    swing = np.maximum(time - 60, 0)
    # the swing sets out without a jump of its rate
    angle = np.radians(30) * (begun + (u + np.sin(np.pi * u) / np.pi) / 2) + 0.2 * (
        1 - np.cos(3 * swing)
    )
    truth = np.radians(30) * (1 + np.cos(np.pi * u)) / 2 + 0.6 * np.sin(3 * swing)
    still = (time > 41.1) & (time < 60)
    stamps = np.rint(time / tick) * tick if tick else time
    v, _, noise, _ = differentiate(stamps, angle + NOISE * rng.standard_normal(3000), still)
    assert np.mean(noise[still] > 0) < 0.01  # three sigma of rates that are none
    for part in (time < 39, (time > 62) & (time < 148)):
        off = ((v - truth)[part] / noise[part])[: part.sum() // 16 * 16].reshape(-1, 16)
        assert 0.3 < 4 * np.std(off.mean(axis=1)) < 1.4


def move(time, begin, lasts, turned):
    """A smooth move: its angle, rate and acceleration (powers 4 to 7 of the time), (n,) each."""
    u = np.clip((time - begin) / lasts, 0, 1)
    x = u**4 * (35 - 84 * u + 70 * u**2 - 20 * u**3)
    v, a = 140 * (u * (1 - u)) ** 3, 420 * (u * (1 - u)) ** 2 * (1 - 2 * u)
    return turned * x, turned * v / lasts, turned * a / lasts**2


def test_between_even_times_an_acceleration_keeps_its_peak(rng):
    """Short moves at 30 Hz, stamps that scatter by 2 % of a step: a line between even times cuts a
    thousandth off the peaks of the acceleration, which the lever arm of a sensor would show.
    """
    count = 40 * 120
    time = (np.arange(count) + rng.uniform(-0.02, 0.02, count)) / 30.0
    moves = [move(time, 2.51 + 4 * k, 1.3, 0.17 * (-1) ** k) for k in range(40)]
    angle, _, truth = (sum(part) for part in zip(*moves, strict=True))
    still = truth == 0
    _, a, _, noise = differentiate(time, angle + NOISE * rng.standard_normal(count), still)
    off = (a - truth)[~still]
    assert abs(off @ truth[~still] / (truth @ truth)) < 2e-4  # by a line 2e-3
    assert np.std(off) < 1.5 * np.sqrt(np.mean(noise[~still] ** 2))


@pytest.mark.parametrize("power", [2, 3, 4], ids=["at once", "soon", "late"])
def test_the_law_of_a_start_is_that_which_fits_furthest_of_all_windows(power, rng):
    """Of a rate of (u (1 - u))^(p - 1); windows and laws that cannot win are not tried."""
    begins = np.array([2.0031, 6.0093, 10.0188])
    time, long = np.arange(0, 14, STEP), 2.4
    u = np.clip((time[:, None] - begins) / long, 0, 1)
    rate = np.polynomial.Polynomial([0, 1, -1]) ** (power - 1)
    angle = rate.integ()(u).sum(axis=1) + NOISE * rng.standard_normal(len(time))
    still = ~((time[:, None] > begins - 0.05) & (time[:, None] < begins + long + 0.05)).any(axis=1)
    noise = np.full(len(time), NOISE)
    side = side_of(time / STEP, angle, still, np.zeros(len(time), bool), noise)
    trials = []
    for law in rest_edges.STARTS:
        reach, when = np.zeros(3), np.full(3, np.nan)
        for width in rest_edges.REACHES:
            reach[rest_edges._fit_window(side, np.ones(3, bool), width, law, when)] = width
        trials.append((reach.sum(), when))
    total, expected = max(trials, key=lambda trial: trial[0])
    leaves, _ = rest_edges.edges(time / STEP, angle, still, noise)
    told = ~np.isnan(expected)
    assert total > 0
    np.testing.assert_array_equal(leaves[told], expected[told])


def test_beside_a_jump_an_acceleration_is_as_uncertain_as_the_jump(rng):
    """An instrument takes a while: there anything between is read."""
    jump, start = 0.5, 2.0 + 0.2 * STEP
    time = np.arange(0, 6, STEP)
    angle = jump / 2 * np.maximum(time - start, 0.0) ** 2
    resting = time < 1.95
    noisy = angle + NOISE * rng.standard_normal(len(time))
    *_, noise = differentiate(time, noisy, resting)
    beside = np.abs(time - start) < 0.5 * STEP
    assert beside.sum() == 1
    assert noise[beside].min() > jump / 3
    assert noise[time > start + 5 * STEP].max() < jump / 20


def test_what_rings_at_rest_is_as_uncertain_as_its_rates(rng):
    """A rest is a rest although an axis still rings there; its readout tells by how much."""
    time = np.arange(0, 8, STEP / 4)
    since = np.maximum(time - 4.0, 0.0)
    ring = 2e-5 * np.exp(-since / 0.3) * np.sin(30 * since)
    angle = np.where(time < 4, 0.1 * (time - 4), 0.0) + ring
    angle += 1e-7 * rng.standard_normal(len(time))
    truth = np.gradient(np.gradient(ring, time), time)
    still = time >= 4
    v, a, _, noise = differentiate(time, angle, still)
    assert not v[still].any()
    assert not a[still].any()
    rings = (time > 4.05) & (time < 4.5)
    told, size = noise[rings], truth[rings]
    assert 0.3 < np.sqrt(np.mean(size**2) / np.mean(told**2)) < 1.5
    assert np.mean(noise[time > 6.5] > 0) < 0.01


def test_the_noise_of_a_rate_says_how_far_a_few_samples_of_a_ramp_are_off():
    """A ramp within ten samples of a readout without noise: no polynomial fits it, and the
    narrowest one is off by what it bends beyond; so is the line of the turn after it, a little.
    """
    step = 0.04
    time = np.arange(0, 20, step)
    u = np.clip((time - 8.0) / 0.4, 0, 1)
    rate = 0.7 * u**2 * (3 - 2 * u)
    ramp = 0.4 * 0.7 * (u**3 - u**4 / 2)
    angle = ramp + 0.7 * np.maximum(time - 8.4, 0.0)
    found = differentiate(time, angle, time < 8.0)
    off = np.abs(found.rate - rate)
    assert off.max() > 1e-3
    assert (off < 2 * found.noise + 1e-12).all()


def test_where_a_motion_begins_between_samples_every_row_near_by_is_uncertain():
    """The window that bends over the instant has its error at more than one row, and at one of
    them the rates around it may agree by chance with an acceleration that is off.
    """
    draw = np.random.default_rng(1)
    time, ramp = np.arange(0, 6, STEP), 0.4
    for _ in range(400):
        start, lasts = 2 + draw.uniform(0, STEP), draw.uniform(ramp, 1.5)
        rate = draw.uniform(0.2, 1.0)
        up, down = (time - start) / ramp, (time - start - lasts) / ramp
        a, b = np.clip(up, 0, 1), np.clip(down, 0, 1)
        # the rate goes up and down by u2 (3 - 2 u)
        angle = a**3 * (1 - a / 2) + np.maximum(up - 1, 0) - b**3 * (1 - b / 2)
        angle = rate * ramp * (angle - np.maximum(down - 1, 0))
        truth = rate * 6 / ramp * (a * (1 - a) - b * (1 - b))
        still = (time < start) | (time > start + lasts + ramp)
        # read to 0.0001 deg
        read = np.radians(np.round(np.degrees(angle), 4))
        found = differentiate(time, read, still)
        off = np.abs(found.acceleration - truth)[~still]
        # beyond what a reading of 1 mm/s2 at 0.1 m shows
        assert np.all(off < 5 * np.hypot(0.01, found.acceleration_noise[~still]))


@pytest.mark.parametrize("step", [0.04, 0.02])
def test_where_a_ramp_ends_in_a_turn_rates_are_as_uncertain_as_they_are_off(step):
    """Of a readout that is written as it was commanded long windows have hardly any noise, and
    each tells a rate to the next sample: a fibre-optic gyro sees what they are off there.
    """
    draw = np.random.default_rng(2)
    time, ramp = np.arange(0, 8, step), 0.4
    worst = []
    for _ in range(200):
        start, rate, lasts = 2 + draw.uniform(0, step), draw.uniform(0.2, 1.2), draw.uniform(1, 3)
        t, end = time - start, lasts + ramp
        u = np.clip(np.where(t > end / 2, end - t, t) / ramp, 0, None)
        rising = np.minimum(u, 1.0)
        bend = (np.cos(2 * np.pi * rising) - 1) / (4 * np.pi**2)
        gone = rate * ramp * np.where(u < 1, rising**2 / 2 + bend, u - 0.5)
        angle = np.where(t > end / 2, rate * lasts - gone, gone)
        truth = rate * np.where(u < 1, rising - np.sin(2 * np.pi * rising) / (2 * np.pi), 1.0)
        truth = np.where((t < 0) | (t > end), 0.0, truth)
        still = (t <= 0) | (t >= end)
        read = np.radians(np.round(np.degrees(angle), 9))
        found = differentiate(time, read, still)
        off = np.abs(found.rate - truth)[~still]
        # beyond 0.02 deg/h
        worst.append((off / np.hypot(1e-7, found.noise[~still])).max())
    assert np.max(worst) < 6
    assert np.median(worst) < 3
