"""Location of dwells by mean, median, M-estimators and the mean of inliers, each with the
uncertainty it really has.

The variance of an M-estimator is ``<psi^2> / <psi'>^2 / n`` (Huber 1981, eq. 3.2.14); noise is
common to all dwells, so scale, <psi^2> and <psi'> are pooled over them.

A median of quantised data sticks to quantisation steps: where the noise is below some three LSB
it is no estimate of anything between them. ``inliers`` uses the median only to reject and then
takes a mean, which keeps the dither.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.statistics.dwell_noise import ARITHMETIC, MAD_TO_SIGMA, pooled_noise

ESTIMATORS = ("mean", "median", "huber", "tukey", "inliers")
# tuning constants, in standard deviations: 95 % efficiency; rejection
HUBER, TUKEY, REJECT = (
    1.345,
    4.685,
    3.5,
)
LEAST_SLOPE = 0.1  # of a sample that is hardly noise at all
BAND = 0.15  # relative half-width in which the density at the rejection limit is counted


@dataclass(frozen=True)
class Locations:
    """Locations of some dwells.

    Args:
        values: (m, k).
        unit: covariance of a location times the number of samples, (k, k), with the inflation by
            correlated noise.
        rejected: share of samples that weigh nothing, (k,).
        scale: robust standard deviation of a sample, (k,).
    """

    values: Array
    unit: Array
    rejected: Array
    scale: Array


def locations(chunks: Sequence[Array], estimator: str, steps: Array) -> Locations:
    """Locations of dwells, one (n_i, k) array each.

    Args:
        chunks: readings of each dwell.
        estimator: name of the estimator.
        steps: LSB of each channel, (k,).
    """
    medians = np.array([np.median(c, axis=0) for c in chunks])
    scale = np.array(
        [
            _scale([c[:, i] - m[i] for c, m in zip(chunks, medians, strict=True)], steps[i])
            for i in range(len(steps))
        ]
    )
    if estimator == "mean":
        return _by_mean(chunks, scale)
    if estimator == "median":
        values, psi, slope = medians, _residuals(chunks, medians, scale), np.ones(len(scale))
        _, inflation = pooled_noise([p * scale for p in psi])
        # the sign's correlation between channels is left out
        unit = np.diag(np.pi / 2 * scale**2 * inflation)
        return Locations(values, unit, np.zeros(len(scale)), scale)
    values = np.array(
        [_m_estimate(c, m, scale, estimator) for c, m in zip(chunks, medians, strict=True)]
    )
    residuals = _residuals(chunks, values, scale)
    psi = [influence(estimator, r) for r in residuals]
    slope = np.maximum(_slope(np.concatenate(residuals), estimator), LEAST_SLOPE)
    covariance, inflation = pooled_noise([p * scale for p in psi])
    rejected = np.mean(np.concatenate(psi) == 0, axis=0) - np.mean(
        np.concatenate(residuals) == 0, axis=0
    )
    return Locations(
        values, covariance * inflation / np.outer(slope, slope), np.maximum(rejected, 0.0), scale
    )


def _by_mean(chunks: Sequence[Array], scale: Array) -> Locations:
    means = np.array([c.mean(axis=0) for c in chunks])
    covariance, inflation = pooled_noise([c - m for c, m in zip(chunks, means, strict=True)])
    return Locations(means, covariance * inflation, np.zeros(len(scale)), scale)


def _scale(residuals: Sequence[Array], lsb: float) -> float:
    """Standard deviation by the median absolute deviation over all dwells, not below
    that of the rounding.

    Of rounded values it is a multiple of the LSB, or zero: half an LSB is the least.
    """
    spread = float(np.median(np.abs(np.concatenate(residuals))))
    return max(MAD_TO_SIGMA * spread, lsb / 2, ARITHMETIC)


def _residuals(chunks: Sequence[Array], values: Array, scale: Array) -> list[Array]:
    return [(c - v) / scale for c, v in zip(chunks, values, strict=True)]


def _m_estimate(chunk: Array, start: Array, scale: Array, estimator: str) -> Array:
    """Iteratively reweighted mean of each channel from the median, (k,)."""
    value = start
    for _ in range(50):
        weight = WEIGHT[estimator]((chunk - value) / scale)
        new = (weight * chunk).sum(axis=0) / weight.sum(axis=0)
        if np.all(np.abs(new - value) <= 1e-6 * scale):
            return np.asarray(new)
        value = new
        # rejected once, against the median: a moving limit could run in circles
        if estimator == "inliers":
            break
    return np.asarray(value)


def _slope(r: Array, estimator: str) -> Array:
    """Mean derivative of psi, (k,); at a sharp limit its jump counts as minus the density there."""
    if estimator == "huber":
        return np.asarray((np.abs(r) <= HUBER).mean(axis=0))
    if estimator == "tukey":
        u2 = (r / TUKEY) ** 2
        return np.asarray(np.where(u2 < 1, (1 - u2) * (1 - 5 * u2), 0.0).mean(axis=0))
    near = np.abs(np.abs(r) / REJECT - 1) < BAND
    return np.asarray((np.abs(r) <= REJECT).mean(axis=0) - near.mean(axis=0) / (2 * BAND))


def _tukey_weight(r: Array) -> Array:
    return np.asarray(np.maximum(1 - (r / TUKEY) ** 2, 0.0) ** 2)


WEIGHT: dict[str, Callable[[Array], Array]] = {
    "huber": lambda r: np.minimum(1.0, HUBER / np.maximum(np.abs(r), 1e-300)),
    "tukey": _tukey_weight,
    "inliers": lambda r: (np.abs(r) <= REJECT).astype(float),
}


def influence(name: str, r: Array) -> Array:
    """The influence function of an M-estimator: residual times weight.

    Args:
        name: name of the estimator.
        r: residuals over their scale, (n,).
    """
    return np.asarray(r * WEIGHT[name](r))
