"""The evidence for every hypothesis in what a fitted model leaves, in one pass over the columns."""

from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np

from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.diagnosis.hypotheses.priors import EXPECTED_CAUSES, log_priors
from tiltcal.diagnosis.model.bayes_factors import ENERGIES, SIZES, any_of, log_bayes_factor
from tiltcal.diagnosis.model.column_products import ColumnProducts
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.diagnosis.model.hypothesis_columns import HypothesisColumns
from tiltcal.diagnosis.model.score_test import SURVIVES, lengths
from tiltcal.diagnosis.model.whitened_model import WhitenedModel

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

    Attributes:
        log_odds: prior odds that each is the next cause, (hypotheses,).
        products: of the columns with a model.
    """

    def __init__(self, whitened: WhitenedModel) -> None:
        self._whitened = whitened
        self.log_odds, self._unsized, self._alike = _of(whitened.columns)
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
            inside = along[rows, 1:]
            rest = gram - inside @ inside.transpose(0, 2, 1)
            share, turn = _turned(rest / (raw[:, :, None] * raw[:, None, :]))
            a = np.einsum("gij,gi->gj", turn, along[rows, 0] / raw)
            there = share > SURVIVES
            gain = np.where(there, a * a / np.where(there, share, 1.0), 0.0)
            sized = share * np.einsum("gij,gi->gj", turn**2, np.where(raw < np.inf, raw, 0.0) ** 2)
            less = power[which][:, None]
            found[which] = self._summed(which, gain / less, sized / less, there, less)
        return found

    @cached_property
    def _groups(self) -> list[tuple[Index, Index, Array, Array]]:
        """Hypotheses with m sizes each: their numbers, (g,), those of their columns, (g, m), and
        the inner products, (g, m, m), and lengths of these, (g, m).
        """
        starts, groups = np.array(self._whitened.columns.starts, int), []
        for which in self._alike:
            gram = self.products.own.of(which)
            m = gram.shape[1]
            raw = lengths(np.einsum("gii->gi", gram))
            groups.append((which, starts[which][:, None] + np.arange(m), gram, raw))
        return groups

    def _summed(self, which: Index, gain: Array, sized: Array, there: Mask, coarse: Array) -> Array:
        """Over every set of at least one direction of each hypothesis, each as probable as another,
        (g,); one that the calibration takes up says nothing. gain, sized, there: (g, m).

        coarse: of each hypothesis, (g, 1).
        """
        unsized = self._unsized[which]
        factors = np.zeros(gain.shape)
        if unsized.any():
            energies = ENERGIES[:, None, None] / coarse[unsized]
            factors[unsized] = log_bayes_factor(gain[unsized], energies)
        if not unsized.all():
            sizes = np.asarray(SIZES[:, None, None] * np.where(there, sized, 0.0)[~unsized], float)
            factors[~unsized] = log_bayes_factor(gain[~unsized], sizes)
        return any_of(np.where(there, factors, 0.0))
