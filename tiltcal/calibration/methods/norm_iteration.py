"""The iteration of the paper on the norm method: the gain G is a product, the bias B a sum of small
corrections.
"""

from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array

STEPS = 30
MAX_CORRECTION = 0.3  # of one step: the equations are linearised
CONVERGED = 1e-10  # last correction, relative to 1 and to g


@dataclass(frozen=True)
class Iteration:
    """The course and the result of the iteration.

    Args:
        gain: diagonal of G, (3,); bias: B, m/s2, (3,).
        corrections: largest correction of each step, of 1 and of g together, (steps,).
        residuals: rms of |a| / g - 1 before each step, (steps,).
        converged: whether the last correction was small.
    """

    gain: Array
    bias: Array
    corrections: tuple[float, ...]
    residuals: tuple[float, ...]
    converged: bool

    @property
    def record(self) -> list[dict[str, float]]:
        """One row a step, for CAL.json."""
        return [
            {"residual": r, "correction": c}
            for r, c in zip(self.residuals, self.corrections, strict=True)
        ]


def product_and_sum(
    S: Array, g: float, gain: Array | None = None, bias: Array | None = None
) -> Iteration:
    """G and B of ``S = G A + B``, G diagonal, from outputs S (m, 3) at rest in m >= 6 unknown
    attitudes.

    With the last G and B, ``a = G^-1 (S - B)``; small corrections k and b of ``|(1 - k) a - b| =
    g`` solve ``2 sum (k_i a_i^2 + b_i a_i) = |a|^2 - g^2``, by least squares where there are more
    than six; then G is multiplied by (1 + k) and G b is added to B.

    Errors:
        All attitudes have the same weight, and there are no cross-axis terms; six attitudes leave
            no residual, whether the result is right or wrong.

    Source: doi 10.3969/j.issn1672-9730.2014.01.018 (docs/sources.md, "Six arbitrary positions").
    """
    G = np.ones(3) if gain is None else np.array(gain, dtype=float)
    B = np.zeros(3) if bias is None else np.array(bias, dtype=float)
    corrections, residuals = [], []
    for _ in range(STEPS):
        a = (S - B) / G / g
        excess = (a * a).sum(axis=1) - 1
        step = np.linalg.lstsq(2 * np.hstack([a * a, a]), excess, rcond=None)[0]
        residuals.append(float(np.sqrt(np.mean((np.sqrt(excess + 1) - 1) ** 2))))
        step *= min(1.0, MAX_CORRECTION / max(float(np.abs(step).max()), 1e-300))
        corrections.append(float(np.abs(step).max()))
        B = B + G * step[3:] * g
        G = G * (1 + step[:3])
        diverged = not np.all(np.isfinite(G)) or bool(np.any(np.abs(G) < 1e-3))
        if corrections[-1] < CONVERGED or diverged:
            break
    converged = corrections[-1] < CONVERGED and bool(np.all(G > 0))
    return Iteration(G, B, tuple(corrections), tuple(residuals), converged)
