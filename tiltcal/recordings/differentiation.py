"""Rate and acceleration of a readout: by the local polynomials that its noise allows, and beside a
rest by the motion out of it.
"""

from typing import NamedTuple

import numpy as np

from tiltcal.core.arrays import NOWHERE, Array, Index, Mask
from tiltcal.recordings.polynomial_windows import WIDTHS, by_best_windows, fits
from tiltcal.recordings.readout_noise import noise_of_motion, noise_of_rests, noise_of_stamps
from tiltcal.recordings.rest_edges import LOOSE, corners
from tiltcal.recordings.starting_courses import TURN
from tiltcal.setup.pauses import stretches

FEWEST = 9  # rows that a motion is told from
UNKNOWN = 2 * np.pi  # rad/s and rad/s2, of a motion that no rows tell
LINE = 13  # samples in which a line shows that it is one
SHARED = 3.4  # rows that tell as much of a slow course as one: the windows of rates overlap
CHOSEN = 1.5  # times a rate is off by what its window expects: the least of many was taken
RINGS = 9.0  # times its expected square that a rate at rest is motion


class Rates(NamedTuple):
    """Rate and acceleration of a readout, rad/s and rad/s2, and the noise of both, (n,) each: the
    standard deviation of white noise that hides as much of a slow course.
    """

    rate: Array
    acceleration: Array
    noise: Array
    acceleration_noise: Array


def differentiate(time: Array, angle: Array, still: Mask, parted: Index = NOWHERE) -> Rates:
    """Rate and acceleration of a readout, exactly zero at rest, and the noise of both.

    Each sample has the window, around it or to one side of it, whose polynomial leaves no more than
    the noise of readout and stamps and tells the rate best: long in steady turns, short where moves
    bend, and on its own side of a corner. Where an axis leaves its rest and where it comes to one,
    the rate begins at zero. No window reaches across a pause of the log; between two pauses fewer
    than FEWEST rows of a motion tell no rate.

    Args:
        time: s, increasing, (n,). angle: rad, (n,).
        still: rows at which the axis rests, (n,).
        parted: first rows after pauses of the log.
    """
    found = Rates(*np.zeros((4, len(angle))))
    readout = noise_of_rests(angle, still, parted)
    for rows in stretches(len(time), parted):
        part = _of_stretch(time[rows], angle[rows], still[rows], readout)
        for whole, values in zip(found, part, strict=True):
            whole[rows] = values
    return found


def noise_of_stamped(time: Array, angle: Array, still: Mask, parted: Index = NOWHERE) -> Array:
    """Standard deviation of an angle at each stamp, rad, (n,): of the readout, and of the stamp
    times the rate; empty if the axis hardly rests.

    Args:
        time, angle, still, parted: as in ``differentiate``.
    """
    readout = noise_of_rests(angle, still, parted)
    if readout is None:
        return np.zeros(0)
    found = np.full(len(time), readout)
    for rows in stretches(len(time), parted):
        if (even := _evenly(time[rows], angle[rows])) is not None:
            late = noise_of_stamps(even[1], _pace(even[1]), readout)
            found[rows] = _with_stamps(readout, late, even[0], time[rows], angle[rows])
    return found


def _with_stamps(readout: float, late: float, grid: Array, time: Array, angle: Array) -> Array:
    """Noise of an angle at each stamp, rad, (n,). late: of the stamps, in steps of the grid."""
    step = float(grid[1] - grid[0])
    exact = float(np.spacing(np.abs(angle).max()))  # of a readout without noise
    return np.asarray(np.hypot(max(readout, exact), late * step * np.gradient(angle, time)))


def _evenly(time: Array, angle: Array) -> tuple[Array, Array] | None:
    """Even times over a stretch, s, and its angle there; None of one that does not move, or of a
    log of dwells with nothing between them.
    """
    from scipy.interpolate import CubicSpline

    if len(time) < FEWEST or np.ptp(angle) == 0:
        return None
    dt = float(np.median(np.diff(time)))
    n = round(float(time[-1] - time[0]) / dt) + 1
    if n < FEWEST or n > 4 * len(time):
        return None
    grid = np.linspace(time[0], time[-1], n)
    return grid, np.asarray(CubicSpline(time, angle)(grid))


