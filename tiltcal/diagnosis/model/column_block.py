"""Cosine coefficients of some hundred columns of one channel, in single precision.

A column is written where it stays and is read as it lies.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from tiltcal.core.arrays import Index, Single
from tiltcal.statistics.cosine_transform import cosines, inverse_cosines

Waves = Single
Energies = tuple[npt.NDArray[np.float64], list[tuple[int, Index, Waves]]]
"""Of each column alone, (used,), 0 where its hypothesis has several here; of these the owner, the
numbers and the products.
"""
TRANSFORMED = 32  # columns at once
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
        rows: cosine coefficients, (room, n); of those put last, what they are in time; numbers: of
            the columns, (room,); owners: of their hypotheses, (room,).
        used: how many stand on it; transformed: how many of these stand as coefficients.
    """

    channel: int
    rows: Waves
    numbers: Index
    owners: Index
    used: int = 0
    transformed: int = 0

    @classmethod
    def empty(cls, channel: int, room: int, n: int) -> "ColumnBlock":
        """Room for so many columns of n coefficients."""
        return cls(
            channel,
            np.empty((room, n), np.float32),
            np.zeros(room, np.intp),
            np.zeros(room, np.intp),
        )

    def put(self, owner: int, numbers: Sequence[int], columns: Waves, in_time: bool) -> None:
        """Keep columns of a hypothesis.

        Args:
            owner: its number; numbers: of the columns, (p,).
            columns: (p, n); in_time: whether they are to be transformed, which costs less for many
                at once.
        """
        if not in_time:
            self._transform()
        rows = slice(self.used, self.used + len(numbers))
        self.rows[rows], self.numbers[rows], self.owners[rows] = columns, numbers, owner
        self.used += len(numbers)
        if not in_time:
            self.transformed = self.used

    def _transform(self) -> None:
        for first in range(self.transformed, self.used, TRANSFORMED):
            rows = slice(first, min(first + TRANSFORMED, self.used))
            self.rows[rows] = cosines(self.rows[rows])
        self.transformed = self.used

    @property
    def waves(self) -> Waves:
        """Cosine coefficients of the columns, (used, n)."""
        self._transform()
        return self.rows[: self.used]

    def waves_of(self, rows: slice) -> Waves:
        """Cosine coefficients of some columns, (rows, n)."""
        return self.waves[rows]

    def along(self, vectors: Weighed) -> Waves:
        """Inner products of the columns with weighed vectors, (used, q)."""
        return self.waves @ vectors.waves

    def energies(self, weight: Waves) -> Energies:
        """What the columns hold. weight: of each coefficient, (n,)."""
        starts = np.flatnonzero(np.diff(self.owners[: self.used], prepend=-1))
        counts = np.diff(starts, append=self.used)
        single = np.zeros(self.used)
        waves, power = self.waves, weight * weight
        room = np.empty((max(AT_ONCE, int(counts.max(initial=0))), len(weight)), np.float32)
        for first in range(0, self.used, AT_ONCE):
            part = waves[first : first + AT_ONCE]
            single[first : first + AT_ONCE] = np.square(part, out=room[: len(part)]) @ power
        several = []
        for start, count in zip(starts[counts > 1], counts[counts > 1], strict=True):
            rows = slice(start, start + count)
            part = np.multiply(waves[rows], weight, out=room[:count])
            single[rows] = 0.0
            several.append((int(self.owners[start]), self.numbers[rows], part @ part.T))
        return single, several
