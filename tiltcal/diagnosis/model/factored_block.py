"""Columns of curves that act at many places, kept as factors: the curve once, and of each place
what a channel answers to it.

The columns are worked out where they are asked for, one place at a time: what is kept is as much
as there are curves and places, and not their product.
"""

from dataclasses import dataclass, field

import numpy as np

from tiltcal.core.arrays import Index
from tiltcal.diagnosis.data.curve_factors import CurveFactors, SharedCurve
from tiltcal.diagnosis.model.column_block import Grams, Waves, Weighed
from tiltcal.statistics.cosine_transform import cosines

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
