"""A fitted model of a recording: calibration terms and hypotheses at fitted sizes, with the
residual.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Columns, Observations
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.model.block_matrix import BlockDesignMatrix
from tiltcal.diagnosis.model.gram_inverse import (
    column_lengths,
    prior_covariance,
    pseudo_inverse,
)
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.effects.base import Effect

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
        whitened.weighed(waves)
        for t in terms
        for waves in whitened.columns.all_waves(t.hypothesis, t.names, effects)
    ]


def stored_of(whitened: WhitenedModel, terms: Sequence[FittedTerm]) -> list[Columns]:
    """As ``whitened_of``, about the model that the hypotheses stand for: what a trial needs."""
    return [
        whitened.weighed(whitened.columns.stored(t.hypothesis, name))
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
    gram = design.gram
    size = column_lengths(gram)
    prior = np.array(
        [1 / PRIOR**2 if k < split else 0.0 for k, t in enumerate(terms) for _ in t.names]
    )
    relative = prior / size**2
    inverse, open_ = pseudo_inverse(gram / np.outer(size, size) + np.diag(relative))
    terms, residual = _descended(
        fitted.known, terms, whitened, design, inverse, prior, size, rounds
    )
    left = tuple(design.explain(residual)[1])
    source = object()
    covariance = inverse + prior_covariance(open_, relative)
    covariance = covariance / np.outer(size, size) * np.outer(units, units)
    return replace(
        fitted,
        nuisance=tuple(terms[:split]),
        terms=tuple(terms[split:]),
        residual=left,
        columns=tuple(Vector(source, k, c) for k, c in enumerate(columns)),
        design=design,
        reference=Vector(source, "left", dict(enumerate(left))),
        moved=(),
        covariance=covariance,
        reached=sum(float(r @ r) for r in residual),
    )


def refit_linearly(
    fitted: FittedModel, found: Sequence[FittedTerm], whitened: WhitenedModel
) -> FittedModel:
    """Other found terms in a fitted model, their values fitted to first order: nothing is
    simulated.

    The adjustable terms stay at their values, so that no column of theirs changes; what they would
    take up is not in the residual.
    """
    owned, start = dict[int, tuple[Vector, ...]](), 0
    for term in (*fitted.nuisance, *fitted.terms):
        owned[id(term)] = fitted.columns[start : start + len(term.names)]
        start += len(term.names)
    kept = {id(t) for t in found}
    removed = [
        (column, value / term.hypothesis.size(name))
        for term in fitted.terms
        if id(term) not in kept
        for name, value, column in zip(term.names, term.values, owned[id(term)], strict=True)
    ]
    residual = [r.copy() for r in fitted.residual]
    for column, amount in removed:
        for i, change in column.parts.items():
            residual[i] += change * amount
    terms = [*fitted.nuisance, *found]
    columns: list[Vector] = []
    for term in terms:
        columns += owned.get(id(term)) or [
            Vector(term.hypothesis, name, column)
            for name, column in zip(term.names, stored_of(whitened, [term]), strict=True)
        ]
    design = BlockDesignMatrix([c.parts for c in columns], [len(r) for r in residual])
    gram = design.gram
    size = column_lengths(gram)
    units = np.array([t.hypothesis.size(n) for t in terms for n in t.names])
    inverse, _ = pseudo_inverse(gram / np.outer(size, size))
    step = inverse @ (design.along(residual) / size) / size
    new = _moved([t if id(t) in owned else _at_nothing(t) for t in terms], step * units)
    taken, left = design.explain(residual)
    moved = (*fitted.moved, *removed, *zip(columns, (-taken).tolist(), strict=True))
    return replace(
        fitted,
        terms=tuple(new[len(fitted.nuisance) :]),
        residual=tuple(left),
        columns=tuple(columns),
        design=design,
        moved=_summed_up(moved),
        covariance=None,
        reached=None,
    )


def _summed_up(moved: Sequence[tuple[Vector, float]]) -> tuple[tuple[Vector, float], ...]:
    """How much of each column there is in all."""
    total: dict[int, tuple[Vector, float]] = {}
    for column, amount in moved:
        total[id(column)] = column, amount + total.get(id(column), (column, 0.0))[1]
    return tuple(total.values())


def _at_nothing(term: FittedTerm) -> FittedTerm:
    return replace(term, values=(0.0,) * len(term.names))


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
