"""Where a whitened model keeps the columns of its hypotheses, in blocks of one channel.

Forms and curves stand in blocks of their own, as do channels: most questions are about one kind,
and pass the blocks of the other by. Products of two angles, most of the columns of a rig with many
axes, stand as factors.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

from tiltcal.core.arrays import Mask
from tiltcal.diagnosis.data.curve_factors import CurveFactors, SharedCurve
from tiltcal.diagnosis.model.column_block import ColumnBlock, Waves
from tiltcal.diagnosis.model.factored_block import FactoredBlock
from tiltcal.diagnosis.model.tried_shapes import Parts

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
