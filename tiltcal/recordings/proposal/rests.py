"""Short windows of three columns: their means, and which of them are at rest."""

from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.recordings.stamps import LARGEST

_WINDOWS = 4000  # at most so many are looked at
_LEAST = 8  # rows of a window
_VALUES = 8  # different ones that a sensor reads at least: flags and commands have fewer
_NOISY = 0.2  # share of the rows that do not go on as before: steps and ramps do
_UNIT = 0.02  # of the noise of a component: the norm of a unit vector has only its rounding
_QUIET = 2.0  # times the noise of the quietest tenth


@dataclass(frozen=True)
class Windows:
    """Windows of equal length.

    Args:
        means: (m, k).
        quiet: whether the window is at rest, (m,).
        noise: standard deviation of a reading in the quiet windows, of all channels together.
        size: rows of a window.
    """

    means: Array
    quiet: Mask
    noise: float
    size: int

    @property
    def at_rest(self) -> Array:
        """Means of the windows at rest, (r, k)."""
        return self.means[self.quiet]


def filled(values: Array) -> Array:
    """Readings with what was not sampled interpolated between its neighbours, (n, k)."""
    if np.isfinite(values).all():
        return values
    rows, found = np.arange(len(values)), np.array(values)
    for k in range(values.shape[1]):
        known = np.isfinite(values[:, k])
        if known.any():
            found[:, k] = np.interp(rows, rows[known], values[known, k])
    return np.nan_to_num(found)


def windows_of(values: Array, rate: float | None) -> Windows | None:
    """The windows of readings; None where there are too few rows.

    Args:
        values: (n, k).
        rate: of samples, Hz; None: 32 rows make a window.
    """
    size = max(_LEAST, round((rate or 64.0) / 2))
    size = min(size, max(_LEAST, len(values) // 8))
    values = values[(np.abs(values) <= LARGEST).all(axis=1)]
    count = len(values) // size
    if count < 2:
        return None
    cut = values[: count * size].reshape(count, size, -1)
    cut = cut[:: max(1, count // _WINDOWS)]
    spread = np.sqrt(cut.var(axis=1).sum(axis=1))
    usable = np.isfinite(spread)
    if usable.sum() < 2:
        return None
    cut, spread = cut[usable], spread[usable]
    quietest = float(np.quantile(spread, 0.1))
    quiet = spread <= max(_QUIET * quietest, float(spread.min()))
    noise = float(np.median(spread[quiet])) / np.sqrt(values.shape[1])
    return Windows(cut.mean(axis=1), quiet, noise, size)


def is_measured(values: Array) -> bool:
    """Whether columns are what a sensor reads: each has many values and noise, and together they
    are no unit vector or quaternion.

    Args:
        values: (n, k).
    """
    values = values[(np.abs(values) <= LARGEST).all(axis=1)]
    if len(values) < _LEAST:
        return False
    second = np.diff(values, 2, axis=0)
    if np.mean(second != 0, axis=0).min() < _NOISY:
        return False
    if min(len(np.unique(v)) for v in values.T) < _VALUES:
        return False
    length = np.diff(np.linalg.norm(values, axis=1), 2)
    return bool(length.std() > _UNIT * second.std(axis=0).min())


def apart(windows: Windows) -> float:
    """Spread of the standstill means, as a share of the whole range of the means: near 1 where
    they depend on the attitude, near 0 where all are the same.
    """
    means = windows.at_rest
    middle = np.median(means, axis=0)
    spread = float(np.sqrt(np.mean(np.sum((means - middle) ** 2, axis=1))))
    reach = float(np.max(np.linalg.norm(windows.means - middle, axis=1)))
    return spread / reach if reach > 0 else 0.0


def moves(windows: Windows) -> bool:
    """Whether some windows differ from the standstill means by more than noise."""
    middle = np.median(windows.at_rest, axis=0)
    reach = float(np.max(np.linalg.norm(windows.means - middle, axis=1)))
    return reach > 20 * windows.noise and bool((~windows.quiet).any())
