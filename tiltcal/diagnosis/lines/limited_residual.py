"""A whitened residual in time, behind a limiter, and the noise about each of its rows: gross values
and bursts of noise pass for no signal.
"""

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.statistics.cosine_transform import inverse_cosines

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
