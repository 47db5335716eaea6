"""Rate and acceleration of a readout: by the local polynomials that its noise allows, and after a
standstill by the motion out of it.

Each window of evenly sampled values is as long as its noise and its curvature make best; the noise
of the readout and of its stamps is estimated from the readout itself.
"""

from functools import cache
from itertools import product
from math import comb
from typing import NamedTuple

import numpy as np

from tiltcal.core.arrays import NOWHERE, Array, Index, Mask
from tiltcal.core.quantisation import lsb_width
from tiltcal.recordings.rest_edges import LOOSE, STRICT, corners
from tiltcal.recordings.starting_courses import TURN
from tiltcal.setup.pauses import stretches
from tiltcal.statistics.dwell_noise import MAD_TO_SIGMA

DEGREES = (4, 6)  # of the local polynomials: a fast swing bends more than a quartic does
# samples of them: those that leave no more than the readout's own noise
WIDTHS = (5, 7, 9, 11, 15, 19, 25, 33, 41)
AROUND = (0.2, 0.35, 0.5, 0.65, 0.8)  # in a window, of the sample whose rate is estimated
AT_ENDS = (0.0, 1.0)  # where no window around a sample fits: next to a corner


def by_best_windows(u: Array, noise: Array) -> tuple[Array, Array, Array, Array]:
    """First and second derivative per sample, each from the polynomial of the window that is best
    for it, and the expected squares of the errors of both, (n,) each.

    That is the variance and the square of the bias, estimated from a polynomial of two degrees
    more (Ruppert, J. Am. Stat. Assoc. 92, 1997). The narrowest window where none fits.

    Args:
        u: angle, rad.
        noise: of each sample, rad, (n,).
    """
    n = len(u)
    derivatives, error = _by_narrowest(u, noise)
    narrowest = error.copy()
    for row in _ends(n):  # no window is around them
        error[:, row] = np.inf
    kept = np.ones((2, n), bool)
    fitting = {(w, d): fits(u, w, d, noise) for d, w in product(DEGREES, WIDTHS) if d + 1 < w < n}
    for positions in (AROUND, AT_ENDS):
        wanted = np.ones((2, n), bool) if positions is AROUND else error >= narrowest
        for ((width, degree), fit), share in product(fitting.items(), positions):
            index = round(share * (width - 1))
            rows = slice(index, n - width + 1 + index)
            each = _weights(width, index, degree)
            more = _weights(width, index, degree + 2) if width > degree + 3 else each
            for k, weights in enumerate(each):
                expected = float(weights @ weights) * noise[rows] ** 2
                expected = expected + _bias(u, more[k] - weights, noise[rows])
                better = fit & wanted[k, rows] & (expected < error[k, rows])
                if better.any():
                    found = np.convolve(u, weights[::-1], mode="valid")
                    derivatives[k, rows] = np.where(better, found, derivatives[k, rows])
                    error[k, rows] = np.where(better, expected, error[k, rows])
                    kept[k, rows] &= ~better
    v, a = derivatives
    squares, bending = np.where(kept, narrowest + _bias_of_narrowest(u, noise), error)
    return v, a, squares, bending


def _by_narrowest(u: Array, noise: Array) -> tuple[Array, Array]:
    """First and second derivative per sample from the narrowest window around it, at the ends to
    one side, and the variances of both, (2, n) each.
    """
    n, half = len(u), WIDTHS[0] // 2
    derivatives, variance = np.zeros((2, 2, n))
    for k, weights in enumerate(_weights(WIDTHS[0], half, DEGREES[0])):
        derivatives[k, half : n - half] = np.convolve(u, weights[::-1], mode="valid")
        variance[k] = float(weights @ weights) * noise**2
    for row in _ends(n):
        begin = 0 if row < half else n - WIDTHS[0]
        for k, weights in enumerate(_weights(WIDTHS[0], row - begin, DEGREES[0])):
            derivatives[k, row] = float(weights @ u[begin : begin + WIDTHS[0]])
            variance[k, row] = float(weights @ weights) * noise[row] ** 2
    return derivatives, variance


def _bias_of_narrowest(u: Array, noise: Array) -> Array:
    """Expected squares of what the narrowest windows are off where their polynomials bend too
    little, (2, n).
    """
    n, half, beyond = len(u), WIDTHS[0] // 2, WIDTHS[1] // 2
    if n < WIDTHS[1]:
        return np.zeros((2, n))
    narrow = np.pad(_weights(WIDTHS[0], half, DEGREES[0]), ((0, 0), (beyond - half,) * 2))
    more = np.array(_weights(WIDTHS[1], beyond, DEGREES[1])) - narrow
    squares = [_bias(u, weights, noise[beyond : n - beyond]) for weights in more]
    return np.pad(squares, ((0, 0), (beyond, beyond)), "edge")


