"""Inner products of the columns of all hypotheses with what a model fits and what it leaves.

A pass over all columns reads everything that is stored. A model with one cause less lies in the
space of the model that it comes from, so that its inner products are combinations of known ones.
"""

from collections.abc import Sequence

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.diagnosis.model.normal_equations import NormalEquations, gram_of, projected_equations
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.statistics.projection import column_space

OUTSIDE = 1e-12  # share of a vector's energy outside a space that is more than rounding


class ColumnProducts:
    """The columns under one noise, and their inner products with the space of one model.

    Args:
        whitened: the columns.
    """

    def __init__(self, whitened: WhitenedModel) -> None:
        self._whitened = whitened
        self._blocks = whitened.columns.blocks(np.ones(len(whitened.hypotheses), bool))
        self.own = whitened.inner_products(self._blocks)
        # orthonormal, by channel, (n, m), and the inner products with it, (columns, m)
        self._space: list[Array] = []
        self._along_space = np.zeros((whitened.columns.width, 0))
        self._about: FittedModel | None = None
        self._grams: dict[int, Array] = {}
        self._last: tuple[FittedModel, Array] | None = None

    def keep(self, fitted: FittedModel) -> None:
        """Keep the inner products with the space of a model, in which all models with fewer causes
        lie.
        """
        if self._about is not fitted:
            vectors, size = _unit_vectors(fitted)
            self._about, self._space = fitted, vectors
            self._along_space = self._whitened.along(vectors, self._blocks)
            self._last = fitted, self._along_space * size

    def along(self, fitted: FittedModel) -> Array:
        """Inner products of all columns with the residual of a model, and with its basis,
        (columns, 1 + q).
        """
        if self._last is None or self._last[0] is not fitted:
            self._last = fitted, self._of(*_unit_vectors(fitted))
        return self._last[1]

    def normal_equations(self, number: int, fitted: FittedModel) -> NormalEquations:
        """Of a hypothesis and its family, in what a model leaves."""
        members = [number, *self._whitened.columns.family(number)]
        if number not in self._grams:
            self._grams[number] = gram_of(members, self._whitened)
        along = self.along(fitted)[self._whitened.columns.places(members)]
        return projected_equations(members, self._grams[number], along, self._whitened)

    def _of(self, unit: Sequence[Array], size: Array) -> Array:
        """Inner products with vectors: a pass over the columns for what is not in the space."""
        if not self._space:
            return self._whitened.along(unit, self._blocks) * size
        inside = _inner(self._space, unit)
        found = self._along_space @ inside
        new = np.flatnonzero(1 - np.einsum("mq,mq->q", inside, inside) > OUTSIDE)
        if len(new):
            pairs = zip(unit, self._space, strict=True)
            found[:, new] += self._outside([v[:, new] - V @ inside[:, new] for v, V in pairs])
        return np.asarray(found * size)

    def _outside(self, vectors: Sequence[Array]) -> Array:
        """Inner products with vectors by a pass over the columns, which costs the less, the fewer
        directions they have.
        """
        directions = column_space(np.concatenate(vectors))
        turn = directions.T @ np.concatenate(vectors)
        ends = np.cumsum([len(v) for v in vectors])[:-1]
        return self._whitened.along(np.split(directions, ends), self._blocks) @ turn


def _unit_vectors(fitted: FittedModel) -> tuple[list[Array], Array]:
    """The direction of a model's residual and its basis, by channel, (n, 1 + q), and the lengths
    that they had, (1 + q,).
    """
    length = np.sqrt(fitted.deviance) or 1.0
    pairs = zip(fitted.residual, fitted.basis, strict=True)
    vectors = [np.column_stack([r / length, Q]) for r, Q in pairs]
    return vectors, np.array([length, *np.ones(fitted.columns)])


def _inner(one: Sequence[Array], other: Sequence[Array]) -> Array:
    """Inner products of vectors by channel, (n, m) and (n, q): (m, q); most are of one channel."""
    total = np.zeros((one[0].shape[1], other[0].shape[1]))
    for a, b in zip(one, other, strict=True):
        of_a, of_b = np.flatnonzero(a.any(axis=0)), np.flatnonzero(b.any(axis=0))
        total[np.ix_(of_a, of_b)] += a[:, of_a].T @ b[:, of_b]
    return total
