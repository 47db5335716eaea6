"""A temperature column without its rounding: a smooth course within its quantisation."""

from collections.abc import Callable

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.quantisation import lsb_width
from tiltcal.statistics.dwell_noise import second_difference_noise

KNOTS = 600  # readings are averaged to about so many: temperature is slow
EXACT = 1e-6  # of the span: a course known better than that was computed


def smooth_temperature(time: Array, values: Array) -> Array:
    """A temperature column without its rounding and noise, degC, (n,).

    The smoothest cubic spline whose residual is that of the quantisation and of the noise from
    reading to reading. Only so does a temperature rate mean anything: an LSB of 0.01 K read each
    second jumps by more than any laboratory does.

    Args:
        time: stamps, s, (n,).
        values: readings, NaN where there is none, (n,).

    Source: Reinsch (1967), smoothing by spline functions: the residual is given, not the
    smoothness.
    """
    known = ~np.isnan(values)
    t, T = time[known], values[known]
    block = -(-len(t) // KNOTS)
    level = _level(T, block)
    if len(t) < 16 or np.any(np.diff(t) <= 0) or not 4 * level < np.ptp(T) < level / EXACT:
        return np.interp(time, t, T) if len(t) else values
    starts = np.arange(0, len(t), block)
    count = np.diff(starts, append=len(t))
    spline = _smoothest(
        np.add.reduceat(t, starts) / count, np.add.reduceat(T, starts) / count, level
    )
    inside, reach = np.clip(time, t[0], t[-1]), float(np.median(np.diff(t)))
    slope = (spline(inside + reach / 100) - spline(inside - reach / 100)) / (reach / 50)
    # held at once, its rate would jump, as no laboratory's does
    return spline(inside) + slope * np.clip(time - inside, -reach, reach)


def _level(T: Array, block: int) -> float:
    """Standard deviation of rounding and noise in a mean of ``block`` readings; 0 for a course that
    was computed.

    Rounding does not average: the temperature stays at one value for long.
    """
    if len(T) < 16:
        return 0.0
    second = np.diff(T, 2)
    lsb, noise = lsb_width(T), second_difference_noise(T)
    # the steps of a computed ramp are all alike
    rounded = float(np.sqrt(np.mean(second**2))) > 1e-3 * lsb
    return float(np.hypot(lsb / np.sqrt(12) if rounded else 0.0, noise / np.sqrt(block)))


def _smoothest(t: Array, T: Array, level: float) -> Callable[[Array], Array]:
    """The smoothest course within ``level`` rms of the readings, at both ends as well as all along.

    A cubic is taken off first: the spline is straight at its ends, which no laboratory is.
    """
    from scipy.interpolate import CubicSpline

    trend = np.polynomial.Polynomial.fit(t, T, 3)
    residual = T - trend(t)
    left_by = _smoothing(t, residual)
    low, high = -12.0, 16.0  # decades
    best = left_by(10.0**low)
    while high - low > 0.1:
        middle = (low + high) / 2
        left = left_by(10.0**middle)
        if _within(left, level):
            best, low = left, middle
        else:
            high = middle
    spline = CubicSpline(t, residual - best, bc_type="natural")
    return lambda time: np.asarray(trend(time) + spline(time))


def _smoothing(t: Array, y: Array) -> Callable[[float], Array]:
    """What the natural cubic spline leaves of y, (n,), by the weight of its squared curvature: with
    Q'f the second divided differences of its values f, and R that of its second derivatives g,
    (R + weight Q'Q) g = Q'y and y - f = weight Q g. t, y: (n,).
    """
    from scipy.linalg import solveh_banded

    h = np.diff(t)
    before, after = 1 / h[:-1], 1 / h[1:]
    here = -(before + after)
    squares, bends = np.zeros((2, 3, len(here)))
    squares[0] = before**2 + here**2 + after**2
    squares[1, :-1] = here[:-1] * before[1:] + after[:-1] * here[1:]
    squares[2, :-2] = after[:-2] * before[2:]
    bends[0], bends[1, :-1] = (h[:-1] + h[1:]) / 3, h[1:-1] / 6
    second = np.diff(y)[1:] * after - np.diff(y)[:-1] * before

    def left(weight: float) -> Array:
        g = weight * solveh_banded(bends + weight * squares, second, lower=True)
        found = np.zeros(len(y))
        found[:-2] += before * g
        found[1:-1] += here * g
        found[2:] += after * g
        return found

    return left


def _within(left: Array, level: float) -> bool:
    """Whether a residual is no larger than ``level`` rms, nor in its ends by more than chance makes
    of so few.
    """
    end = max(len(left) // 20, 8)
    rms = [float(np.sqrt(np.mean(part**2))) for part in (left, left[:end], left[-end:])]
    return rms[0] <= level and max(rms[1:]) <= level * (1 + 2 / np.sqrt(2 * end))
