"""A log that pauses: what is on both sides of the pause is known, what went on within is not."""

import numpy as np
import pytest
from builders import setup_of

from tiltcal.forward.gravity_transport import turns_between
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.replay import replay
from tiltcal.recordings.segmentation import dwells, find_segments
from tiltcal.setup.pauses import pauses

STEP = 0.04  # s
NOISE_DEG = 2e-5


def course(time, moves):
    """Angle and rate, deg and deg/s: smooth moves (start, length, by) one after the other."""
    angle, rate = np.zeros((2, len(time)))
    for start, length, by in moves:
        u = np.clip((time - start) / length, 0, 1)
        angle += by * u**3 * (10 - 15 * u + 6 * u**2)
        rate += by * 30 * u**2 * (1 - u) ** 2 / length
    return angle, rate


def paused(rng, moves, start, end):
    """A replayed readout whose log pauses, its time, and its true rate, deg/s."""
    time = np.arange(0.0, 60.0, STEP)
    time = time[(time < start) | (time > end)]
    angle, rate = course(time, moves)
    columns = {"table_outer_deg": angle + NOISE_DEG * rng.standard_normal(len(time))}
    return replay(Recording.from_columns(time, columns), setup_of("placing")), time, rate


def resumed(time):
    """The first row after the longest interval."""
    return int(np.argmax(np.diff(time))) + 1


MOVES = [(5, 4, 40.0), (15, 4, -30.0), (25, 4, 60.0), (41, 4, 35.0), (50, 4, -50.0)]


@pytest.mark.parametrize(("start", "end"), [(26.5, 43.2), (26.5, 33.0), (22.0, 27.2)])
def test_a_move_that_the_log_interrupts_keeps_its_own_rate(start, end, rng):
    """A polynomial across the pause would bend towards what came after; and the instants at which
    rests end are told by moves whose rows follow them.
    """
    found, time, truth = paused(rng, MOVES, start, end)
    rate = np.degrees(found.drive(time).axes["outer"].v)
    beside = np.abs(np.arange(len(time)) - resumed(time)) < 30
    # one-sided windows of 5 rows tell a rate to a few times noise / step
    assert np.abs(rate - truth)[beside].max() < 30 * NOISE_DEG / STEP
    begun = np.array([begin for begin, *_ in MOVES if not start < begin < end])
    told = found.standstills.end[np.isfinite(found.standstills.end)]
    assert all(np.abs(told - instant).min() < 0.3 for instant in begun)


def test_a_move_within_a_pause_parts_two_stops_and_nothing_moves(rng):
    """The step between the levels is no noise of the readout either: the other moves keep their
    rates.
    """
    found, time, truth = paused(rng, MOVES, 22.0, 32.0)
    rate = np.degrees(found.drive(time).axes["outer"].v)
    assert np.abs(rate - truth).max() < 30 * NOISE_DEG / STEP
    row = resumed(time)
    assert found.stop[row - 1] >= 0
    assert found.stop[row] == found.stop[row - 1] + 1
    assert not found.drive(time).axes["outer"].v[row - 30 : row + 30].any()


def test_a_pause_within_a_rest_leaves_it_one_rest(rng):
    found, time, _ = paused(rng, MOVES, 31.0, 38.0)
    row = resumed(time)
    assert (found.stop[row - 20 : row + 20] == found.stop[row]).all()
    assert found.stop[row] >= 0


def test_missing_rows_are_no_pause():
    time = np.delete(np.arange(0.0, 10.0, STEP), [50, 51, 52, 100])
    assert len(pauses(time)) == 0
    assert len(pauses(time[:1])) == 0


@pytest.mark.parametrize(("turned", "expected"), [(True, 2), (False, 1)])
def test_a_dwell_by_hand_ends_where_a_pause_hides_a_turn(turned, expected, rng):
    time = np.concatenate([np.arange(0, 20, 0.02), np.arange(27, 50, 0.02)])
    later = (time > 25) & turned
    force = np.column_stack([9.8 * later, np.zeros(len(time)), 9.8 * ~later])
    force = force + 1e-3 * rng.standard_normal(force.shape)
    columns = {f"accel_{a}_m_s2": force[:, i] for i, a in enumerate("xyz")}
    assert len(dwells(find_segments(Recording.from_columns(time, columns)))) == expected


def test_no_gyro_carries_gravity_across_a_pause():
    time = np.concatenate([np.arange(0, 4, 0.02), np.arange(9, 20, 0.02)])
    stop = np.where(time < 3, 0, np.where(time < 11, 1, np.where(time < 12, -1, 2)))
    stop[(time > 3) & (time < 3.5)] = -1
    assert [time[first] for first, _ in turns_between(time, stop)] == [
        pytest.approx(3.0, abs=0.03),
        pytest.approx(11.0, abs=0.03),
    ]
    stop = np.where(time < 4, 0, np.where(time < 11, 1, np.where(time < 12, -1, 2)))
    (turn,) = turns_between(time, stop)
    assert time[turn[0]] == pytest.approx(11.0, abs=0.03)
