"""What a design needs to know of an instrument: how its readings at a pose change with every
parameter, and its noise.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array, Mask

Rows = Callable[[Array, Array], Array]
"""(angles (n, axes), time (n,)) -> change of the k channels at a pose per prior standard deviation,
(n, k, p).
"""


@dataclass(frozen=True)
class Model:
    """Parameters, the information that a pose gives on them, and what the design is for.

    Args:
        names, units: of the parameters, (p,).
        prior: standard deviation of each before the sequence, in its unit, (p,).
        interest: which are of interest; the others are nuisances, (p,).
        rows: see ``Rows``; the unit is that of ``white``.
        white: noise of each channel per root hertz, (k,).
        floor: what no averaging removes from the mean of one pose, standard deviation, (k,).
        loss: W with mean square tilt error (per axis, rad^2) = tr(C W) over the working range, (p,
            p).
        timed: whether the rows depend on time.
        axes: number of the table's axes.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    prior: Array
    interest: Mask
    rows: Rows
    white: Array
    floor: Array
    loss: Array
    timed: bool
    axes: int = 2

    def weights(self, dwell: Array) -> Array:
        """1 / variance of the mean of each channel over a dwell, (..., n, k).

        Args:
            dwell: s, (..., n).
        """
        return np.asarray(1 / (self.white**2 / dwell[..., None] + self.floor**2))

    def information(self, angles: Array, dwell: Array, time: Array) -> Array:
        """Prior and data, in units of the prior, (p, p)."""
        flat = (self.rows(angles, time) * np.sqrt(self.weights(dwell))[:, :, None]).reshape(
            -1, len(self.names)
        )
        return np.asarray(np.eye(len(self.names)) + flat.T @ flat)