def _of_stretch(time: Array, angle: Array, still: Mask, told: float | None) -> Rates:
    """Rates where the log does not pause. told: noise of the readout at rest."""
    even = _evenly(time, angle)
    if even is None:
        rests = still | (np.ptp(angle) == 0)
        nothing, unknown = np.zeros(len(angle)), np.where(rests, 0.0, UNKNOWN)
        return Rates(nothing, nothing, unknown, unknown)
    grid, uniform = even
    step = float(grid[1] - grid[0])
    readout, pace = told or noise_of_motion(uniform), _pace(uniform)
    late = noise_of_stamps(uniform, pace, readout)
    white = np.hypot(readout, late * pace)
    v, a, variance, bending = _by_windows(time, still, grid, uniform, white)
    lined = _on_lines(uniform, white)
    steady = _lasting(~still & (np.interp(time, grid, lined) > 0.5))
    stamped = _with_stamps(readout, late, grid, time, angle)
    for c in corners(time / step, angle, still, steady, stamped):
        for whole, error, found, expected in (
            (v, variance, c.rate, c.variance),
            (a, bending, c.acceleration, c.bending),
        ):
            better = c.near | (~still[c.rows] & (expected < error[c.rows]))
            rows = c.rows[better]
            whole[rows], error[rows] = found[better], expected[better]
    # a stamp that is off tells the motion of another instant
    noise = np.hypot(CHOSEN * np.sqrt(SHARED * variance), late * a)
    jerk = np.where(still, 0.0, np.gradient(a, time / step))
    other = np.sqrt(
        CHOSEN**2 * SHARED * bending
        + (late * jerk) ** 2
        + _unresolved(time / step, v, a, np.where(still, 0.0, variance))
    )
    return Rates(v / step, a / step**2, noise / step, other / step**2)


def _by_windows(
    time: Array, still: Mask, grid: Array, uniform: Array, noise: Array
) -> tuple[Array, Array, Array, Array]:
    """Rate and acceleration at the stamps, per sample, nothing at rest, and the expected squares of
    their errors, (n,) each.

    Args:
        time: of the stamps, s, (n,); still: which rest, (n,).
        grid, uniform: even times, s, and the angle there, rad, (m,); noise: of it, rad, (m,).
    """
    from scipy.interpolate import CubicHermiteSpline

    n, step = len(grid), float(grid[1] - grid[0])
    beside = 2 * WIDTHS[-1] + 1  # no window of a row that moves reaches further
    reached = np.convolve(np.interp(grid, time, ~still) > 0, np.ones(beside))
    wanted = reached[WIDTHS[-1] : WIDTHS[-1] + n] > 0.5
    told = np.zeros((4, n))
    if wanted.sum() >= WIDTHS[0]:
        told[:, wanted] = by_best_windows(uniform[wanted], noise[wanted])
    variance, bending = (np.interp(time, grid, error) for error in told[2:])
    v = CubicHermiteSpline(grid, told[0], told[1] / step)(time)
    # a line cuts off its peaks
    a = CubicHermiteSpline(grid, told[1], np.gradient(told[1], step))(time)
    # at rest nothing moves but what rings: by as much as that shows, its rates are unknown
    variance = np.where(still, np.maximum(v**2 - RINGS * variance, 0.0), variance)
    bending = np.where(still, np.maximum(a**2 - RINGS * bending, 0.0), bending)
    return np.where(still, 0.0, v), np.where(still, 0.0, a), variance, bending


def _unresolved(time: Array, v: Array, a: Array, variance: Array) -> Array:
    """Square of what an acceleration is off the mean over the time from one neighbour to the other,
    beyond the noise of the rates there, (n,): what bends within so few samples is not told, and an
    instrument takes as long to follow.
    """
    mean = np.gradient(v, time)
    noise = np.convolve(variance, (0.25, 0.0, 0.25), "same")
    return np.asarray(np.maximum((a - mean) ** 2 - noise, 0.0))


def _on_lines(u: Array, noise: Array) -> Mask:
    """Samples at which the angle goes on by a line, within the noise, (n,)."""
    if len(u) <= LINE:
        return np.zeros(len(u), bool)
    return np.asarray(np.convolve(fits(u, LINE, 1, noise, LOOSE), np.ones(LINE)) > 0.5)


def _lasting(steady: Mask) -> Mask:
    """Rows of turns that are steady for long enough to tell their rate, (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], steady.astype(int), [0]])))
    found = np.zeros(len(steady), bool)
    for first, after in zip(edges[::2], edges[1::2], strict=True):
        found[first:after] = after - first >= TURN
    return found


def _pace(u: Array) -> Array:
    """Mean rate around each sample, without its sign, per sample, (n,)."""
    around = np.ones(WIDTHS[2])
    steps = np.abs(np.gradient(u))
    return np.asarray(
        np.convolve(steps, around, "same") / np.convolve(np.ones_like(u), around, "same")
    )
