"""Random walk of a FOG's bias over a turn of the table, from what repeats and what dwells show."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.recordings.segmentation import Segment

PARTS = 4  # of each dwell
# of the walk's variance over the log, in units of the white variance of a part
RATIOS = np.concatenate([[0.0], np.logspace(-2, 6, 33)])


def split_dwells(segments: Sequence[Segment]) -> list[Segment]:
    """Each dwell in PARTS of equal numbers of samples."""
    found = []
    for s in segments:
        rows = np.linspace(s.first, s.last, PARTS + 1).round().astype(int)
        times = np.linspace(s.start, s.end, PARTS + 1)
        for k in range(PARTS):
            part = replace(s, start=float(times[k]), end=float(times[k + 1]))
            found.append(replace(part, first=int(rows[k]), last=int(rows[k + 1])))
    return found


def walk_density(rate: Array, variance: Array, time: Array, columns: Array) -> float:
    """Variance that the bias gains a second, (rad/s)^2/s: its posterior mean.

    The restricted likelihood of the parts' means, with the regression on the columns integrated
    out; prior: no walk or one of any size, with equal odds, its logarithm uniform.

    Args:
        rate: mean of each part, rad/s, (n,).
        variance: of it by white noise, (n,).
        time: of the middle of each part, s, (n,).
        columns: what else the parts respond to, (n, p): a constant and the Earth's rate.

    Source: Patterson and Thompson, Biometrika 58 (1971).
    """
    u, s, _ = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), full_matrices=False)
    basis = u[:, s > 1e-8 * s[0]]
    elapsed = time - time[0]
    walk = np.minimum(elapsed[:, None], elapsed[None, :]) / max(float(elapsed[-1]), 1e-9)
    white = float(np.mean(variance))
    score = np.array(
        [_restricted(rate, np.diag(variance) + r * white * walk, basis) for r in RATIOS]
    )
    prior = np.full(len(RATIOS), 0.5 / (len(RATIOS) - 1))
    prior[0] = 0.5
    weight = prior * np.exp(score - score.max())
    ratio = float(weight @ RATIOS / weight.sum())
    return ratio * white / max(float(elapsed[-1]), 1e-9)


def _restricted(y: Array, C: Array, X: Array) -> float:
    """Restricted log-likelihood of y with covariance C after regression on X."""
    factor = np.linalg.cholesky(C)
    a = np.linalg.solve(factor, np.column_stack([y, X]))
    z, A = a[:, 0], a[:, 1:]
    q, r = np.linalg.qr(A)
    left = z - q @ (q.T @ z)
    log_det = 2 * np.log(np.diag(factor)).sum() + 2 * np.log(np.abs(np.diag(r))).sum()
    return float(-(log_det + left @ left) / 2)


def walk_covariance(start: Array, end: Array, density: float) -> Array:
    """Covariance of the means of a random walk over dwells, (m, m).

    Args:
        start, end: of each dwell, s, (m,).
        density: variance gained a second.
    """
    middle = (start + end) / 2 - start[0]
    C = np.minimum(middle[:, None], middle[None, :])
    C[np.diag_indices(len(middle))] -= (end - start) / 6
    return np.asarray(density * C)
