"""Cosine coefficients of some hundred columns of one channel, in single precision.

A column is written where it stays and is read as it lies.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from tiltcal.core.arrays import Index, Single
from tiltcal.statistics.noise_spectrum import inverse_cosines

Waves = Single
Energies = tuple[npt.NDArray[np.float64], list[tuple[int, Index, Waves]]]
"""Of each column alone, (used,), 0 where its hypothesis has several here; of these the owner, the
numbers and the products.
"""
AT_ONCE = 4  # columns that are squared and weighed while they are at hand


@dataclass(frozen=True)
class Weighed:
    """Vectors of a channel whose inner products with columns are asked for.

    Args:
        waves: cosine coefficients, weighed by the noise, (n, q).
    """

    waves: Waves

    @cached_property
    def course(self) -> Waves:
        """The same in time, (n, q)."""
        return np.ascontiguousarray(inverse_cosines(self.waves.T).T)


@dataclass
class ColumnBlock:
    """Columns of one channel.

    Args:
        channel: its number.
        waves: cosine coefficients, (room, n); numbers: of the columns, (room,); owners: of their
            hypotheses, (room,).
        used: how many stand on it.
    """

    channel: int
    waves: Waves
    numbers: Index
    owners: Index
    used: int = 0

    @classmethod
    def empty(cls, channel: int, room: int, n: int) -> "ColumnBlock":
        """Room for so many columns of n coefficients."""
        return cls(
            channel,
            np.empty((room, n), np.float32),
            np.zeros(room, np.intp),
            np.zeros(room, np.intp),
        )

    def waves_of(self, rows: slice) -> Waves:
        """Cosine coefficients of some columns, (rows, n)."""
        return self.waves[rows]

    def along(self, vectors: Weighed) -> Waves:
        """Inner products of the columns with weighed vectors, (used, q)."""
        return self.waves[: self.used] @ vectors.waves

    def energies(self, weight: Waves) -> Energies:
        """What the columns hold. weight: of each coefficient, (n,)."""
        starts = np.flatnonzero(np.diff(self.owners[: self.used], prepend=-1))
        counts = np.diff(starts, append=self.used)
        single = np.zeros(self.used)
        power, squares = weight * weight, np.empty((AT_ONCE, len(weight)), np.float32)
        for first in range(0, self.used, AT_ONCE):
            part = self.waves[first : min(first + AT_ONCE, self.used)]
            single[first : first + AT_ONCE] = np.square(part, out=squares[: len(part)]) @ power
        several = []
        for start, count in zip(starts[counts > 1], counts[counts > 1], strict=True):
            rows = slice(start, start + count)
            part = self.waves[rows] * weight
            single[rows] = 0.0
            several.append((int(self.owners[start]), self.numbers[rows], part @ part.T))
        return single, several
