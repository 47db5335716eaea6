"""Noise of a recording: the width of its quantisation steps, the covariance of one sample, and how
badly means average. Where means are rounded, noise is the dither, and what it leaves does not
average away.
"""

from collections.abc import Sequence
from functools import cache

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.core.quantisation import lsb_width

ARITHMETIC = 1e-9  # SI: standard deviation below which a recording counts as free of noise

FEW = 50  # readings at standstill that determine the noise
MAD_TO_SIGMA = 1.482602218505602  # of a normal: standard over median absolute deviation


def second_difference_noise(values: Array) -> float:
    """White noise of evenly sampled values from their second differences, in which no slow signal
    is left: standard deviation of a sample, robust against outliers.

    Args:
        values: (n,).
    """
    return white_of(second_differences(values))


def second_differences(values: Array) -> Array:
    """Second differences, (n,) -> (n - 2,): twice the deviation from the line through the
    neighbours.
    """
    return values[2:] - 2 * values[1:-1] + values[:-2]


def white_of(second: Array) -> float:
    """Standard deviation of a sample of white noise with these second differences, (n,), robust
    against outliers.
    """
    return float(MAD_TO_SIGMA * np.median(np.abs(second)) / np.sqrt(6))


def robust_white(residual: Array) -> float:
    """White noise from second differences, in which no slow signal is left. residual: (n,)."""
    return _limited_by_rounding(second_differences(residual))


def white_at_standstill(values: Array, stop: Index) -> float:
    """The same of readings within stops, whose levels differ; of all where the table hardly stands
    still.

    Args:
        values: (n,).
        stop: number of the stop of each value, -1 while moving, (n,).
    """
    from_one = (stop[2:] >= 0) & (stop[2:] == stop[1:-1]) & (stop[2:] == stop[:-2])
    if from_one.sum() < FEW:
        return robust_white(values)
    return _limited_by_rounding(second_differences(values)[from_one])


def _limited_by_rounding(second: Array) -> float:
    """White noise of readings by their second differences, (n,), not below a share of these:
    rounding hides the noise of most.
    """
    return max(white_of(second), 0.05 * float(np.std(second)), ARITHMETIC)


def pooled_noise(residuals: Sequence[Array]) -> tuple[Array, float]:
    """Noise of dwells less their means.

    Args:
        residuals: one (n_i, k) array a dwell.

    Returns:
        Covariance of one sample, (k, k), not below the rounding to the LSB (LSB^2/12); and the
            inflation of the variance of a mean over that of white noise, by batch means, 1 unless
            significant at 0.1 %.
    """
    k = residuals[0].shape[1]
    dof = max(sum(len(r) - 1 for r in residuals), 1)
    covariance = sum((r.T @ r for r in residuals), np.zeros((k, k))) / dof
    steps = np.array([lsb_width(residuals[0][:, i]) for i in range(k)])
    floor = np.maximum(
        np.where(steps**2 / 12 < 1e-4 * np.diag(covariance), 0.0, steps**2 / 12), ARITHMETIC**2
    )
    covariance = covariance + np.diag(np.maximum(floor - np.diag(covariance), 0.0))
    return covariance, _inflation(residuals, np.diag(covariance), dof)


def _inflation(residuals: Sequence[Array], variance: Array, dof: int) -> float:
    from scipy.special import fdtrc

    k = len(variance)
    total, batches = np.zeros(k), 0
    for r in residuals:
        m = min(8, len(r) // 8)
        if m >= 2:
            size = len(r) // m
            means = r[: m * size].reshape(m, size, k).mean(axis=1)
            total += size * ((means - means.mean(axis=0)) ** 2).sum(axis=0)
            batches += m - 1
    if batches < 4:
        return 1.0
    ratio = float(np.mean(total / batches / variance))
    return ratio if ratio > 1 and fdtrc(batches * k, dof * k, ratio) < 1e-3 else 1.0


NOISE = np.geomspace(0.02, 1.0, 48)
"""Noise before rounding, LSB: more leaves less than 1e-17 LSB^2."""
OFFSETS = np.linspace(-1.0, 1.0, 65)  # LSB, of a true value about the median of its dwell
REACH = 7  # LSB to either side of the median that readings may have
TERMS = np.arange(1, 200)


def left_by_rounding(noise: Array) -> Array:
    """Variance of the error of a long mean of rounded readings, LSB^2, over true values that lie
    anywhere within an LSB.

    Args:
        noise: standard deviation of the normal noise before rounding, LSB, (n,).

    Source: Widrow and Kollar, Quantization Noise (2008), ch. 4 and 7:
    ``sum 1 / (2 pi^2 k^2) exp(-4 pi^2 k^2 noise^2)``.
    """
    k = TERMS[:, None]
    waves = np.exp(-4 * np.pi**2 * k**2 * np.square(noise)) / (2 * np.pi**2 * k**2)
    return np.asarray(waves.sum(axis=0))


def rounding_variance(steps: Array, residuals: Sequence[Array], means: Array) -> Array:
    """Variance that rounding leaves in the mean of each dwell, (m, k).

    Dwells whose means lie within half an LSB have the same error: their variance is multiplied by
    their number, so that together they weigh as one.

    Args:
        steps: LSB of each channel, 0 where it has none, (k,).
        residuals: of each dwell, (n_i, k).
        means: mean of each dwell, in the unit of ``steps``, (m, k).
    """
    found = np.zeros_like(means)
    dof = max(sum(len(r) - 1 for r in residuals), 1)
    for i, lsb in enumerate(steps):
        variance = sum(float(r[:, i] @ r[:, i]) for r in residuals) / dof
        if lsb <= 0 or variance > lsb**2:
            continue
        chances = noise_posterior([r[:, i] / lsb for r in residuals])
        left = float(chances @ left_by_rounding(NOISE)) * lsb**2
        near = np.abs(means[:, i, None] - means[None, :, i]) < lsb / 2
        found[:, i] = left * near.sum(axis=1)
    return found


def noise_posterior(dwells: Sequence[Array]) -> Array:
    """Probability of each noise of ``NOISE``, which all dwells have, from the counts of each output
    value; the true values lie anywhere.

    A spread of one LSB alone is ambiguous: it is noise, or a true value near the edge of an LSB.
    The counts of all dwells together decide.

    Args:
        dwells: rounded readings of each dwell, LSB about any value, (n_i,).
    """
    chance = _log_chances()
    total = np.zeros(len(NOISE))
    for readings in dwells:
        steps = np.rint(readings - np.median(readings)).astype(int)
        counts = np.bincount(np.clip(steps, -REACH, REACH) + REACH, minlength=2 * REACH + 1)
        fit = chance @ counts
        best = fit.max(axis=1, keepdims=True)
        total += best[:, 0] + np.log(np.mean(np.exp(fit - best), axis=1))
    weights = np.exp(total - total.max())
    return np.asarray(weights / weights.sum())


@cache
def _log_chances() -> Array:
    """Log probability of each step for each noise and offset, (len(NOISE), len(OFFSETS), steps)."""
    from scipy.special import ndtr

    steps = np.arange(-REACH, REACH + 1)
    below, above = (
        ndtr((steps + side - OFFSETS[:, None]) / NOISE[:, None, None]) for side in (-0.5, 0.5)
    )
    return np.asarray(np.log(np.maximum(above - below, np.finfo(float).tiny)))
