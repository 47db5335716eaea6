"""Inner products of the columns of each hypothesis with each other, and their inverse where some
columns are dependent or hardly show.
"""

from collections.abc import Sequence

import numpy as np

from tiltcal.core.arrays import Array, Index, Mask, Single
from tiltcal.statistics.least_squares import DISTINCT


def column_lengths(gram: Array, sized: Mask) -> Array:
    """Lengths of columns, (p,). One that hardly shows at a plausible size is not scaled up: what is
    left of it may be rounding. Curves have no plausible size, and no rounding.

    Args:
        gram: inner products, (p, p).
        sized: whether each column is of a plausible size, (p,).
    """
    least = np.where(sized | (np.diag(gram) <= 0), 1.0, 0.0)
    return np.asarray(np.sqrt(np.maximum(np.diag(gram), least)))


def pseudo_inverse(gram: Array) -> tuple[Array, Array]:
    """Of the inner products of columns of unit length; what is left undetermined stays where it
    is. Returns the inverse, and the undetermined directions, (p, q).
    """
    values, vectors = np.linalg.eigh(gram)
    keep = values > DISTINCT * len(values)
    return np.asarray((vectors[:, keep] / values[keep]) @ vectors[:, keep].T), vectors[:, ~keep]


def prior_covariance(directions: Array, prior: Array) -> Array:
    """Covariance along directions that the readings leave undetermined, (p, p): that of the prior,
    whose inverse variances these are, (p,).
    """
    known = directions.T * prior @ directions
    return np.asarray(directions @ np.linalg.pinv(known, hermitian=True) @ directions.T)


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

    def less(self, along: Array) -> None:
        """Take off those of what all columns have along some directions, (columns, k)."""
        first = np.cumsum(self._counts) - self._counts
        for m in np.unique(self._counts):
            numbers = first[self._counts == m][:, None] + np.arange(m)
            part = along[numbers]
            self.add(numbers, -(part @ part.transpose(0, 2, 1)))

    def of(self, which: Index) -> Array:
        """Of hypotheses with m columns each, (g, m, m). which: their numbers, (g,)."""
        m = int(self._counts[which[0]])
        return self._values[self._begins[which][:, None] + np.arange(m * m)].reshape(-1, m, m)
