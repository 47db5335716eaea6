"""Fits of the values of a model: to simulated readings, or to first order."""

from collections.abc import Sequence
from dataclasses import replace
from operator import itemgetter

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.diagnosis.model.block_matrix import BlockDesignMatrix
from tiltcal.diagnosis.model.fitted_model import (
    FittedModel,
    FittedTerm,
    Vector,
    stored_of,
    vectors_of,
)
from tiltcal.diagnosis.model.inner_products import column_lengths, prior_covariance, pseudo_inverse
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.effects.base import Effect

# plausible sizes: how far ordinary calibration terms may be from nothing when the data do not say
PRIOR = 5.0
RUNAWAY = 4.0  # times the least deviance so far
DAMPING = 1e-6  # the least, of columns of unit length
GROWTH = 100.0  # of the damping at each step that runs away
ROUNDS = 4  # steps: columns are right to a per cent, so each gains two digits
SETTLED = 0.1  # of deviance: less is no change


def refit(
    fitted: FittedModel,
    whitened: WhitenedModel,
    rounds: int = ROUNDS,
    about: Sequence[Effect] | None = None,
) -> FittedModel:
    """Fit all values of a fitted model to the readings.

    Args:
        fitted: the model.
        whitened: under its noise.
        rounds: steps, at most.
        about: effects that the columns are about; None: those that all fits share, else its own.
    """
    terms = [*fitted.nuisance, *fitted.terms]
    split = len(fitted.nuisance)
    units = np.array([t.hypothesis.size(n) for t in terms for n in t.names])
    lengths = [len(c.values) for c in whitened.observations.channels]
    if not lengths:  # every reading was at fault
        return fitted
    about = about or whitened.columns.shared_about or fitted.effects
    columns = vectors_of(whitened, terms, about)
    design = BlockDesignMatrix([c.parts for c in columns], lengths)
    gram = design.gram
    size = column_lengths(gram, _sized(terms))
    prior = np.array(
        [1 / PRIOR**2 if k < split else 0.0 for k, t in enumerate(terms) for _ in t.names]
    )
    relative = prior / size**2
    curvature = gram / np.outer(size, size) + np.diag(relative)
    inverse, open_ = pseudo_inverse(curvature)
    terms, residual = _descended(
        fitted.known, terms, whitened, design, curvature, prior, size, rounds
    )
    left = tuple(design.explain(residual)[1])
    covariance = inverse + prior_covariance(open_, relative)
    covariance = covariance / np.outer(size, size) * np.outer(units, units)
    return replace(
        fitted,
        nuisance=tuple(terms[:split]),
        terms=tuple(terms[split:]),
        residual=left,
        columns=tuple(columns),
        design=design,
        reference=Vector(object(), "left", dict(enumerate(left))),
        moved=(),
        covariance=covariance,
        reached=sum(float(r @ r) for r in residual),
        penalty=float(prior @ (np.array([v for t in terms for v in t.values]) / units) ** 2),
    )


def refit_about_itself(fitted: FittedModel, whitened: WhitenedModel) -> FittedModel:
    """A fit about itself, whose predictions of blocks bend as it says: bend and fit in turn, until
    the fit does not change.
    """
    for _ in range(ROUNDS):
        bent = whitened.observations.bend_at(fitted.effects)
        before, fitted = fitted, refit(fitted, whitened, about=fitted.effects)
        if not bent or abs(fitted.deviance - before.deviance) < SETTLED:
            break
    return fitted


def refit_linearly(
    fitted: FittedModel, found: Sequence[FittedTerm], whitened: WhitenedModel
) -> FittedModel:
    """Other found terms in a fitted model, their values fitted to first order: nothing is
    simulated.

    The adjustable terms keep their values, so that no column of theirs changes; what they would
    take up, without their prior, is not in the residual.
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
    residual = _put_back(fitted.residual, removed)
    terms = [*fitted.nuisance, *found]
    columns: list[Vector] = []
    for term in terms:
        columns += owned.get(id(term)) or [
            Vector(term.hypothesis, name, column)
            for name, column in zip(term.names, stored_of(whitened, [term]), strict=True)
        ]
    design = BlockDesignMatrix([c.parts for c in columns], [len(r) for r in residual])
    gram = design.gram
    size = column_lengths(gram, _sized(terms))
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


def log_det_information(fitted: FittedModel) -> float:
    """Logarithm of the determinant of the information of the adjustable terms, in units of their
    prior: what integrating over them adds to the deviance (Laplace). Under more noise it is less.
    """
    count = sum(len(t.names) for t in fitted.nuisance)
    told = PRIOR**2 * fitted.design.gram[:count, :count]
    return float(np.linalg.slogdet(np.eye(count) + told)[1]) if count else 0.0


def _sized(terms: Sequence[FittedTerm]) -> Mask:
    """Whether each value has a plausible size, (p,)."""
    return np.array([t.hypothesis.has_plausible_size for t in terms for _ in t.names], bool)


def _put_back(residual: Sequence[Array], removed: Sequence[tuple[Vector, float]]) -> list[Array]:
    """A whitened residual with so much of some columns, by channel, (n,) each."""
    found = [r.copy() for r in residual]
    for column, amount in removed:
        for i, change in column.parts.items():
            found[i] += change * amount
    return found


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
    curvature: Array,
    prior: Array,
    size: Array,
    rounds: int,
) -> tuple[list[FittedTerm], list[Array]]:
    """Levenberg-Marquardt steps with the columns kept: the most probable values that they came to,
    and the whitened residual there.

    Where the first values have no reading, they start from nothing. A step to where there is none,
    or which leaves far more than before, is taken back, and tried again with more damping: shorter,
    and most so where the readings say least.
    """
    units = np.array([t.hypothesis.size(n) for t in terms for n in t.names])
    residual, least = _left(known, terms, whitened)
    if not np.isfinite(least):
        terms = [_at_nothing(t) for t in terms]
        residual, least = _left(known, terms, whitened)
    at = np.array([v for t in terms for v in t.values]) / units
    best = least + float(prior @ at**2), terms, residual
    damping, inverse = 0.0, pseudo_inverse(curvature)[0]
    for _ in range(rounds if len(units) else 0):
        step = inverse @ ((design.along(residual) - prior * at) / size) / size
        if not np.isfinite(step).all():
            break
        moved = _moved(terms, step * units)
        left, deviance = _left(known, moved, whitened)
        if deviance < RUNAWAY * least:
            terms, residual, least = moved, left, min(least, deviance)
            at = np.array([v for t in terms for v in t.values]) / units
            best = min(best, (deviance + float(prior @ at**2), terms, residual), key=itemgetter(0))
            if np.abs(step * size).max(initial=0.0) < 1e-3:
                break
        else:
            damping = max(GROWTH * damping, DAMPING)
            inverse = pseudo_inverse(curvature + damping * np.eye(len(size)))[0]
    return best[1], best[2]


def _left(
    known: Sequence[Effect], terms: Sequence[FittedTerm], whitened: WhitenedModel
) -> tuple[list[Array], float]:
    """The whitened residual beside these terms, and its sum of squares; not finite where the model
    has no reading.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        residual = whitened.residual([*known, *(t.effect for t in terms)])
        return residual, sum(float(r @ r) for r in residual)


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
