"""How good an information matrix is, and the slope of that in every element. All in nats, larger is
better.

- ``D``: gain of 1/2 log det of the information on the parameters of interest over the prior,
  nuisances fitted.
- ``A``: (p/2) log of the reciprocal of the mean posterior variance, in units of the prior.
- ``I``: the same of the mean square tilt error over the working range (``tilt`` is a synonym).
- ``both``: the mean of D and I: near the best of either, the default.
"""

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.design.model import Model

NONE = (-np.inf, -np.inf)
STEEP = 10.0  # nats by which a nat below a floor counts: beyond any trade of one half for the other
CRITERIA = ("both", "tilt", "D", "A", "I")


def gain(information: Array, interest: Mask) -> float:
    """Nats gained on the parameters of interest, the others fitted: 1/2 log det of their marginal
    information.

    Args:
        information: (p, p).
        interest: (p,).
    """
    whole = np.linalg.slogdet(information)[1]
    return float(whole - np.linalg.slogdet(information[np.ix_(~interest, ~interest)])[1]) / 2


def tilt_rms(information: Array, loss: Array) -> float:
    """Rms tilt error per axis over the working range, rad. information, loss: (p, p)."""
    return float(np.sqrt(np.sum(np.linalg.inv(information) * loss)))


def value(information: Array, model: Model, criterion: str) -> float:
    """The criterion. information: (p, p)."""
    return value_and_slope(information, model, criterion)[0]


def value_and_slope(
    information: Array, model: Model, criterion: str, floors: tuple[float, float] = NONE
) -> tuple[float, Array]:
    """The criterion and its derivative by the information matrix, (p, p).

    Args:
        information: (p, p).
        model: parameters and loss.
        criterion: name.
        floors: of D and of the tilt, nats, below which ``both`` falls steeply: what lies above
            them in both comes before what lies above in the mean.
    """
    C = np.asarray(np.linalg.inv(information), dtype=np.float64)
    if criterion == "D":
        return _gain(information, C, model.interest)
    if criterion == "A":
        return _trace(C, np.diag(model.interest.astype(float)), int(model.interest.sum()))
    tilt = _trace(C, model.loss, int(model.interest.sum()))
    if criterion in ("I", "tilt"):
        return tilt
    nats = _gain(information, C, model.interest)
    found, slope = (tilt[0] + nats[0]) / 2, (tilt[1] + nats[1]) / 2
    for (part, by_part), floor in zip((nats, tilt), floors, strict=True):
        if part < floor:
            found, slope = found - STEEP * (floor - part), slope + STEEP * by_part
    return found, slope


def _gain(information: Array, C: Array, interest: Mask) -> tuple[float, Array]:
    slope = C / 2
    if not interest.all():
        index = np.ix_(~interest, ~interest)
        slope[index] -= np.linalg.inv(information[index]) / 2
    return gain(information, interest), slope


def _trace(C: Array, W: Array, count: int) -> tuple[float, Array]:
    total = float(np.sum(C * W))
    return -count / 2 * float(np.log(total)), count / 2 * (C @ W @ C) / total
