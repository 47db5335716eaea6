"""What a thermometer that rounds, and is read now and then, saw: a smooth course that its codes allow."""

import numpy as np

from tiltcal.codes import code_width
from tiltcal.frames import Array

KNOTS = 600  # readings are averaged to about so many: temperature is slow
EXACT = 1e-6  # of the span: a course known better than that was computed
LAST = 24  # halvings of the logarithm of the smoothness


def smooth_temperature(time: Array, values: Array) -> Array:
    """A temperature column without its rounding and noise, degC, (n,).

    The smoothest cubic spline whose residual is that of the codes and of the noise from reading to reading. Only so does
    a rate of warming mean anything: a code of 0.01 K read each second jumps by more than any room does.

    Args:
        time: stamps, s, (n,); values: readings, NaN where there is none, (n,).

    Source: Reinsch (1967), smoothing by spline functions: the residual is given, not the smoothness.
    """
    known = ~np.isnan(values)
    t, T = time[known], values[known]
    level = _level(T)
    if len(t) < 16 or np.any(np.diff(t) <= 0) or not 4 * level < np.ptp(T) < level / EXACT:
        return np.interp(time, t, T) if len(t) else values
    block = -(-len(t) // KNOTS)
    starts = np.arange(0, len(t), block)
    count = np.diff(starts, append=len(t))
    spline = _smoothest(np.add.reduceat(t, starts) / count, np.add.reduceat(T, starts) / count, level)
    return np.asarray(spline(np.clip(time, t[0], t[-1])))


def _level(T: Array) -> float:
    """Standard deviation of rounding and noise together; 0 for a course that was computed."""
    if len(T) < 16:
        return 0.0
    second = np.diff(T, 2)
    code, noise = code_width(T), float(1.4826 * np.median(np.abs(second)) / np.sqrt(6))
    rounded = float(np.sqrt(np.mean(second**2))) > 1e-3 * code  # the steps of a computed ramp are all alike
    return float(np.hypot(code / np.sqrt(12) if rounded else 0.0, noise))


def _smoothest(t: Array, T: Array, level: float):  # type: ignore[no-untyped-def]
    """The smoothest spline within ``level`` rms of the readings."""
    from scipy.interpolate import make_smoothing_spline

    low, high = -12.0, 16.0  # decades
    best = make_smoothing_spline(t, T, lam=10.0**low)
    for _ in range(LAST):
        middle = (low + high) / 2
        trial = make_smoothing_spline(t, T, lam=10.0**middle)
        if float(np.sqrt(np.mean((trial(t) - T) ** 2))) <= level:
            best, low = trial, middle
        else:
            high = middle
        if high - low < 0.1:
            break
    return best
