"""A fitted model of a recording: calibration terms and hypotheses at fitted sizes, with the
residual.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Columns
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.model.block_matrix import BlockDesignMatrix
from tiltcal.diagnosis.model.hypothesis_columns import HypothesisColumns
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.effects.base import Effect


@dataclass(frozen=True)
class FittedTerm:
    """A hypothesis with some of its sizes fitted.

    Args:
        hypothesis: who; names: the sizes in use; values: SI, of the same length.
        host: the hypothesis whose form it only completes; None when it stands by itself.
    """

    hypothesis: Hypothesis
    names: tuple[str, ...]
    values: tuple[float, ...]
    host: Hypothesis | None = None

    @classmethod
    def start(cls, hypothesis: Hypothesis, names: Sequence[str] | None = None) -> "FittedTerm":
        """All sizes (or those named) at zero, or where the scenario has them."""
        used = hypothesis.names if names is None else tuple(names)
        return cls(hypothesis, used, (0.0,) * len(used))

    @property
    def effect(self) -> Effect:
        """The effect at the fitted sizes."""
        return self.hypothesis.at(dict(zip(self.names, self.values, strict=True)))


@dataclass(frozen=True)
class Vector:
    """Whitened cosine coefficients by channel, and what they are known by under one noise.

    Args:
        source: a hypothesis as it is stored, or one fit to the readings; name: among its vectors.
        parts: by channel, (n,) each.
    """

    source: object
    name: object
    parts: Columns


@dataclass(frozen=True)
class FittedModel:
    """Fitted terms.

    Args:
        known: effects at stated values; nuisance: the adjustable terms; terms: what was found.
        residual: whitened cosine coefficients of what is left, by channel.
        columns: whitened change per plausible size of each value, nuisance first; design: of them.
        reference: the residual of the model that was fitted to the readings last; moved: the
            columns, and how much of each, that this one's has beside it.
        covariance: of all values in order, nuisance first, SI.
        reached: sum of squares of the whitened residual at these values; None where they are fitted
            to first order only.
        penalty: -2 log prior of the adjustable terms at their values.
    """

    known: tuple[Effect, ...]
    nuisance: tuple[FittedTerm, ...]
    terms: tuple[FittedTerm, ...] = ()
    residual: tuple[Array, ...] = ()
    columns: tuple[Vector, ...] = ()
    design: BlockDesignMatrix = field(default_factory=lambda: BlockDesignMatrix([], []))
    reference: Vector = field(default_factory=lambda: Vector(None, None, {}))
    moved: tuple[tuple[Vector, float], ...] = ()
    covariance: Array | None = None
    reached: float | None = None
    penalty: float = 0.0

    @property
    def effects(self) -> list[Effect]:
        """All effects at their values."""
        return [*self.known, *(t.effect for t in (*self.nuisance, *self.terms))]

    @cached_property
    def basis(self) -> tuple[Array, ...]:
        """An orthonormal basis of all fitted columns, by channel, (n, q) each."""
        return tuple(self.design.basis())

    @property
    def rank(self) -> int:
        """Number of independent columns that were fitted."""
        return self.basis[0].shape[1] if self.basis else 0

    @property
    def deviance(self) -> float:
        """Sum of squares of the whitened residual: at the fitted values, so that no cause is given
        what only a step beyond the range of the model would explain.
        """
        linear = float(sum(r @ r for r in self.residual))
        return linear if self.reached is None else self.reached

    def findings(self) -> list[list[int]]:
        """Places of the terms of each finding: the term itself and what completes its form."""
        found: list[list[int]] = []
        for k, term in enumerate(self.terms):
            if term.host is None:
                found.append([k])
            else:
                found[-1].append(k)
        return found

    def sigmas(self, k: int) -> Array:
        """Standard uncertainties of the values of found term k, SI. (values,)."""
        assert self.covariance is not None
        return self._sigmas(len(self.nuisance) + k)

    def calibration(self) -> list[Effect]:
        """The adjustable terms, with their standard uncertainties where they were fitted."""
        if self.covariance is None:
            return [t.effect for t in self.nuisance]
        return [
            replace(t.effect, sigmas=dict(zip(t.names, self._sigmas(k).tolist(), strict=True)))
            for k, t in enumerate(self.nuisance)
        ]

    def _sigmas(self, place: int) -> Array:
        """Of the values of a term among all, nuisance first, SI. (values,)."""
        assert self.covariance is not None
        every = [*self.nuisance, *self.terms]
        start = sum(len(t.names) for t in every[:place])
        part = slice(start, start + len(every[place].names))
        return np.sqrt(np.maximum(np.diag(self.covariance)[part], 0.0))


def waves_of(
    columns: HypothesisColumns, terms: Sequence[FittedTerm], about: Sequence[Effect]
) -> list[Columns]:
    """Change of the readings per plausible size of each fitted value, as cosine coefficients, SI.
    About the model that the hypotheses stand for they are in store.
    """
    stored = tuple(about) == columns.shared_about
    found: list[Columns] = []
    for term in terms:
        hypothesis = term.hypothesis
        if stored and hypothesis.effect.role != "calibration":
            found += [columns.stored(hypothesis, name) for name in term.names]
        else:
            found += columns.all_waves(hypothesis, term.names, about)
    return found


def whitened_of(
    whitened: WhitenedModel, terms: Sequence[FittedTerm], about: Sequence[Effect]
) -> list[Columns]:
    """The same, whitened."""
    return whitened.weighed_together(waves_of(whitened.columns, terms, about))


def stored_of(whitened: WhitenedModel, terms: Sequence[FittedTerm]) -> list[Columns]:
    """As ``whitened_of``, about the model that the hypotheses stand for: what a trial needs."""
    return whitened.weighed_together(
        [whitened.columns.stored(t.hypothesis, name) for t in terms for name in t.names]
    )


def vectors_of(
    whitened: WhitenedModel, terms: Sequence[FittedTerm], about: Sequence[Effect]
) -> list[Vector]:
    """Change of the readings per plausible size of each fitted value. Where the effects that it is
    about are those that all fits share, they share these vectors too under one noise.
    """
    own = whitened_of(whitened, terms, about)
    if tuple(about) != whitened.columns.shared_about:
        source = object()
        return [Vector(source, k, c) for k, c in enumerate(own)]
    named = ((term.hypothesis, n) for term in terms for n in term.names)
    return [Vector(h, n, c) for (h, n), c in zip(named, own, strict=True)]


def summed(terms: Sequence[FittedTerm], whitened: WhitenedModel) -> Columns:
    """What some terms do to the readings together, about the model that the hypotheses stand for:
    cosine coefficients, SI, by channel.
    """
    total: Columns = {}
    for term in terms:
        for name, value in zip(term.names, term.values, strict=True):
            share = value / term.hypothesis.size(name)
            for i, wave in whitened.columns.stored(term.hypothesis, name).items():
                total[i] = total.get(i, 0.0) + wave * share
    return total
