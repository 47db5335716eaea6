"""Peaks of a spectrum: lines that stand out of it.

A whitened residual in time, behind a limiter, and the noise about each of its rows: gross values
and bursts of noise pass for no signal.
"""

from collections.abc import Callable, Sequence

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.lines.lines_over_angles import MOST
from tiltcal.statistics.cosine_transform import inverse_cosines

SLOWEST = 4  # periods of a recording: below it a drift looks like a line
PEAKS = 40  # of a channel, the strongest


def evenly(time: Array, values: Array) -> tuple[Array, float]:
    """The values on an even grid, nothing where a row was lost, (m,), and its rate, Hz: a lost row
    shifts the phase of the rest.
    """
    step = float(np.median(np.diff(time)))
    place = np.rint((time - time[0]) / step).astype(np.intp)
    if place[-1] > 2 * len(time):  # long gaps, or stamps of no rate
        return values, (len(values) - 1) / float(time[-1] - time[0])
    even = np.zeros(int(place[-1]) + 1)
    even[place] = values
    return even, float(place[-1]) / float(time[-1] - time[0])


def running_median(values: Array, width: int) -> Array:
    """Median over blocks, interpolated, (n,)."""
    count = max(len(values) // width, 1)
    blocks = np.array_split(values, count)
    centres = np.cumsum([len(b) for b in blocks]) - np.array([len(b) for b in blocks]) / 2
    return np.interp(np.arange(len(values)), centres, [float(np.median(b)) for b in blocks])


def peaks(
    time: Array, strength: Array, frequency: Array, limit: float
) -> list[tuple[float, float]]:
    """(strength, frequency) of the strongest peaks of a spectrum above a limit, but for those of
    too few periods in these stamps, s.
    """
    left, right = np.roll(strength, 1), np.roll(strength, -1)
    peak = (strength > limit) & (strength >= left) & (strength >= right)
    peak &= frequency > SLOWEST / max(float(time[-1] - time[0]), 1e-9)
    found = [(float(strength[k]), float(frequency[k])) for k in np.flatnonzero(peak)]
    return sorted(found, reverse=True)[:PEAKS]


def apart(
    found: Sequence[tuple[float, float]], width: Callable[[float], float]
) -> tuple[float, ...]:
    """The strongest of (power, frequency) that are further apart than the width of a line, Hz."""
    kept: list[float] = []
    for _, f in sorted(found, reverse=True):
        if len(kept) < MOST and all(abs(f - other) > width(f) for other in kept):
            kept.append(f)
    return tuple(kept)


FAR = 4.0  # sigma: a reading that is farther off counts as that
AROUND = 64  # rows at least that tell the noise about one


def limited(residual: Array) -> Array:
    """A residual in time. residual: cosine coefficients in units of the noise, (n,)."""
    return np.clip(inverse_cosines(residual), -FAR, FAR)


def noise_about(left: Array, width: int = AROUND) -> Array:
    """Variance of the noise about each row, at least that of all rows, (n,).

    Args:
        left: residual in time, in units of the noise, (n,).
        width: rows that tell it, where they are more than ``AROUND``.
    """
    from scipy.ndimage import uniform_filter1d

    white = np.diff(left, 2) ** 2 / 6
    near = uniform_filter1d(np.pad(white, 1, mode="edge"), max(width, AROUND))
    return np.asarray(np.maximum(near, 1.0))
