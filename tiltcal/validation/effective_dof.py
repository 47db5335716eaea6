"""Degrees of freedom of a mean square error: how much it varies from run to run."""

from collections.abc import Sequence

import numpy as np

from tiltcal.core.arrays import Array


def effective_dof(weights: Array, constant: float = 0.0) -> float:
    """Degrees of freedom of ``Q = sum of w_k chi2(1)``: the sum of the weights over the largest.

    A chi-square with so many, scaled to the mean of Q, has an upper tail at least as long as that
    of Q: the chi-square mixture of this sum and largest weight that varies most.

    Args:
        weights: w, (k,); negative ones are rounding errors and count as zero.
        constant: mean square of a part that does not vary. It raises the sum; the cross terms
            between it and the part that varies are counted in.

    Returns:
        At least 1. Source: M. E. Bock et al., Inequalities for linear combinations of gamma random
        variables, Canad. J. Statist. 15 (1987) 387.
    """
    positive = np.maximum(np.asarray(weights, dtype=float), 0.0)
    total = float(positive.sum()) + constant
    largest = float(positive.max(initial=0.0))
    if not np.isfinite(total) or largest == 0.0:
        return 1.0
    return max(total / (largest * (1 + constant / total)), 1.0)


def dof_of_changes(changes: Sequence[Array]) -> float:
    """Degrees of freedom of the mean square of ``sum of z_k d_k``, z standard normal.

    Args:
        changes: d, what each principal error of the parameters does to the result, (n,) each.
    """
    if not changes:
        return 1.0
    D = np.array(changes)
    return effective_dof(np.asarray(np.linalg.eigvalsh(D @ D.T)))
