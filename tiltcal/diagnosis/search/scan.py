"""The evidence for every hypothesis in what a fitted model leaves, in one pass over the columns."""

from collections.abc import Iterable, Sequence
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np

from tiltcal.core.arrays import Array, Index, Mask, Single
from tiltcal.diagnosis.hypotheses.priors import EXPECTED_CAUSES, log_priors
from tiltcal.diagnosis.model.fitted_model import FittedModel, Vector
from tiltcal.diagnosis.model.hypothesis_columns import HypothesisColumns
from tiltcal.diagnosis.model.inner_products import InnerProducts
from tiltcal.diagnosis.model.normal_equations import NormalEquations, gram_of, projected_equations
from tiltcal.diagnosis.model.score_test import (
    ENERGIES,
    SIZES,
    SURVIVES,
    any_of,
    lengths,
    log_bayes_factor,
)
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.statistics.least_squares import inverse_root

Kinds = tuple[Array, Mask, list[Index]]
_KEPT: "WeakKeyDictionary[HypothesisColumns, Kinds]" = WeakKeyDictionary()


def _of(columns: HypothesisColumns) -> Kinds:
    """Prior odds of each hypothesis, whether it has no plausible size, and the numbers of those
    with as many columns: under any noise the same.
    """
    known = _KEPT.get(columns)
    if known is None or len(known[0]) < len(columns.hypotheses):
        log_odds = log_priors(columns.hypotheses) + np.log(EXPECTED_CAUSES)
        unsized = np.array([not h.has_plausible_size for h in columns.hypotheses], bool)
        counts = np.array([len(h.names) for h in columns.hypotheses], int)
        alike = [np.flatnonzero(counts == m) for m in np.unique(counts)]
        known = _KEPT[columns] = log_odds, unsized, alike
    return known


def _turned(grams: Array) -> tuple[Array, Array]:
    """Eigenvalues and eigenvectors of many symmetric matrices, (g, m) and (g, m, m)."""
    if grams.shape[1] == 1:
        return grams[:, 0], np.ones_like(grams)
    share, turn = np.linalg.eigh(grams)
    return np.asarray(share), np.asarray(turn)


class Scan:
    """All hypotheses under one noise.

    Args:
        whitened: their columns under the noise.
        among: of some hypotheses among many: log prior odds of each, (hypotheses,), and the number
            of columns of all; None where the columns are those of all.

    Attributes:
        log_odds: prior odds that each is the next cause, (hypotheses,).
        width: number of columns of all that is searched.
        products: of the columns with a model.
    """

    def __init__(self, whitened: WhitenedModel, among: tuple[Array, int] | None = None) -> None:
        self._whitened = whitened
        self.log_odds, self._unsized, self._alike = _of(whitened.columns)
        self.width = whitened.columns.width
        if among is not None:
            self.log_odds, self.width = among
        self.products = ColumnProducts(whitened)

    def log_bayes_factors(self, fitted: FittedModel, coarse: Array | float = 1.0) -> Array:
        """Of each hypothesis at every size in what a model leaves, against nothing, where the
        likelihood is raised to the power 1/coarse, (hypotheses,). coarse: of all, or of each,
        (hypotheses,).
        """
        whitened, power = self._whitened, np.broadcast_to(coarse, len(self._whitened.hypotheses))
        along = self.products.along(fitted)
        found = np.zeros(len(whitened.hypotheses))
        for which, rows, gram, raw in self._groups:
            each = along[rows] / raw[:, :, None]
            inside = each[:, :, 1:]
            share, turn = _turned(gram - inside @ inside.transpose(0, 2, 1))
            a = np.einsum("gij,gi->gj", turn, each[:, :, 0])
            there = share > SURVIVES
            less = power[which][:, None]
            gain = np.where(there, a * a / np.where(there, share, 1.0), 0.0) / less
            sized = ~self._unsized[which]
            energy = np.where(raw[sized] < np.inf, raw[sized], 0.0) ** 2
            widths = share[sized] * np.einsum("gij,gi->gj", turn[sized] ** 2, energy) / less[sized]
            found[which] = self._summed(sized, gain, widths, there, less)
        return found

    @cached_property
    def _groups(self) -> list[tuple[Index, Index, Array, Array]]:
        """Hypotheses with m sizes each: their numbers, (g,), those of their columns, (g, m), and
        the inner products, (g, m, m), of these at unit length, and their lengths, (g, m).
        """
        starts, groups = np.array(self._whitened.columns.starts, int), []
        for which in self._alike:
            gram = self.products.own.of(which)
            m = gram.shape[1]
            raw = lengths(np.einsum("gii->gi", gram))
            gram = gram / (raw[:, :, None] * raw[:, None, :])
            groups.append((which, starts[which][:, None] + np.arange(m), gram, raw))
        return groups

    @staticmethod
    def _summed(sized: Mask, gain: Array, widths: Array, there: Mask, coarse: Array) -> Array:
        """Over every set of at least one direction of each hypothesis, each as probable as another,
        (g,); one that the calibration takes up says nothing. gain, there: (g, m).

        Args:
            sized: which hypotheses have plausible sizes, (g,).
            widths: variance of these along their directions over that of the estimate, (k, m).
            coarse: of each hypothesis, (g, 1).
        """
        factors = np.zeros(gain.shape)
        if not sized.all():
            energies = ENERGIES[:, None, None] / coarse[~sized]
            factors[~sized] = log_bayes_factor(gain[~sized], energies)
        if sized.any():
            sizes = np.asarray(SIZES[:, None, None] * np.where(there[sized], widths, 0.0), float)
            factors[sized] = log_bayes_factor(gain[sized], sizes)
        return any_of(np.where(there, factors, 0.0))


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
