"""Where a whitened model keeps the columns of its hypotheses, in blocks of one channel.

Forms and curves stand in blocks of their own, as do channels: most questions are about one kind,
and pass the blocks of the other by. Products of two angles, most of the columns of a rig with many
axes, stand as factors.

Cosine coefficients of some hundred columns of one channel, in single precision.

A column is written where it stays and is read as it lies.

Columns of curves that act at many places, kept as factors: the curve once, and of each place
what a channel answers to it.

The columns are worked out where they are asked for, one place at a time: what is kept is as much
as there are curves and places, and not their product.

Columns of shapes that were tried and may be tried again, as far as memory is given to them.
"""

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from tiltcal.core.arrays import Index, Mask, Single
from tiltcal.diagnosis.data.observations import CurveFactors, SharedCurve
from tiltcal.statistics.cosine_transform import cosines, inverse_cosines

Waves = Single
Grams = list[tuple[Index, Waves]]
"""Of hypotheses with m columns each: the numbers of these, (g, m), and their inner products,
(g, m, m).
"""
TRANSFORMED = 32  # columns at once
AT_HAND = 2**17  # coefficients that are weighed and multiplied at once


Parts = dict[int, tuple[Sequence[int], Waves]]
"""By channel: numbers of the sizes that change it, and cosine coefficients of the changes,
(k, n).
"""


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


FEW = 8  # vectors that are multiplied with the answers of all places at once


@dataclass
class FactoredBlock:
    """Columns of one channel by one curve, at several places.

    Args:
        channel: its number; curve: that all places share.
        places: what the channel answers at each.
        first: number of the first column at each place; hypotheses: number of each.
    """

    channel: int
    curve: SharedCurve
    places: list[CurveFactors] = field(default_factory=list)
    first: list[int] = field(default_factory=list)
    hypotheses: list[int] = field(default_factory=list)

    def add(self, factors: CurveFactors, owner: int, first: int) -> None:
        """Add the columns of a hypothesis; first: number of the first of them."""
        self.places.append(factors)
        self.first.append(first)
        self.hypotheses.append(owner)

    @property
    def count(self) -> int:
        """Columns at each place."""
        return len(self.curve.parts[0])

    @property
    def used(self) -> int:
        """How many columns stand on it."""
        return self.count * len(self.places)

    @property
    def numbers(self) -> Index:
        """Of the columns, (used,)."""
        return (np.array(self.first, np.intp)[:, None] + np.arange(self.count)).ravel()

    @property
    def owners(self) -> Index:
        """Of the columns, (used,)."""
        return np.repeat(np.array(self.hypotheses, np.intp), self.count)

    def waves_of(self, rows: slice) -> Waves:
        """Cosine coefficients of some columns at one place, (rows, n)."""
        place, first = divmod(rows.start, self.count)
        return cosines(self.places[place].columns(slice(first, first + rows.stop - rows.start)))

    def along(self, vectors: Weighed) -> Waves:
        """Inner products of the columns with weighed vectors, (used, q): those of the curve with
        the vectors times the answers.
        """
        course = vectors.course
        found = [self._along(course[:, k : k + FEW]) for k in range(0, course.shape[1], FEW)]
        return np.concatenate([np.zeros((self.used, 0), np.float32), *found], axis=1)

    def _along(self, course: Waves) -> Waves:
        """As ``along``, of few vectors in time, (n, q)."""
        q = course.shape[1]
        # all places are of one channel
        at = self.places[0].adjoint(course)
        total = np.zeros((self.count, len(self.places) * q), np.float32)
        for k, part in enumerate(self.curve.parts):
            answers = [place.answers[k] for place in self.places]
            some = np.array([answer is not None for answer in answers])
            if some.any():
                there = np.stack([a for a in answers if a is not None], axis=1)
                turned = (there[:, :, None] * at[:, None, :]).reshape(len(at), -1)
                total[:, np.repeat(some, q)] += part @ turned
        return total.reshape(self.count, -1, q).transpose(1, 0, 2).reshape(-1, q)

    def grams(self, weight: Waves) -> Grams:
        """Inner products of the columns at each place. weight: of each coefficient, (n,)."""
        white = bool((weight == weight[0]).all())
        gram = np.empty((len(self.places), self.count, self.count), np.float32)
        for place, own in zip(self.places, gram, strict=True):
            # of white noise the inner products are those in time
            part = place.columns() if white else cosines(place.columns())
            part *= weight
            np.matmul(part, part.T, out=own)
        return [(self.numbers.reshape(-1, self.count), gram)]


