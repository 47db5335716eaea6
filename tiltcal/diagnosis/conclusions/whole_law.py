"""The sizes of a finding's law where curves complete its form, and what each of its terms holds."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.diagnosis.model.block_matrix import projected
from tiltcal.diagnosis.model.finding_tests import RemovedFinding
from tiltcal.diagnosis.model.fitted_model import FittedModel, FittedTerm, whitened_of
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.statistics.least_squares import DISTINCT

TELLING = 0.5  # of a size: less of another one's signal is not worth a word


@dataclass(frozen=True)
class WholeLaw:
    """The terms of a finding together.

    Args:
        values: sizes of the leading term's law, SI, (q,); sigmas: their standard uncertainties.
        signals: of each term, whitened, by channel, without what calibration and other findings may
            take.
        shares: of each term, of the energy of all together.
        untold: sizes of the law that were left at zero and whose signal these poses cannot tell
            from that of the others: only sums of them are known.
    """

    values: Array
    sigmas: Array
    signals: list[list[Array]]
    shares: list[float]
    untold: tuple[str, ...] = ()


def whole_law(
    fitted: FittedModel,
    whitened: WhitenedModel,
    places: Sequence[int],
    removed: RemovedFinding,
) -> WholeLaw:
    """The law of a finding: what its leading term would be with nothing to complete its form.

    The signal of the completing terms is projected on the leading term's columns, weighed by the
    noise, without what calibration and other findings may take: the sizes are those of a fit of the
    leading term alone in the finding's place. Of a step, what creeps beside it is added: it has the
    size of what it leaves. Their covariance is that of these sums in the model that was fitted.

    Args:
        fitted: the model.
        whitened: its columns.
        places: of the finding's terms, the leading one first.
        removed: the finding taken out of the model.
    """
    inside = [fitted.terms[k] for k in places]
    lengths = [len(c.values) for c in whitened.observations.channels]
    columns = _columns(fitted, whitened, inside, removed)
    sizes = np.array([t.hypothesis.size(n) for t in inside for n in t.names])
    values = np.array([v for t in inside for v in t.values])
    lead = len(inside[0].names)
    completing = _coordinates(columns[:, :lead], columns[:, lead:])
    along = np.hstack([np.eye(lead), _as_left(inside, completing)])
    covariance = _covariance(fitted, places) / np.outer(sizes, sizes)
    variance = np.diag(along @ covariance @ along.T)
    size = float(np.sqrt(np.mean((along @ (values / sizes)) ** 2)))
    zero = _unused(inside[0])
    unused = _columns(fitted, whitened, [zero], removed)
    untold = _untold(columns, lead, unused, size)
    cuts = np.cumsum([len(t.names) for t in inside])[:-1]
    signals = [
        part @ v
        for part, v in zip(
            np.split(columns, cuts, axis=1), np.split(values / sizes, cuts), strict=True
        )
    ]
    total = np.sum(signals, axis=0)
    energy = max(float(total @ total), np.finfo(float).tiny)
    return WholeLaw(
        along @ (values / sizes) * sizes[:lead],
        np.sqrt(np.maximum(variance, 0.0)) * sizes[:lead],
        [np.split(s, np.cumsum(lengths)[:-1]) for s in signals],
        [float(s @ total) / energy for s in signals],
        tuple(n for n, u in zip(zero.names, untold, strict=True) if u),
    )


def _as_left(inside: Sequence[FittedTerm], completing: Array) -> Array:
    """What each size of the completing terms adds to those of the leading one, (q, p): the same
    size of a step that creeps is the step in the end, whatever its signal is like before.

    Args:
        inside: the terms of a finding; completing: coordinates of their signals, (q, p).
    """
    law, found = inside[0], completing.copy()
    places = [(t, name) for t in inside[1:] for name in t.names]
    for k, (term, name) in enumerate(places):
        if law.hypothesis.is_step and term.hypothesis.id == law.hypothesis.id and name in law.names:
            found[:, k] = np.equal(law.names, name)
    return found


def _unused(term: FittedTerm) -> FittedTerm:
    """The sizes of a term's law that were left at zero."""
    names = tuple(n for n in term.hypothesis.names if n not in term.names)
    return FittedTerm.start(term.hypothesis, names)


def _columns(
    fitted: FittedModel,
    whitened: WhitenedModel,
    terms: Sequence[FittedTerm],
    removed: RemovedFinding,
) -> Array:
    """Whitened columns of some terms, without what calibration and other findings may take,
    (n, p).
    """
    lengths = [len(c.values) for c in whitened.observations.channels]
    found = [
        np.concatenate(list(projected(removed.basis, c, lengths).values()))
        for c in whitened_of(whitened, terms, fitted.effects)
    ]
    return np.column_stack(found) if found else np.zeros((sum(lengths), 0))


def _untold(columns: Array, lead: int, unused: Array, size: float) -> Mask:
    """Which sizes that were left at zero the recording cannot separate from those of the leading
    term, (q,).

    Args:
        columns: of all terms of the finding, the leading ones first, (n, p).
        lead: how many these are.
        unused: of the sizes left at zero, (n, q).
        size: standard deviation of each of them before the recording, of its plausible size.
    """
    own = unused - columns @ _coordinates(columns, unused)
    known = own.T @ own * size**2 + np.eye(unused.shape[1])
    left = np.linalg.inv(known) * size**2
    taken = _coordinates(columns[:, :lead], unused)
    alike = (np.abs(taken) > TELLING).any(axis=0) & (np.diag(left) > size**2 / 2)
    return np.asarray(alike)


def _coordinates(onto: Array, columns: Array) -> Array:
    """Coordinates of the projection of some columns, (n, p), on others, (n, q): (q, p)."""
    length = np.linalg.norm(onto, axis=0)
    length[length == 0] = 1.0
    least = float(np.sqrt(DISTINCT * onto.shape[1]))
    found = np.linalg.lstsq(onto / length, columns, rcond=least)[0]
    return np.asarray(found / length[:, None])


def _covariance(fitted: FittedModel, places: Sequence[int]) -> Array:
    """Joint covariance of the values of some found terms, SI, (p, p)."""
    assert fitted.covariance is not None
    terms = [*fitted.nuisance, *fitted.terms]
    starts = np.cumsum([0, *(len(t.names) for t in terms)])
    wanted = [k + len(fitted.nuisance) for k in places]
    index = [i for k in wanted for i in range(starts[k], starts[k + 1])]
    return fitted.covariance[np.ix_(index, index)]
