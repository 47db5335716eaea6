"""Rounding of means to codes: noise is the dither, and what it leaves does not average away."""

from collections.abc import Sequence
from functools import cache

import numpy as np

from tiltcal.core.arrays import Array

NOISE = np.geomspace(0.02, 1.0, 48)
"""Noise before rounding, in codes: more leaves less than 1e-17 of a code squared."""
PLACES = np.linspace(-1.0, 1.0, 65)  # of a true value about the median code of its dwell, in codes
REACH = 7  # codes to either side of the median that readings may lie at
TERMS = np.arange(1, 200)


def left_by_rounding(noise: Array) -> Array:
    """Variance of the error of a long mean of rounded readings, over true values that lie anywhere
    in a code, in codes squared.

    Args:
        noise: standard deviation of the normal noise before rounding, in codes, (n,).

    Source: Widrow and Kollar, Quantization Noise (2008), ch. 4 and 7:
    ``sum 1 / (2 pi^2 k^2) exp(-4 pi^2 k^2 noise^2)``.
    """
    k = TERMS[:, None]
    waves = np.exp(-4 * np.pi**2 * k**2 * np.square(noise)) / (2 * np.pi**2 * k**2)
    return np.asarray(waves.sum(axis=0))


def rounding_variance(codes: Array, residuals: Sequence[Array], means: Array) -> Array:
    """What rounding leaves in the mean of each dwell, (m, k).

    Dwells whose means lie within half a code have the same error: their variance is multiplied by
    their number, so that together they weigh as one.

    Args:
        codes: widths, 0 where a channel has none, (k,).
        residuals: of each dwell, (n_i, k).
        means: of each, (m, k); in the unit of the codes.
    """
    found = np.zeros_like(means)
    dof = max(sum(len(r) - 1 for r in residuals), 1)
    for i, code in enumerate(codes):
        variance = sum(float(r[:, i] @ r[:, i]) for r in residuals) / dof
        if code <= 0 or variance > code**2:
            continue
        chances = noise_posterior([r[:, i] / code for r in residuals])
        left = float(chances @ left_by_rounding(NOISE)) * code**2
        near = np.abs(means[:, i, None] - means[None, :, i]) < code / 2
        found[:, i] = left * near.sum(axis=1)
    return found


def noise_posterior(dwells: Sequence[Array]) -> Array:
    """Probability of each noise of ``NOISE``, which all dwells have, from how often each code was
    read; the true values lie anywhere.

    A spread of one code tells little by itself: it is noise, or a true value near the edge of a
    code. How the readings share the codes of all dwells tells which.

    Args:
        dwells: rounded readings of each, in codes about any value, (n_i,).
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
    """Log chance of each code for each noise and place, (len(NOISE), len(PLACES), codes)."""
    from scipy.special import ndtr

    code = np.arange(-REACH, REACH + 1)
    below, above = (
        ndtr((code + side - PLACES[:, None]) / NOISE[:, None, None]) for side in (-0.5, 0.5)
    )
    return np.asarray(np.log(np.maximum(above - below, np.finfo(float).tiny)))
