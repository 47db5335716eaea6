"""The shared memory helpers against slow textbook loops and analytic responses."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tiltcal.effects.hysteresis_and_lag import (
    crossed,
    first_order_lag,
    last_direction,
    motion_direction,
    onset,
    play,
    rounded_play,
    smooth_lag,
)
from tiltcal.setup.trajectory import Jet

WALKS = arrays(float, st.integers(1, 60), elements=st.integers(-6, 6).map(lambda k: k / 2))


def textbook_play(u, width):
    """The play operator one sample after the other (Visintin 1994): the output moves only where it
    is pushed.
    """
    half, output, state = width / 2, u[0], []
    for x in u:
        output = min(max(output, x - half), x + half)
        state.append((x - output) / half)
    return np.array(state)


def textbook_direction(u):
    direction, found = 0.0, []
    for before, now in zip(np.concatenate([u[:1], u[:-1]]), u, strict=True):
        direction = float(np.sign(now - before)) or direction
        found.append(direction)
    return np.array(found)


@settings(deadline=None, max_examples=400, derandomize=True)
@given(u=WALKS, width=st.sampled_from([0.3, 1.0, 2.0, 5.0, 40.0]))
def test_play_is_the_textbook_operator(u, width):
    np.testing.assert_allclose(play(u, width), textbook_play(u, width), atol=1e-13)


@pytest.mark.parametrize("width", [0.01, 1.0, 30.0])
def test_play_holds_on_long_random_walks(width, rng):
    u = np.cumsum(rng.normal(size=5000))
    np.testing.assert_allclose(play(u, width), textbook_play(u, width), atol=1e-9 / width)


@settings(deadline=None, max_examples=400, derandomize=True)
@given(u=WALKS)
def test_the_last_direction_is_kept_over_plateaus(u):
    np.testing.assert_array_equal(last_direction(u), textbook_direction(u))


@settings(deadline=None, derandomize=True)
@given(u=WALKS, width=st.floats(0.1, 10))
def test_play_stays_in_its_gap_and_starts_in_the_middle(u, width):
    state = play(u, width)
    assert np.all(np.abs(state) <= 1 + 1e-12)
    assert state[0] == 0


def test_play_of_no_width_is_the_direction():
    u = np.array([1.0, 1.0, 2.0, 2.0, 0.0])
    np.testing.assert_array_equal(play(u, 0.0), [0, 0, 1, 1, -1])
    assert len(play(np.zeros(0), 1.0)) == 0


def test_play_forgets_a_small_loop_inside_a_large_one():
    """Wiping-out property of Preisach operators: what happens between two equal extremes leaves no
    trace.
    """
    plain = np.array([0.0, 10.0, -10.0, 3.0])
    looped = np.array([0.0, 10.0, 9.0, 10.0, -10.0, 3.0])
    assert play(looped, 4.0)[-1] == play(plain, 4.0)[-1]


def test_rounded_play_is_dahl_s_law():
    """dz/du = 1 - z going up, -1 - z going down, per width: from 0 up by 3, down by 1, up by 2,
    worked by hand.
    """
    width = 2.0
    up = 1 - np.exp(-3 / width)
    down = -1 + (up + 1) * np.exp(-1 / width)
    again = 1 + (down - 1) * np.exp(-2 / width)
    np.testing.assert_allclose(
        rounded_play(np.array([5.0, 8.0, 8.0, 7.0, 9.0]), width),
        [0, up, up, down, again],
        atol=1e-15,
    )
    assert rounded_play(np.array([0.0, 100.0]), width)[-1] == pytest.approx(1.0)


def test_rounded_play_does_not_depend_on_the_samples_between(rng):
    corners = np.cumsum(rng.normal(size=12))
    fine = np.concatenate(
        [np.linspace(a, b, 30, endpoint=False) for a, b in pairwise(corners)] + [corners[-1:]]
    )
    np.testing.assert_allclose(
        rounded_play(fine, 1.3)[::30], rounded_play(corners, 1.3), atol=1e-14
    )


def test_rounded_play_forgets_a_small_loop_only_in_part():
    """No wiping-out property. With x = exp(-1/2), 0 to 2 is 1 - x^4; back by 1/2 at 1 on the way, 1
    - 2 x^3 + 2 x^4 - x^6.
    """
    x = np.exp(-0.5)
    assert rounded_play(np.array([0.0, 1.0, 2.0]), 1.0)[-1] == pytest.approx(1 - x**4)
    assert rounded_play(np.array([0.0, 1.0, 0.5, 1.0, 2.0]), 1.0)[-1] == pytest.approx(
        1 - 2 * x**3 + 2 * x**4 - x**6
    )


def test_rounded_play_without_a_width_or_a_past_is_plain():
    u = np.array([0.0, 1.0, 0.0])
    np.testing.assert_array_equal(rounded_play(u, 0.0), play(u, 0.0))
    assert len(rounded_play(np.zeros(0), 1.0)) == 0


def irregular(rng, n=400):
    return np.cumsum(rng.uniform(0.001, 0.3, n))


@pytest.mark.parametrize("tau", [1e-4, 0.05, 2.0, 500.0])
def test_a_lag_answers_a_ramp_as_the_textbook_says_at_any_stamps(tau, rng):
    time = irregular(rng)
    t = time - time[0]
    np.testing.assert_allclose(
        first_order_lag(time, 1 + 2 * t, tau),
        1 + 2 * (t - tau * -np.expm1(-t / tau)),
        atol=1e-10 * (1 + tau),
    )


def test_a_lag_settles_exponentially_after_a_ramp_that_stops(rng):
    time = np.sort(np.append(irregular(rng), 10.0))
    tau, stop = 0.7, 10.0
    y = first_order_lag(time, np.minimum(time, stop), tau)
    at_stop = y[np.searchsorted(time, stop)]
    late = time >= stop
    np.testing.assert_allclose(
        y[late], stop + (at_stop - stop) * np.exp(-(time[late] - stop) / tau), atol=1e-12
    )


def test_a_lag_delays_a_slow_sine_by_its_phase():
    tau, w = 0.2, 2 * np.pi * 0.5
    time = np.linspace(0, 40, 40001)
    y = first_order_lag(time, np.sin(w * time), tau)
    expected = np.sin(w * time - np.arctan(w * tau)) / np.hypot(1, w * tau)
    # linear between samples: O((w dt)^2)
    np.testing.assert_allclose(y[time > 10], expected[time > 10], atol=(w * 1e-3) ** 2)


def test_further_stamps_on_the_same_lines_change_nothing(rng):
    time = irregular(rng, 60)
    u = np.cumsum(rng.normal(size=60))
    fine = np.union1d(time, rng.uniform(time[0], time[-1], 300))
    y = first_order_lag(fine, np.interp(fine, time, u), 0.4)
    np.testing.assert_allclose(
        y[np.searchsorted(fine, time)], first_order_lag(time, u, 0.4), atol=1e-11
    )


@pytest.mark.parametrize(("tau", "n"), [(0.0, 5), (-1.0, 5), (1.0, 1)])
def test_without_a_time_constant_or_a_past_nothing_lags(tau, n):
    u = np.arange(float(n))
    np.testing.assert_array_equal(first_order_lag(np.arange(float(n)), u, tau), u)


def test_the_direction_of_a_motion_is_not_that_of_its_ringing_end():
    """A differentiated readout swings back by a few per cent where a move ends; the axis did
    not.
    """
    rate = np.concatenate(
        [
            np.zeros(5),
            np.full(20, 0.3),
            [0.05, -0.008, 0.003],
            np.zeros(10),
            np.full(20, -0.01),
            np.zeros(5),
        ]
    )
    direction = motion_direction(Jet(np.cumsum(rate), rate, np.zeros_like(rate)))
    np.testing.assert_array_equal(direction[:5], 0)
    np.testing.assert_array_equal(direction[5:38], 1)
    np.testing.assert_array_equal(direction[38:], -1)


def test_a_step_sets_in_at_its_instant_or_creeps_there():
    elapsed = np.array([0.0, 4.9, 5.0, 15.0, 1e9])
    np.testing.assert_allclose(onset(elapsed, 5.0, 0.0), [0, 0, 1, 1, 1])
    np.testing.assert_allclose(onset(elapsed, 5.0, 10.0), [0, 0, 0, 1 - np.exp(-1), 1])


@pytest.mark.parametrize("tau", [0.0005, 0.003, 0.02, 0.1, 0.6])
def test_a_lag_of_a_smooth_input_is_that_of_a_fine_grid(tau):
    """Against the lag that is linear between samples, on a grid so fine that it does not matter."""
    coarse, fine = np.arange(0, 10, 0.04), np.arange(0, 10, 0.0001)

    def motion(t):
        u = np.clip((t - 2) / 3, 0, 1)
        return u - np.sin(2 * np.pi * u) / (2 * np.pi) + 0.1 * np.sin(3 * t)

    expected = np.interp(coarse, fine, first_order_lag(fine, motion(fine), tau))
    done = motion(coarse) - expected  # what the lag does
    assert (
        np.abs(smooth_lag(coarse, motion(coarse), tau) - expected)[10:].max()
        < 0.01 * np.abs(done).max()
    )


def test_a_lag_of_a_straight_line_is_late_by_its_time_constant():
    time = np.sort(np.random.default_rng(1).uniform(0, 10, 400))
    late = smooth_lag(time, 2.0 + 3.0 * time, 0.05)
    np.testing.assert_allclose(late[time > 2], (2.0 + 3.0 * (time - 0.05))[time > 2], atol=1e-9)
    np.testing.assert_array_equal(smooth_lag(time, time, 0.0), time)


@pytest.mark.parametrize("tau", [0.002, 0.02, 0.15])
def test_a_short_lag_of_a_smooth_motion_is_right_between_coarse_samples(tau):
    """sin(w t) behind 1/(1 + tau s): sin(w t - atan(w tau)) / sqrt(1 + (w tau)^2); a chord's slope
    is half a sample late, 6 %.
    """
    time, w = np.arange(0, 20, 0.04), 3.0
    u = np.sin(w * time)
    late = np.sin(w * time - np.arctan(w * tau)) / np.hypot(1, w * tau) - u
    settled = slice(int(20 * tau / 0.04) + 2, -2)
    found, chord = (
        (law(time, u, tau) - u - late)[settled] for law in (smooth_lag, first_order_lag)
    )
    assert np.abs(found).max() < 0.005 * np.abs(late).max()
    assert tau > 0.1 or np.abs(chord).max() > 3 * np.abs(found).max()


def test_a_slow_start_of_a_motion_is_a_part_of_it():
    """A long soft ramp is slower than a twentieth of its top rate for many samples: the axis has
    turned round all the same.
    """
    rate = np.concatenate(
        [np.full(20, 0.3), np.zeros(10), -(np.linspace(0.001, 1, 40) ** 3), np.zeros(5)]
    )
    direction = motion_direction(Jet(np.cumsum(rate), rate, np.zeros_like(rate)))
    np.testing.assert_array_equal(direction[:30], 1)
    np.testing.assert_array_equal(direction[30:], -1)


def test_a_play_is_crossed_over_its_travel_with_its_own_rate():
    time = np.arange(0, 20, 0.01)
    angle = Jet(np.sin(time), np.cos(time), -np.sin(time))
    side = crossed(angle, 0.5)
    np.testing.assert_array_equal(side.x, play(angle.x, 0.5))
    inside = np.abs(side.x) < 0.95  # a step before it is pushed
    np.testing.assert_allclose(
        np.gradient(side.x, time)[1:-1][inside[1:-1]], side.v[1:-1][inside[1:-1]], atol=1e-2
    )
    assert not side.v[np.abs(side.x) == 1].any()
    at_once = crossed(angle, 0.0)
    np.testing.assert_array_equal(at_once.x, motion_direction(angle))
    assert not at_once.v.any()


def test_a_lag_along_instants_that_go_back_has_no_output():
    """A delay that is tried may grow faster than time."""
    time = np.array([0.0, 0.1, 0.05, 0.2, 0.3])
    assert np.isnan(smooth_lag(time, np.sin(time), 0.01)).all()