Block = ColumnBlock | FactoredBlock
ROOM = 256  # columns of a block, unless one hypothesis needs more


@dataclass
class ColumnStore:
    """All columns of a whitened model."""

    all: list[Block] = field(default_factory=list)
    _open: dict[tuple[int, bool], ColumnBlock] = field(default_factory=dict)
    _of_curves: dict[tuple[int, SharedCurve], FactoredBlock] = field(default_factory=dict)
    _places: dict[int, list[tuple[Block, int, Sequence[int]]]] = field(default_factory=dict)

    def put(
        self,
        channel: int,
        curve: bool,
        owner: int,
        numbers: Sequence[int],
        columns: Waves,
        in_time: bool = False,
    ) -> None:
        """Keep columns of a hypothesis in a channel; all of them stand on one column block.

        Args:
            channel: its number.
            curve: of which kind the hypothesis is.
            owner: its number.
            numbers: of the columns, (p,).
            columns: cosine coefficients, or what they are in time, (p, n).
            in_time: whether they are in time.
        """
        block = self._open.get((channel, curve))
        if block is None or block.used + len(numbers) > len(block.numbers):
            block = self._open[channel, curve] = ColumnBlock.empty(
                channel, max(ROOM, len(numbers)), columns.shape[1]
            )
            self.all.append(block)
        self._remember(block, owner, numbers)
        block.put(owner, numbers, columns, in_time)

    def put_factors(self, channel: int, owner: int, first: int, factors: CurveFactors) -> None:
        """Keep the columns of a hypothesis in a channel as factors.

        Args:
            channel: its number; owner: of the hypothesis; first: of its first column.
            factors: of the columns.
        """
        key = (channel, factors.curve)
        block = self._of_curves.get(key)
        if block is None:
            block = self._of_curves[key] = FactoredBlock(channel, factors.curve)
            self.all.append(block)
        self._remember(block, owner, range(first, first + block.count))
        block.add(factors, owner, first)

    def _remember(self, block: Block, owner: int, numbers: Sequence[int]) -> None:
        """Where columns that are about to be put will stand."""
        places = self._places.get(owner, [])
        self._places[owner] = [*places, (block, block.used, numbers)]

    def shared(self) -> "ColumnStore":
        """Another store of the same columns, to which more can be added."""
        return ColumnStore(list(self.all), {}, {}, dict(self._places))

    def of(self, wanted: Mask) -> list[Block]:
        """Those on which a wanted hypothesis has a column; wanted: by the hypothesis's number.
        wanted: (hypotheses,).
        """
        return [block for block in self.all if wanted[block.owners[: block.used]].any()]

    def parts(self, owner: int, number: int | None = None) -> Parts:
        """The columns of a hypothesis by channel: their numbers, and cosine coefficients, (k, n).

        Args:
            owner: number of the hypothesis.
            number: of the only column that is asked for; all of them when None.
        """
        found: Parts = {}
        for block, row, numbers in self._places.get(owner, []):
            if number is None:
                found[block.channel] = numbers, block.waves_of(slice(row, row + len(numbers)))
            elif number in numbers:
                row += numbers.index(number)
                found[block.channel] = [number], block.waves_of(slice(row, row + 1))
        return found


MOST = 2**27  # bytes


class TriedShapes:
    """The columns of the shapes that were asked for last; the oldest give way to new ones."""

    def __init__(self) -> None:
        self._known: OrderedDict[str, Parts] = OrderedDict()
        self._bytes = 0

    def of(self, key: str, simulate: Callable[[], Parts]) -> Parts:
        """The columns of a shape; they are computed where they are not at hand."""
        if key in self._known:
            self._known.move_to_end(key)
            return self._known[key]
        found = self._known[key] = simulate()
        self._bytes += _size(found)
        while self._bytes > MOST and len(self._known) > 1:
            self._bytes -= _size(self._known.popitem(last=False)[1])
        return found


def _size(parts: Parts) -> int:
    return sum(waves.nbytes for _, waves in parts.values())
