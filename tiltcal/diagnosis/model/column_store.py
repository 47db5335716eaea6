"""Where a whitened model keeps the columns of its hypotheses: cosine coefficients, in single
precision, a column block for some hundred of them.

A column is written where it stays and is read as it lies. Forms and curves stand on column store of
their own, as do channels: most questions are about one kind, and pass the column store of the other
by.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from tiltcal.core.arrays import Index, Mask

Waves = npt.NDArray[np.float32]
Energies = tuple[npt.NDArray[np.float64], list[tuple[int, Index, Waves]]]
"""Of each column alone, (used,), 0 where its hypothesis has several here; of these the owner, the
numbers and the products.
"""
ROOM = 256  # columns on a column block, unless one hypothesis needs more
AT_ONCE = 4  # columns that are squared and weighed while they are at hand


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

    @property
    def columns(self) -> Waves:
        """What stands on it, (used, n)."""
        return self.waves[: self.used]

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


@dataclass
class ColumnStore:
    """All columns of a whitened model."""

    all: list[ColumnBlock] = field(default_factory=list)
    _open: dict[tuple[int, bool], ColumnBlock] = field(default_factory=dict)
    _places: dict[int, list[tuple[ColumnBlock, int]]] = field(default_factory=dict)

    def put(
        self, channel: int, curve: bool, owner: int, numbers: Sequence[int], waves: Waves
    ) -> None:
        """Keep columns of a hypothesis in a channel; all of them stand on one column block.

        Args:
            channel: its number.
            curve: of which kind the hypothesis is.
            owner: its number.
            numbers: of the columns, (p,).
            waves: (p, n).
        """
        shelf = self._open.get((channel, curve))
        if shelf is None or shelf.used + len(numbers) > len(shelf.numbers):
            shelf = self._open[channel, curve] = ColumnBlock.empty(
                channel, max(ROOM, len(numbers)), waves.shape[1]
            )
            self.all.append(shelf)
        rows = slice(shelf.used, shelf.used + len(numbers))
        shelf.waves[rows], shelf.numbers[rows], shelf.owners[rows] = waves, numbers, owner
        for row, number in enumerate(numbers, shelf.used):
            self._places[number] = [*self._places.get(number, []), (shelf, row)]
        shelf.used += len(numbers)

    def shared(self) -> "ColumnStore":
        """Another store of the same columns, to which more can be added."""
        return ColumnStore(list(self.all), {}, dict(self._places))

    def of(self, wanted: Mask) -> list[ColumnBlock]:
        """Those on which a wanted hypothesis has a column; wanted: by the hypothesis's number.
        wanted: (hypotheses,).
        """
        return [shelf for shelf in self.all if wanted[shelf.owners[: shelf.used]].any()]

    def column(self, number: int) -> list[tuple[int, Waves]]:
        """The channels that a column changes, and its coefficients there, (n,)."""
        return [(shelf.channel, shelf.waves[row]) for shelf, row in self._places.get(number, [])]
