"""White noise that is larger while a table moves, or where its sensor's input is large:
multiplicative heteroscedasticity (Harvey, Econometrica 44, 1976), by regression of the logarithms
of differences without slow signal.
"""

import numpy as np
from scipy.special import fdtrc

from tiltcal.core.arrays import Array, Index
from tiltcal.core.quantisation import lsb_width
from tiltcal.statistics.dwell_noise import ARITHMETIC

FOURTH = np.array([1.0, -4.0, 6.0, -4.0, 1.0])  # nothing is left of a cubic
FEW = 50  # differences in each state that determine the noise


def noise_growth(
    values: Array,
    predicted: Array,
    stop: Index,
    speed: Array,
    magnitude: Array,
    significance: float,
) -> Array | None:
    """Standard deviation of the white noise of each row in units of the least, (n,); None where it
    is not significantly larger while the table moves, nor where the input is large.

    Each five rows of one state have one fourth difference of what the prediction leaves: those of
    white noise are independent. The logarithm of its size is a constant at standstill, another
    while moving, and changes with the speed; and it changes with the magnitude of the input:
    whichever is more significant, and the other if it is significant in addition. Outliers weigh
    little in a logarithm; no difference counts as smaller than the rounding of the values makes it.
    Where most rows at standstill differ by less, no noise is there that could change with the
    input.

    Args:
        values, predicted: (n,).
        stop: number of the stop of each row, -1 while moving, (n,).
        speed: of the table, in any unit, (n,).
        magnitude: of the sensor's input, in any unit, (n,).
        significance: probability that noise alike everywhere is taken for one that grows with
            either.
    """
    size = len(FOURTH)
    n = len(values) // size * size
    state = stop[:n].reshape(-1, size)
    alone = (state == state[:, :1]).all(axis=1)
    moving = stop < 0
    if min((state[alone, 0] < 0).sum(), (state[alone, 0] >= 0).sum()) < FEW:
        return None
    least = max(lsb_width(values) / np.sqrt(12), ARITHMETIC) * np.sqrt(FOURTH @ FOURTH)
    differences = (values - predicted)[:n].reshape(-1, size)[alone] @ FOURTH
    logarithms = np.log(np.maximum(np.abs(differences), least))
    rows = [np.column_stack([moving, moving * speed])]
    if np.median(np.abs(differences[state[alone, 0] >= 0])) > least:
        rows.append(magnitude[:, None])
    means = [r[:n].reshape(-1, size, r.shape[1])[alone].mean(axis=1) for r in rows]
    kept = _significant(means, logarithms, significance / len(rows))
    if not kept:
        return None
    design = np.column_stack([np.ones(len(logarithms)), *(means[k] for k in kept)])
    found = np.linalg.lstsq(design, logarithms, rcond=None)[0]
    growth = np.exp(np.column_stack([rows[k] for k in kept]) @ found[1:])
    at_standstill = growth[~moving].min()
    return (
        None
        if growth.max() <= at_standstill
        else np.asarray(np.maximum(growth / at_standstill, 1.0))
    )


def _significant(means: list[Array], logarithms: Array, significance: float) -> list[int]:
    """Which groups of regressors change the mean of the logarithms, taken in one by one, the most
    significant first.

    Args:
        means: of each group, (m, k).
    """
    kept, left = list[int](), list(range(len(means)))
    while left:
        chances = [_chance(means[k], [means[i] for i in kept], logarithms) for k in left]
        best = int(np.argmin(chances))
        if not chances[best] < significance:
            break
        kept.append(left.pop(best))
    return kept


def _chance(new: Array, kept: list[Array], logarithms: Array) -> float:
    """P-value of regressors in addition to others: that chance explains as much (F test)."""
    ones = np.ones(len(logarithms))
    before, after = np.column_stack([ones, *kept]), np.column_stack([ones, *kept, new])
    (first, low), (second, high) = (_left(design, logarithms) for design in (before, after))
    dof = len(logarithms) - high
    if second <= 0 or high <= low or dof <= 0:  # all as small as the rounding
        return 1.0
    return float(fdtrc(high - low, dof, (first - second) / (high - low) / (second / dof)))


def _left(design: Array, logarithms: Array) -> tuple[float, int]:
    """Sum of squares that a regression leaves, and its rank."""
    found, _, rank, _ = np.linalg.lstsq(design, logarithms, rcond=None)
    return float(np.sum((logarithms - design @ found) ** 2)), int(rank)
