"""A fitted model of a recording: calibration terms and hypotheses at fitted sizes, with the
residual.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Columns, Observations
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.model.block_matrix import BlockDesignMatrix
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.effects.base import Effect
from tiltcal.statistics.projection import DISTINCT

# plausible sizes: how far ordinary calibration terms may be from nothing when the data do not say
PRIOR = 5.0
RUNAWAY = 4.0  # times the least deviance so far
ROUNDS = 4  # of Gauss-Newton: columns are exact to a per cent, so each round gains two digits


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
class FittedModel:
    """Fitted terms.

    Args:
        known: effects at stated values; nuisance: the adjustable terms; terms: what was found.
        residual: whitened cosine coefficients of what is left, by channel; basis: of all fitted
            columns.
        covariance: of all values in order, nuisance first, SI.
    """

    known: tuple[Effect, ...]
    nuisance: tuple[FittedTerm, ...]
    terms: tuple[FittedTerm, ...] = ()
    residual: tuple[Array, ...] = ()
    basis: tuple[Array, ...] = ()
    covariance: Array | None = None

    @property
    def effects(self) -> list[Effect]:
        """All effects at their values."""
        return [*self.known, *(t.effect for t in (*self.nuisance, *self.terms))]

    @property
    def columns(self) -> int:
        """Number of independent columns that were fitted."""
        return self.basis[0].shape[1] if self.basis else 0

    @property
    def deviance(self) -> float:
        """Sum of squares of the whitened residual."""
        return float(sum(r @ r for r in self.residual))

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
        """Standard uncertainties of the values of found term k, SI."""
        assert self.covariance is not None
        before = [*self.nuisance, *self.terms[:k]]
        start = sum(len(t.names) for t in before)
        part = slice(start, start + len(self.terms[k].names))
        return np.sqrt(np.maximum(np.diag(self.covariance)[part], 0.0))


def whitened_of(
    whitened: WhitenedModel, terms: Sequence[FittedTerm], effects: Sequence[Effect]
) -> list[Columns]:
    """Change of the readings per plausible size of each fitted value, as whitened cosine
    coefficients.
    """
    return [
        whitened.weighed(whitened.columns.waves(t.hypothesis, name, effects))
        for t in terms
        for name in t.names
    ]


def columns_of(
    observations: Observations, terms: Sequence[FittedTerm], effects: Sequence[Effect]
) -> list[Columns]:
    """Change of the readings per plausible size of each fitted value, SI."""
    return [
        observations.changes(t.hypothesis.alone(name), effects) for t in terms for name in t.names
    ]


def summed(
    terms: Sequence[FittedTerm], observations: Observations, effects: Sequence[Effect]
) -> Columns:
    """What some terms do to the readings together, the effects being there, SI, by channel."""
    total: Columns = {}
    for term in terms:
        for name, value in zip(term.names, term.values, strict=True):
            for i, column in observations.changes(term.hypothesis.alone(name), effects).items():
                total[i] = total.get(i, 0.0) + column * (value / term.hypothesis.size(name))
    return total


def refit(fitted: FittedModel, whitened: WhitenedModel, rounds: int = ROUNDS) -> FittedModel:
    """Fit all values of a fitted model to the readings, under the whitened model's noise."""
    terms = [*fitted.nuisance, *fitted.terms]
    split = len(fitted.nuisance)
    units = np.array([t.hypothesis.size(n) for t in terms for n in t.names])
    lengths = [len(c.values) for c in whitened.observations.channels]
    if not lengths:  # every reading was at fault
        return fitted
    effects = fitted.effects
    columns = whitened_of(whitened, terms, effects)
    design = BlockDesignMatrix(columns, lengths)
    gram = design.gram()
    size = np.sqrt(np.diag(gram))
    size[size == 0] = 1.0
    prior = np.array(
        [1 / PRIOR**2 if k < split else 0.0 for k, t in enumerate(terms) for _ in t.names]
    )
    inverse = _pseudo_inverse(gram / np.outer(size, size) + np.diag(prior / size**2))
    terms, residual = _descended(
        fitted.known, terms, whitened, design, inverse, prior, size, rounds
    )
    basis = design.basis()
    along = sum(
        (Q.T @ r for Q, r in zip(basis, residual, strict=True)), np.zeros(basis[0].shape[1])
    )
    residual = [r - Q @ along for Q, r in zip(basis, residual, strict=True)]
    covariance = inverse / np.outer(size, size) * np.outer(units, units)
    return replace(
        fitted,
        nuisance=tuple(terms[:split]),
        terms=tuple(terms[split:]),
        residual=tuple(residual),
        basis=tuple(basis),
        covariance=covariance,
    )


def _descended(
    known: Sequence[Effect],
    terms: list[FittedTerm],
    whitened: WhitenedModel,
    design: BlockDesignMatrix,
    inverse: Array,
    prior: Array,
    size: Array,
    rounds: int,
) -> tuple[list[FittedTerm], list[Array]]:
    """Gauss-Newton steps with the columns kept, and the whitened residual where they end.

    A step to where the model has no reading, or leaves far more than before, is taken back, and is
    the last.
    """
    units = np.array([t.hypothesis.size(n) for t in terms for n in t.names])
    residual = whitened.residual([*known, *(t.effect for t in terms)])
    least = sum(float(r @ r) for r in residual)
    for _ in range(rounds if len(units) else 0):
        at = np.array([v for t in terms for v in t.values]) / units
        step = inverse @ ((design.along(residual) - prior * at) / size) / size
        if not np.isfinite(step).all():
            break
        moved = _moved(terms, step * units)
        left = whitened.residual([*known, *(t.effect for t in moved)])
        deviance = sum(float(r @ r) for r in left)
        if not deviance < RUNAWAY * least:
            break
        terms, residual, least = moved, left, min(least, deviance)
        if np.abs(step * size).max(initial=0.0) < 1e-3:
            break
    return terms, residual


def _pseudo_inverse(gram: Array) -> Array:
    """Of the inner products of columns of unit length; what is left undetermined stays where it
    is.
    """
    values, vectors = np.linalg.eigh(gram)
    keep = values > DISTINCT * len(values)
    return np.asarray((vectors[:, keep] / values[keep]) @ vectors[:, keep].T)


def _moved(terms: Sequence[FittedTerm], step: Array) -> list[FittedTerm]:
    found, start = [], 0
    for t in terms:
        end = start + len(t.names)
        found.append(
            replace(
                t,
                values=tuple(float(v + s) for v, s in zip(t.values, step[start:end], strict=True)),
            )
        )
        start = end
    return found
