"""A finding taken out of its fitted model: what has to be explained in its place."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Columns
from tiltcal.diagnosis.model.cosine_basis import basis_of, project, projected
from tiltcal.diagnosis.model.fitted_model import FittedModel, whitened_of
from tiltcal.diagnosis.model.whitened_model import WhitenedModel


@dataclass(frozen=True)
class RemovedFinding:
    """A finding taken out of its fitted model: what has to be explained.

    Args:
        basis: of nuisance and all other findings, by channel; target: what is left without the
            finding, whitened.
        signal: the finding's fitted signal without its part in the basis.
        gain: fall of the deviance by the finding's terms at their best sizes; rank: of these.
    """

    basis: list[Array]
    target: list[Array]
    signal: list[Array]
    gain: float
    rank: int


def remove_finding(
    fitted: FittedModel,
    whitened: WhitenedModel,
    places: Sequence[int],
    beside: Sequence[Columns] = (),
) -> RemovedFinding:
    """What the terms at these places explain, and the fitted model without them; ``beside``:
    further columns of any size.
    """
    effects, lengths = fitted.effects, [len(c.values) for c in whitened.observations.channels]
    inside = [fitted.terms[k] for k in places]
    others = [*fitted.nuisance, *(t for k, t in enumerate(fitted.terms) if k not in places)]
    basis = basis_of(
        [*whitened_of(whitened, others, effects), *(whitened.whiten(c) for c in beside)], lengths
    )
    signal = [np.zeros(n) for n in lengths]
    values = [
        v / t.hypothesis.size(n) for t in inside for n, v in zip(t.names, t.values, strict=True)
    ]
    columns = whitened_of(whitened, inside, effects)
    for value, column in zip(values, columns, strict=True):
        for i, part in column.items():
            signal[i] = signal[i] + value * part
    signal = project(basis, signal)
    residual = whitened.residual(effects)
    target = project(basis, [s + r for s, r in zip(signal, residual, strict=True)])
    mine = basis_of([projected(basis, c, lengths) for c in columns], lengths)
    along = np.sum([U.T @ r for U, r in zip(mine, target, strict=True)], axis=0)
    return RemovedFinding(basis, target, signal, float(along @ along), mine[0].shape[1])
