"""White noise that is larger while a table moves: multiplicative heteroscedasticity (Harvey,
Econometrica 44, 1976), by regression of the logarithms of differences that hold no slow
law.
"""

import numpy as np
from scipy.special import fdtrc

from tiltcal.core.arrays import Array, Index
from tiltcal.core.quantisation import code_width
from tiltcal.statistics.dwell_noise import ARITHMETIC

FOURTH = np.array([1.0, -4.0, 6.0, -4.0, 1.0])  # nothing is left of a cubic
FEW = 50  # differences in each state that tell the noise


def noise_growth(
    values: Array, predicted: Array, stop: Index, speed: Array, significance: float
) -> Array | None:
    """Standard deviation of the white noise of each row in units of that at rest, (n,), at least 1;
    None where it is not significantly larger while the table moves.

    Each five rows of one state have one fourth difference of what the prediction leaves: those of
    white noise are independent. The logarithm of its size is a constant at rest, another while
    moving, and changes with the speed. Outliers weigh little in a logarithm; no difference counts
    as smaller than the rounding of the values makes it.

    Args:
        values, predicted: (n,).
        stop: number of the stop of each row, -1 while moving, (n,).
        speed: of the table, in any unit, (n,).
        significance: probability that noise alike in both states is taken for one that grows.
    """
    size = len(FOURTH)
    n = len(values) // size * size
    state = stop[:n].reshape(-1, size)
    alone = (state == state[:, :1]).all(axis=1)
    moving = state[alone, 0] < 0
    if min(moving.sum(), (~moving).sum()) < FEW:
        return None
    least = max(code_width(values) / np.sqrt(12), ARITHMETIC) * np.sqrt(FOURTH @ FOURTH)
    differences = (values - predicted)[:n].reshape(-1, size)[alone] @ FOURTH
    logarithms = np.log(np.maximum(np.abs(differences), least))
    mean_speed = speed[:n].reshape(-1, size)[alone].mean(axis=1)
    design = np.column_stack([np.ones(len(moving)), moving, moving * mean_speed])
    found, _, rank, _ = np.linalg.lstsq(design, logarithms, rcond=None)
    left = float(np.sum((logarithms - design @ found) ** 2))
    explained = float(np.sum((logarithms - logarithms.mean()) ** 2)) - left
    if left <= 0:  # all as small as the rounding
        return None
    statistic = explained / (rank - 1) / (left / (len(logarithms) - rank))
    growth = np.exp((found[1] + found[2] * speed) * (stop < 0))
    if growth.max() <= 1 or fdtrc(rank - 1, len(logarithms) - rank, statistic) >= significance:
        return None
    return np.asarray(np.maximum(growth, 1.0))
