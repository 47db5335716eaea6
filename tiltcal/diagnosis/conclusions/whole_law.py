"""The sizes of a finding's law where curves complete its form, and what each of its terms holds."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.model.cosine_basis import projected
from tiltcal.diagnosis.model.fitted_model import FittedModel, whitened_of
from tiltcal.diagnosis.model.removed_finding import RemovedFinding
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.statistics.projection import DISTINCT


@dataclass(frozen=True)
class WholeLaw:
    """The terms of a finding together.

    Args:
        values: sizes of the leading term's law, SI, (q,); sigmas: their standard uncertainties.
        signals: of each term, whitened, by channel, without what calibration and other findings may
            take.
        shares: of each term, of the energy of all together.
    """

    values: Array
    sigmas: Array
    signals: list[list[Array]]
    shares: list[float]


def whole_law(
    fitted: FittedModel,
    whitened: WhitenedModel,
    places: Sequence[int],
    removed: RemovedFinding,
) -> WholeLaw:
    """The law of a finding: what its leading term would be with nothing to complete its form.

    The signal of the completing terms is projected on the leading term's columns, weighed by the
    noise, without what calibration and other findings may take: the sizes are those of a fit of the
    leading term alone in the finding's place. Their covariance is that of these sums.

    Args:
        fitted: the model; whitened: its columns.
        places: of the finding's terms, the leading one first.
        removed: the finding taken out of the model.
    """
    inside = [fitted.terms[k] for k in places]
    lengths = [len(c.values) for c in whitened.observations.channels]
    columns = np.column_stack(
        [
            np.concatenate(list(projected(removed.basis, c, lengths).values()))
            for c in whitened_of(whitened, inside, fitted.effects)
        ]
    )
    sizes = np.array([t.hypothesis.size(n) for t in inside for n in t.names])
    values = np.array([v for t in inside for v in t.values])
    lead = len(inside[0].names)
    along = np.hstack([np.eye(lead), _coordinates(columns[:, :lead], columns[:, lead:])])
    covariance = _covariance(fitted, places) / np.outer(sizes, sizes)
    variance = np.diag(along @ covariance @ along.T)
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
    )


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
