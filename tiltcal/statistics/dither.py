"""Rounding of means to codes: noise is the dither, and what it leaves does not average away."""

from collections.abc import Sequence

import numpy as np

from tiltcal.core.arrays import Array

GRID = np.linspace(0.0, 2.0, 401)  # noise before rounding, in codes
TERMS = np.arange(1, 200)


def left_by_rounding(variance: float, code: float) -> float:
    """Variance of the error of a long mean of rounded readings, over true values that lie anywhere
    in a code.

    Normal noise s before rounding to codes q leaves ``sum q^2 / (2 pi^2 k^2) exp(-4 pi^2 k^2 s^2 /
    q^2)``; readings then have the variance ``s^2 + q^2/12`` less that, from which s is found.

    Args:
        variance: of the rounded readings within dwells, on average over dwells.
        code: q, in the same unit.

    Source: Widrow and Kollar, Quantization Noise (2008), ch. 4 and 7.
    """
    if code <= 0:
        return 0.0
    seen = variance / code**2
    if seen >= float(_SEEN[-1]):
        return 0.0
    noise = float(np.interp(seen, _SEEN, GRID))
    return float(np.interp(noise, GRID, _LEFT)) * code**2


def rounding_variance(codes: Array, residuals: Sequence[Array], means: Array) -> Array:
    """What rounding leaves in the mean of each dwell, (m, k).

    Dwells whose means lie within half a code have the same error: their variance is multiplied by
    their number, so that together they weigh as one.

    Args:
        codes: widths, 0 where a channel has none, (k,).
        residuals: of each dwell, (n_i, k); means: of each, (m, k); in the unit of the codes.
    """
    found = np.zeros_like(means)
    dof = max(sum(len(r) - 1 for r in residuals), 1)
    for i, code in enumerate(codes):
        variance = sum(float(r[:, i] @ r[:, i]) for r in residuals) / dof
        left = left_by_rounding(variance, code)
        if left > 0:
            near = np.abs(means[:, i, None] - means[None, :, i]) < code / 2
            found[:, i] = left * near.sum(axis=1)
    return found


def _left() -> Array:
    k = TERMS[:, None]
    waves = np.exp(-4 * np.pi**2 * k**2 * GRID**2) / (2 * np.pi**2 * k**2)
    return np.asarray(waves.sum(axis=0))


_LEFT = _left()
_SEEN = GRID**2 + 1 / 12 - _LEFT
