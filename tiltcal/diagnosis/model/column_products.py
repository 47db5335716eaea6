"""Inner products of the columns of all hypotheses with what a model fits and what it leaves.

A pass over all columns reads everything that is stored. The models of a search share most of what
they fit, and what one leaves is what another leaves and some columns: their inner products are
combinations of those with few vectors.
"""

from collections.abc import Iterable, Sequence
from functools import cached_property

import numpy as np

from tiltcal.core.arrays import Array, Single
from tiltcal.diagnosis.model.fitted_model import FittedModel, Vector
from tiltcal.diagnosis.model.inner_products import InnerProducts
from tiltcal.diagnosis.model.normal_equations import NormalEquations, gram_of, projected_equations
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.statistics.least_squares import inverse_root

MOST = 400  # vectors whose inner products are kept


class ColumnProducts:
    """The columns under one noise, and their inner products with what models fit and leave.

    Args:
        whitened: the columns.
    """

    def __init__(self, whitened: WhitenedModel) -> None:
        self._whitened = whitened
        self._blocks = whitened.columns.blocks(np.ones(len(whitened.hypotheses), bool))
        self._grams: dict[int, Array] = {}
        self._last: tuple[FittedModel, Array] | None = None
        # by a vector's source and name, used last at the end: the source, so that no other takes
        # its place, and the inner products with all columns, (columns,)
        self._known: dict[tuple[int, object], tuple[object, Single]] = {}

    @cached_property
    def own(self) -> InnerProducts:
        """Inner products of the columns of each hypothesis."""
        return self._whitened.inner_products(self._blocks)

    def prepare(self, models: Iterable[FittedModel]) -> None:
        """Work out in one pass what ``along`` needs of several models."""
        self._of([v for fitted in models for v in _vectors(fitted)])

    def along(self, fitted: FittedModel) -> Array:
        """Inner products of all columns with the residual of a model, and with an orthonormal
        basis of what it fits, (columns, 1 + q).
        """
        if self._last is None or self._last[0] is not fitted:
            products = self._of(_vectors(fitted))
            amounts = np.array([1.0, *(amount for _, amount in fitted.moved)])
            residual = products[:, : len(amounts)] @ amounts
            basis = products[:, len(amounts) :] @ inverse_root(fitted.design.gram)
            self._last = fitted, np.column_stack([residual, basis])
        return self._last[1]

    def _of(self, vectors: Sequence[Vector]) -> Array:
        """Inner products of all columns with q vectors, (columns, q): one pass for those that are
        new.
        """
        keys = [(id(v.source), v.name) for v in vectors]
        wanted = dict(zip(keys, vectors, strict=True))
        new = {k: v for k, v in wanted.items() if k not in self._known}
        if new:
            found = self._whitened.along(self._dense(new.values()), self._blocks)
            found = np.ascontiguousarray(found.T, np.float32)
            self._known |= {
                k: (v.source, row) for (k, v), row in zip(new.items(), found, strict=True)
            }
        used = {k: self._known.pop(k) for k in wanted}
        self._known = dict(list(self._known.items())[-MOST:]) | used
        return np.array([used[k][1] for k in keys]).T.astype(float)

    def _dense(self, vectors: Iterable[Vector]) -> list[Array]:
        """Vectors by channel, (n, q) each."""
        every = list(vectors)
        dense = [np.zeros((len(root), len(every)), order="F") for root in self._whitened.roots]
        for k, vector in enumerate(every):
            for i, values in vector.parts.items():
                dense[i][:, k] = values
        return dense

    def normal_equations(self, number: int, fitted: FittedModel) -> NormalEquations:
        """Of a hypothesis and its family, in what a model leaves."""
        members = [number, *self._whitened.columns.family(number)]
        if number not in self._grams:
            self._grams[number] = gram_of(members, self._whitened)
        along = self.along(fitted)[self._whitened.columns.places(members)]
        return projected_equations(members, self._grams[number], along, self._whitened)


def _vectors(fitted: FittedModel) -> list[Vector]:
    """What the residual of a model is made of, then what the model fits."""
    return [fitted.reference, *(column for column, _ in fitted.moved), *fitted.columns]
