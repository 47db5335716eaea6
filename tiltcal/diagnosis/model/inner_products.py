"""Inner products of the columns of each hypothesis with each other."""

from collections.abc import Sequence

import numpy as np

from tiltcal.core.arrays import Array, Index, Single


class InnerProducts:
    """U'U of each hypothesis, (m, m), nothing at first.

    Args:
        counts: how many columns each hypothesis has, one after the other.
    """

    def __init__(self, counts: Sequence[int]) -> None:
        self._counts = np.array(counts, int)
        first, begins = np.cumsum(self._counts), np.cumsum(self._counts**2)
        self._begins = begins - self._counts**2
        # of each column: how many its hypothesis has, its place among them, where its row begins
        self._count = np.repeat(self._counts, self._counts)
        self._place = np.arange(len(self._count)) - np.repeat(first - self._counts, self._counts)
        self._row = np.repeat(self._begins, self._counts) + self._place * self._count
        self._values = np.zeros(int(begins[-1]) if len(begins) else 0)

    def add(self, numbers: Index, products: Single) -> None:
        """Add those of some columns of g hypotheses in one channel.

        Args:
            numbers: of the columns, (g, k); products: (g, k, k).
        """
        self._values[self._row[numbers][:, :, None] + self._place[numbers][:, None, :]] += products

    def of(self, which: Index) -> Array:
        """Of hypotheses with m columns each, (g, m, m). which: their numbers, (g,)."""
        m = int(self._counts[which[0]])
        return self._values[self._begins[which][:, None] + np.arange(m * m)].reshape(-1, m, m)
