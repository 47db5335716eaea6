"""Columns of shapes that were tried and may be tried again, as far as memory is given to them."""

from collections import OrderedDict
from collections.abc import Callable, Sequence

from tiltcal.diagnosis.model.column_block import Waves

Parts = dict[int, tuple[Sequence[int], Waves]]
"""By channel: numbers of the sizes that change it, and cosine coefficients of the changes,
(k, n).
"""
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
