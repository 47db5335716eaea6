"""The course of an axis from the instant on at which it leaves a standstill or a steady turn.

A polynomial across that instant rings. From it on the course is a sum of powers of the time since,
the square or the cube first, and before it the level of the standstill, or the line of the turn:
that gives the rate next to it better than any window on one side of it.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tiltcal.core.arrays import NOWHERE, Array, Index, Mask

# samples: what begins slowly hides in the noise of the standstill, which ends with a margin
EARLIEST, LATEST = -4, 5
COARSE = 0.25  # samples between the instants tried first
ZOOM = 8.0  # times finer, each time
ZOOMS = 5
KNOWN = 1e-4  # of chi-square above the least: the instant is known to a hundredth of its sigma
STANDSTILL = (6, 50)  # samples of a standstill, at least, and as many at most for its level
TURN = 16  # samples of a steady turn, at least: its line extrapolates next to what follows it
NOTHING = 1e-200  # of a sum of squares
NEAR = 2.5  # samples from the instant in which every window reaches across it


@dataclass(frozen=True)
class Corner:
    """The motion next to one end of a standstill.

    Args:
        rows: (n,).
        near: those of them that every window would take across the corner, (n,).
        rate, acceleration: per sample and per sample squared, (n,).
        variance: of the rate, rad2, (n,).
        bending: of the acceleration, rad2, (n,).
    """

    rows: Index
    near: Mask
    rate: Array
    acceleration: Array
    variance: Array
    bending: Array


@dataclass(frozen=True)
class Side:
    """Moves as they leave a standstill or a steady turn; time runs backwards for those that reach
    one.

    Args:
        time: samples, (n,).
        angle: rad, (n,).
        last: row of the standstill's last sample, (k,).
        rows: number of its samples, (k,).
        end: first row after the move, (k,).
        level: of the standstill at its last sample, rad, (k,).
        slope: of the turn, rad per sample, (k,).
        variance: of the slope, rad2, (k,).
        noise: standard deviation of the angle at each stamp, rad, (n,).
    """

    time: Array
    angle: Array
    last: Index
    rows: Index
    end: Index
    level: Array
    slope: Array
    variance: Array
    noise: Array

    def relative(self, which: Index, rows: Index) -> tuple[Array, Array]:
        """Time since the last sample of some standstills, samples, and the angle relative to their
        lines there, rad. which: (k,); rows: (k, n).
        """
        time = self.time[rows] - self.time[self.last[which], None]
        line = self.level[which, None] + self.slope[which, None] * time
        return time, self.angle[rows] - line


def side_of(
    time: Array, angle: Array, still: Mask, steady: Mask, noise: Array, parted: Index = NOWHERE
) -> Side:
    """The moves that leave a standstill or a steady turn.

    Args:
        time: samples, increasing, (n,).
        angle: rad, (n,).
        still, steady: rows of standstills and of steady turns, (n,).
        noise: standard deviation of the angle at each stamp, rad, (n,).
        parted: first rows after pauses of the log.
    """
    n = len(time)
    kind = np.where(still, 2, steady.astype(int))
    begins = np.concatenate([[0], np.flatnonzero(np.diff(kind)) + 1])
    inside = parted[still[parted] & still[parted - 1]]
    first = np.union1d(begins, inside)
    after = np.append(first[1:], n)
    first, after = first[kind[first] > 0], after[kind[first] > 0]
    limits = np.append(parted, n)
    end = np.minimum(np.append(first[1:], n), limits[np.searchsorted(limits, after)])
    least = np.where(kind[first] == 2, STANDSTILL[0], TURN)
    left = np.flatnonzero((after < end) & (after - first >= least))
    lines = np.zeros((len(left), 3))
    for k, row in enumerate(left):
        last = slice(max(first[row], after[row] - STANDSTILL[1]), after[row])
        turns = kind[first[row]] == 1
        lines[k] = _line(time[last] - time[after[row] - 1], angle[last], noise[last], turns)
    rows = (after - first)[left]
    level, slope, variance = lines.T
    return Side(time, angle, after[left] - 1, rows, end[left], level, slope, variance, noise)


def _line(time: Array, angle: Array, noise: Array, turns: bool) -> tuple[float, float, float]:
    """Level at time zero and slope of a standstill, whose slope is 0, or of a steady turn, and the
    variance of the slope. time: (n,).
    """
    if not turns:
        return float(angle.mean()), 0.0, 0.0
    columns = np.column_stack([np.ones_like(time), time]) / noise[:, None]
    level, slope = np.linalg.lstsq(columns, angle / noise, rcond=None)[0]
    middle = time @ noise**-2 / (noise**-2).sum()
    return float(level), float(slope), float(1 / ((time - middle) ** 2 @ noise**-2))


@lru_cache(maxsize=256)
def spread_of(width: int, powers: tuple[float, ...]) -> float:
    """What the variance of the rate just after a corner in mid-sample would be, in units of the
    readout's.
    """
    u = np.maximum(np.arange(width + 1) - 1.5, 0.0)
    rate, _ = _variances(u, np.ones(len(powers)), np.ones(len(u)), powers)
    return float(rate[u > 0][:3].sum())


def instants(
    side: Side,
    which: Index,
    width: int,
    powers: tuple[float, ...],
    refused: float,
    earliest: int = EARLIEST,
) -> tuple[Array, Array]:
    """The instant at which each of these moves begins, samples, (k,), and by how many sigma the
    residuals of the course exceed the noise, (k,): infinite where it has no such instant.

    Args:
        side, which: the moves, (k,).
        width: samples after the standstill to fit.
        earliest: sample at which the search begins.
        powers: of the time since the instant.
        refused: sigma beyond which no course is used; its instant is estimated roughly.
    """
    rows = side.last[which, None] + np.arange(earliest, width + 1)
    time, beyond = side.relative(which, rows)
    weight = 1 / side.noise[rows]
    y = weight * beyond
    instant, least = np.zeros(len(which)), np.zeros(len(which))
    off = np.full(len(which), np.inf)
    grid = np.tile(np.arange(earliest, LATEST, COARSE), (len(which), 1))
    step, unsettled = COARSE, np.arange(len(which))
    for zoom in range(ZOOMS + 1):
        t, w, each = time[unsettled], weight[unsettled], np.arange(len(unsettled))
        u = np.maximum(t.T[:, :, None] - grid, 0.0) / width
        enough = u[-len(powers) - 2] > 0  # time increases
        left = np.where(enough, _left(u, y[unsettled].T, w.T, powers), np.inf)
        at, last = np.argmin(left, axis=1), grid.shape[1] - 1
        instant[unsettled], least[unsettled] = grid[each, at], left[each, at]
        # between grid points a parabola is lower by an eighth of this at most, others by more
        rise = left[each, [np.maximum(at - 1, 0), np.minimum(at + 1, last)]].max(axis=0)
        rise -= least[unsettled]
        moving = (t > instant[unsettled, None]).sum(axis=1)
        noise = len(rows[0]) - moving  # the standstill has its own share of it
        off[unsettled] = _beyond(least[unsettled] - noise, moving - len(powers) - 1)
        may_be = _beyond(least[unsettled] - rise - noise, moving - len(powers) - 1) <= refused
        if zoom == 0:
            inside = (at > 0) & (at < last)
            off[~inside] = np.inf
            may_be &= inside
        finer = np.flatnonzero(may_be & (rise > KNOWN))
        if not len(finer):
            break
        unsettled = unsettled[finer]
        grid = instant[unsettled, None] + step * np.linspace(-1, 1, round(2 * ZOOM) + 1)
        step /= ZOOM
    return instant, off


def _beyond(excess: Array, dof: Array) -> Array:
    """By how many sigma a course leaves more than the noise. excess: chi-square of its rows, (k,);
    dof: their number less that of what is fitted, (k,).
    """
    dof = np.maximum(dof, 1)
    return np.asarray((np.sqrt(np.maximum(excess, 0.0) / dof) - 1) * np.sqrt(2 * dof))


def _left(u: Array, y: Array, weight: Array, powers: tuple[float, ...]) -> Array:
    """What the best sums of powers leave of each weighted course, squares summed, (k, t). u: (n, k,
    t); y, weight: (n, k).
    """
    left = np.empty((len(powers) + 1, *u.shape))
    for column, power in zip(left, _powers(u, powers), strict=False):
        np.multiply(weight[:, :, None], power, out=column)
    left[-1] = y[:, :, None]
    left = left.reshape(len(left), len(u), -1)
    while len(left) > 1:  # one column after the other is taken out of the rest (Gram-Schmidt)
        column, left = left[0], left[1:]
        size = np.maximum(_along(column, column), NOTHING)  # none has moved: nothing to fit
        left -= (np.einsum("nm,inm->im", column, left) / size)[:, None] * column
    return _along(left[0], left[0]).reshape(u.shape[1:])


def _powers(u: Array, powers: tuple[float, ...]) -> list[Array]:
    """Columns that span ``u`` to each of these powers, at even distances: the first times the
    Chebyshev polynomials over [0, 1], of which none is nearly a sum of the others.
    """
    s = 2 * _power(u, int(powers[1] - powers[0])) - 1
    found = [_power(u, int(powers[0]))]
    for k in range(1, len(powers)):
        found.append(s * found[0] if k == 1 else 2 * s * found[-1] - found[-2])
    return found


def _power(u: Array, n: int) -> Array:
    """``u`` to a whole power from one on: products take a tenth of the time."""
    found = u
    for _ in range(n - 1):
        found = found * u
    return found


def _along(one: Array, other: Array) -> Array:
    """Sum of products along the first axis, (m,)."""
    return np.asarray(np.einsum("nm,nm->m", one, other))


def corner_at(side: Side, k: int, width: int, powers: tuple[float, ...], instant: float) -> Corner:
    """The motion next to the k-th end, by its course from an instant on, samples."""
    rows = side.last[k] + np.arange(EARLIEST, width + 1)
    time, beyond = side.relative(np.array([k]), rows[None])
    since = time[0] - instant
    u = np.maximum(since, 0.0)
    noise = side.noise[rows]
    c = np.linalg.lstsq(
        np.column_stack([u**p / noise for p in powers]), beyond[0] / noise, rcond=None
    )[0]
    rate, bend, _ = _derivatives(u, c, powers)
    left = (beyond[0] - sum(a * u**p for a, p in zip(c, powers, strict=True))) / noise
    error, bending = _errors(u, c, noise, powers, left)
    error = error + side.variance[k]
    return Corner(rows, since <= NEAR, rate + side.slope[k], bend, error, bending)


def _errors(
    u: Array, c: Array, noise: Array, powers: tuple[float, ...], left: Array
) -> tuple[Array, Array]:
    """Expected squares of the errors of the rate and of the acceleration, (n,) each: the variance,
    and the square of the bias, estimated from a course with one power more (Ruppert, J. Am.
    Stat. Assoc. 92, 1997). left: of the course's fit, in units of the noise, (n,).
    """
    mine = _maps(u, c, noise, powers)
    variances = [(one**2).sum(axis=1) for one in mine]
    if (u > 0).sum() > len(powers) + 2:
        more = _maps(u, np.append(c, 0.0), noise, (*powers, powers[-1] + 1))
        for k, (one, other) in enumerate(zip(mine, more, strict=True)):
            added = (other @ left) ** 2 - ((other - one) ** 2).sum(axis=1)
            variances[k] = variances[k] + np.maximum(added, 0.0)
    rate, acceleration = variances
    return rate, acceleration


def _derivatives(u: Array, c: Array, powers: tuple[float, ...]) -> Array:
    """First to third derivative of the course, nothing before the instant, (3, n)."""
    found = np.zeros((3, len(u)))
    for a, p in zip(c, powers, strict=True):
        factor = a
        for k in range(3):
            factor *= p - k
            if factor:
                found[k] += np.where(u > 0, factor * u ** (p - k - 1), 0.0)
    return found


def _variances(u: Array, c: Array, noise: Array, powers: tuple[float, ...]) -> tuple[Array, Array]:
    """Of the rate and of the acceleration, in units of the noise squared, (n,) each."""
    rate, acceleration = _maps(u, c, noise, powers)
    return (rate**2).sum(axis=1), (acceleration**2).sum(axis=1)


def _maps(u: Array, c: Array, noise: Array, powers: tuple[float, ...]) -> tuple[Array, Array]:
    """What takes a small change of the angles, in units of their noise, to that of the rate and of
    the acceleration, the instant being fitted too, (n, n) each.
    """
    v, bend, jerk = _derivatives(u, c, powers)
    fitted = np.column_stack([*(u**p for p in powers), -v]) / noise[:, None]
    rate = np.column_stack([*(p * u ** (p - 1) for p in powers), -bend])
    moving = u > 0
    second = [np.where(moving, p * (p - 1) * u ** (p - 2), 0.0) for p in powers]
    acceleration = np.column_stack([*second, -jerk])
    scale = np.linalg.norm(fitted, axis=0) + (np.linalg.norm(fitted, axis=0) == 0)
    spread = np.linalg.pinv(fitted / scale)
    return rate / scale @ spread, acceleration / scale @ spread
