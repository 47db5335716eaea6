"""Cosine coefficients of some hundred columns of one channel, in single precision.

A column is written where it stays and is read as it lies.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tiltcal.core.arrays import Index, Single
from tiltcal.statistics.cosine_transform import cosines, inverse_cosines

Waves = Single
Grams = list[tuple[Index, Waves]]
"""Of hypotheses with m columns each: the numbers of these, (g, m), and their inner products,
(g, m, m).
"""
TRANSFORMED = 32  # columns at once
AT_HAND = 2**17  # coefficients that are weighed and multiplied at once


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

    def grams(self, weight: Waves) -> Grams:
        """Inner products of the columns of each hypothesis. weight: of each coefficient, (n,)."""
        starts = np.flatnonzero(np.diff(self.owners[: self.used], prepend=-1))
        counts = np.diff(starts, append=self.used)
        waves, found = self.waves, []
        for m in np.unique(counts):
            rows = starts[counts == m][:, None] + np.arange(m)
            gram = np.empty((len(rows), m, m), np.float32)
            step = max(1, AT_HAND // (int(m) * len(weight)))
            for first in range(0, len(rows), step):
                part = waves[rows[first : first + step]]
                part *= weight
                np.matmul(part, part.transpose(0, 2, 1), out=gram[first : first + step])
            found.append((self.numbers[rows], gram))
        return found