def _ends(n: int) -> tuple[int, ...]:
    """Rows that no window is around."""
    half = WIDTHS[0] // 2
    return (*range(half), *range(n - half, n))


def _bias(u: Array, more: Array, noise: Array) -> Array:
    """Square of the difference that the weights of a higher degree make in each full window, beyond
    its noise, (m,). more: those weights less the weights in use; noise: of the estimated sample,
    rad, (m,).
    """
    added = np.convolve(u, more[::-1], mode="valid") ** 2
    return np.asarray(np.maximum(added - float(more @ more) * noise**2, 0.0))


@cache
def _weights(width: int, index: int, degree: int) -> tuple[Array, Array]:
    """Weights of the first and the second derivative at one sample of a window, by its polynomial,
    (width,) each.
    """
    fitted = np.linalg.pinv(
        np.vander((np.arange(width) - float(index)) / width, degree + 1, increasing=True)
    )
    return fitted[1] / width, 2 * fitted[2] / width**2


def fits(u: Array, width: int, degree: int, noise: Array, off: float = STRICT) -> Mask:
    """Whether the polynomial fitted to each full window leaves no more than the noise, and so many
    sigma of it, (n - width + 1,).
    """
    k, dof = np.arange(width) - width // 2, width - degree - 1
    basis = np.linalg.qr(np.vander(k / width, degree + 1, increasing=True))[0]
    windows = np.lib.stride_tricks.sliding_window_view(u - u.mean(), width)
    # of the angle itself nothing is left to cancel
    centred = windows - windows[:, width // 2 : width // 2 + 1]
    left = (centred**2).sum(axis=1) - ((centred @ basis) ** 2).sum(axis=1)
    limit = noise[width // 2 : len(u) - width // 2] * (1 + off / np.sqrt(2 * dof))
    return np.asarray(np.sqrt(np.maximum(left, 0.0) / dof) <= limit)


MIN_STEPS = 32  # steps at standstill, more of which give the readout's noise
FAST = 0.3  # of the fastest rate: there an error of the stamps shows
ORDERS = (4, 6, 8)  # of differences that give it for an axis that never stands still


def noise_at_standstill(angle: Array, still: Mask, parted: Index = NOWHERE) -> float | None:
    """Standard deviation of a readout from row to row at standstill, rad, at least that of its
    quantisation; None if it hardly stands still. angle: rad, (n,).
    """
    both = still[1:] & still[:-1]
    both[parted - 1] = False  # what moved within a pause is no noise
    steps = np.diff(angle)[both]
    return (
        float(max(np.sqrt(np.mean(steps**2) / 2), lsb_width(angle) / np.sqrt(12)))
        if len(steps) > MIN_STEPS
        else None
    )


def noise_of_stamps(uniform: Array, pace: Array, noise: float) -> float:
    """How far stamps are off the instants of their rows (rounded, or lagged), standard deviation in
    samples: what higher differences of the readout show beyond its noise where it is fast.
    """
    least = np.inf
    for k in ORDERS:
        turned = pace[k // 2 : len(pace) - k // 2]
        fast = turned > FAST * pace.max()
        size = np.abs(np.diff(uniform, k))[fast] / np.sqrt(comb(2 * k, k))
        spread = MAD_TO_SIGMA * np.median(size / turned[fast])
        least = min(least, spread**2 - (noise / np.median(turned[fast])) ** 2)
    return float(np.sqrt(max(least, 0.0)))


def noise_of_motion(uniform: Array) -> float:
    """The least that higher differences of a readout at even times show, rad: there a smooth motion
    leaves nothing else. uniform: (n,).
    """
    return float(
        min(
            MAD_TO_SIGMA * np.median(np.abs(np.diff(uniform, k))) / np.sqrt(comb(2 * k, k))
            for k in ORDERS
        )
    )


MIN_ROWS = 9  # rows from which a motion is estimated
UNKNOWN = 2 * np.pi  # rad/s and rad/s2, of a motion that no rows determine
LINE = 13  # samples in which a line shows that it is one
# rows that hold as much information on a slow course as one: the windows of rates overlap
SHARED = 3.4
CHOSEN = 1.5  # times a rate is off by what its window expects: the least of many was taken
RINGING = 9.0  # times its expected square that a rate at rest is motion


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
    the noise of readout and stamps and gives the rate best: long in steady turns, short where moves
    bend, and on its own side of a corner. Where an axis begins and ends a move,
    the rate begins at zero. No window reaches across a pause of the log; between two pauses fewer
    than MIN_ROWS rows of a motion give no rate.

    Args:
        time: s, increasing, (n,).
        angle: rad, (n,).
        still: rows at which the axis stands still, (n,).
        parted: first rows after pauses of the log.
    """
    found = Rates(*np.zeros((4, len(angle))))
    readout = noise_at_standstill(angle, still, parted)
    for rows in stretches(len(time), parted):
        part = _of_stretch(time[rows], angle[rows], still[rows], readout)
        for whole, values in zip(found, part, strict=True):
            whole[rows] = values
    return found


def noise_of_stamped(time: Array, angle: Array, still: Mask, parted: Index = NOWHERE) -> Array:
    """Standard deviation of an angle at each stamp, rad, (n,): of the readout, and of the stamp
    times the rate; empty if the axis hardly stands still.

    Args:
        time, angle, still, parted: as in ``differentiate``.
    """
    readout = noise_at_standstill(angle, still, parted)
    if readout is None:
        return np.zeros(0)
    found = np.full(len(time), readout)
    for rows in stretches(len(time), parted):
        if (even := _evenly(time[rows], angle[rows])) is not None:
            stamp_noise = noise_of_stamps(even[1], _pace(even[1]), readout)
            found[rows] = _with_stamps(readout, stamp_noise, even[0], time[rows], angle[rows])
    return found


def _with_stamps(
    readout: float, stamp_noise: float, grid: Array, time: Array, angle: Array
) -> Array:
    """Noise of an angle at each stamp, rad, (n,). stamp_noise: of the stamps, in steps of
    the grid.
    """
    step = float(grid[1] - grid[0])
    exact = float(np.spacing(np.abs(angle).max()))  # of a readout without noise
    return np.asarray(np.hypot(max(readout, exact), stamp_noise * step * np.gradient(angle, time)))


def _evenly(time: Array, angle: Array) -> tuple[Array, Array] | None:
    """Even times over a stretch, s, and its angle there; None of one that does not move, or of a
    log of dwells with nothing between them.
    """
    from scipy.interpolate import CubicSpline

    if len(time) < MIN_ROWS or np.ptp(angle) == 0:
        return None
    dt = float(np.median(np.diff(time)))
    n = round(float(time[-1] - time[0]) / dt) + 1
    if n < MIN_ROWS or n > 4 * len(time):
        return None
    grid = np.linspace(time[0], time[-1], n)
    return grid, np.asarray(CubicSpline(time, angle)(grid))


def _of_stretch(time: Array, angle: Array, still: Mask, readout_noise: float | None) -> Rates:
    """Rates where the log does not pause. readout_noise: at standstill, rad."""
    even = _evenly(time, angle)
    if even is None:
        at_rest = still | (np.ptp(angle) == 0)
        nothing, unknown = np.zeros(len(angle)), np.where(at_rest, 0.0, UNKNOWN)
        return Rates(nothing, nothing, unknown, unknown)
    grid, uniform = even
    step = float(grid[1] - grid[0])
    readout, pace = readout_noise or noise_of_motion(uniform), _pace(uniform)
    stamp_noise = noise_of_stamps(uniform, pace, readout)
    white = np.hypot(readout, stamp_noise * pace)
    v, a, variance, bending = _by_windows(time, still, grid, uniform, white)
    lined = _on_lines(uniform, white)
    steady = _lasting(~still & (np.interp(time, grid, lined) > 0.5))
    stamped = _with_stamps(readout, stamp_noise, grid, time, angle)
    for c in corners(time / step, angle, still, steady, stamped):
        for whole, error, found, expected in (
            (v, variance, c.rate, c.variance),
            (a, bending, c.acceleration, c.bending),
        ):
            better = c.near | (~still[c.rows] & (expected < error[c.rows]))
            rows = c.rows[better]
            whole[rows], error[rows] = found[better], expected[better]
    moving = np.where(still, 0.0, variance)
    missed = _missed(time / step, angle, (v, a), moving, stamped)
    rate = CHOSEN**2 * SHARED * variance + np.where(still, 0.0, missed)
    bent = CHOSEN**2 * SHARED * bending + _unresolved(time / step, v, a, moving)
    # a stamp that is off belongs to the motion of another instant
    jerk = np.where(still, 0.0, np.gradient(a, time / step))
    noise = np.hypot(np.sqrt(_as_nearby(rate, still)), stamp_noise * a)
    other = np.hypot(np.sqrt(_as_nearby(bent, still)), stamp_noise * jerk)
    return Rates(v / step, a / step**2, noise / step, other / step**2)


def _by_windows(
    time: Array, still: Mask, grid: Array, uniform: Array, noise: Array
) -> tuple[Array, Array, Array, Array]:
    """Rate and acceleration at the stamps, per sample, nothing at rest, and the expected squares of
    their errors, (n,) each.

    Args:
        time: of the stamps, s, (n,).
        still: rows at standstill, (n,).
        grid, uniform: even times, s, and the angle there, rad, (m,).
        noise: of it, rad, (m,).
    """
    from scipy.interpolate import CubicHermiteSpline

    n, step = len(grid), float(grid[1] - grid[0])
    reach = 2 * WIDTHS[-1] + 1  # no window of a row that moves reaches further
    reached = np.convolve(np.interp(grid, time, ~still) > 0, np.ones(reach))
    wanted = reached[WIDTHS[-1] : WIDTHS[-1] + n] > 0.5
    estimate = np.zeros((4, n))
    if wanted.sum() >= WIDTHS[0]:
        estimate[:, wanted] = by_best_windows(uniform[wanted], noise[wanted])
    variance, bending = (np.interp(time, grid, error) for error in estimate[2:])
    v = CubicHermiteSpline(grid, estimate[0], estimate[1] / step)(time)
    # a line cuts off its peaks
    a = CubicHermiteSpline(grid, estimate[1], np.gradient(estimate[1], step))(time)
    # at rest nothing moves but what rings: by as much as that shows, its rates are unknown
    variance = np.where(still, np.maximum(v**2 - RINGING * variance, 0.0), variance)
    bending = np.where(still, np.maximum(a**2 - RINGING * bending, 0.0), bending)
    return np.where(still, 0.0, v), np.where(still, 0.0, a), variance, bending


def _as_nearby(squares: Array, still: Mask) -> Array:
    """Expected squares of errors, in motion no less than of the rows within the narrowest window
    around them, (n,): it bends over all of them, and at one what tells its error may agree by
    chance.
    """
    padded = np.pad(squares, WIDTHS[0] // 2)
    around = np.lib.stride_tricks.sliding_window_view(padded, WIDTHS[0]).max(axis=1)
    return np.asarray(np.where(still, squares, around))


def _unresolved(time: Array, v: Array, a: Array, variance: Array) -> Array:
    """Square of what an acceleration is off the mean over the time from one neighbour to the other,
    beyond the noise of the rates there, (n,): what bends within so few samples is not resolved, and
    an instrument takes as long to follow.
    """
    mean = np.gradient(v, time)
    noise = np.convolve(variance, (0.25, 0.0, 0.25), "same")
    return np.asarray(np.maximum((a - mean) ** 2 - noise, 0.0))


def _missed(
    time: Array, angle: Array, motion: tuple[Array, Array], variance: Array, noise: Array
) -> Array:
    """Square of what the rates of three rows are off the angle between the outer two (Simpson's
    rule), where its noise does not explain that, times the number of such rows, (n,): a long window
    has little noise, and yet may reach beyond the end of the turn that it is fitted to. Moves that
    are alike miss alike, so that all these rows tell no more than one.

    Args:
        time: in samples, (n,).
        angle: rad, (n,); noise: of it, rad, (n,).
        motion: rate and acceleration per sample, (n,) each; variance: of the rate, (n,).
    """
    v, a = motion
    turned = (angle[2:] - angle[:-2]) / (time[2:] - time[:-2])
    middle = v[1:-1] - a[1:-1] * (time[1:-1] - (time[2:] + time[:-2]) / 2)
    off = (turned - (v[:-2] + 4 * middle + v[2:]) / 6) ** 2
    usual = (noise[2:] ** 2 + noise[:-2] ** 2) / 4 + variance[1:-1]
    # the middle one counts two thirds
    missed = np.where(off > RINGING * usual, off * 1.5**2, 0.0)
    return np.pad(missed * np.count_nonzero(missed), 1)


def _on_lines(u: Array, noise: Array) -> Mask:
    """Samples at which the angle follows a straight line within the noise, (n,)."""
    if len(u) <= LINE:
        return np.zeros(len(u), bool)
    return np.asarray(np.convolve(fits(u, LINE, 1, noise, LOOSE), np.ones(LINE)) > 0.5)


def _lasting(steady: Mask) -> Mask:
    """Rows of turns that are steady for long enough to determine their rate, (n,)."""
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
