"""The score test of a hypothesis at an operating point, the adjustable terms projected out.

For whitened columns U of a hypothesis, an orthonormal basis Q of the terms that are fitted anyway
and the whitened residual r, A = U'(I - QQ')r and B = U'(I - QQ')U hold everything: the gain in
deviance A'B^-1 A ~ chi2(rank, lambda), the expected values B^-1 A and the absorbed share.

Bayes factors of linear columns whose sizes have a normal prior of unknown width.

For a direction of whitened columns with information w (squared length after projection) and a prior
of variance v, log BF = gain/2 s/(1 + s) - log(1 + s)/2 with s = v w: the fall of the deviance,
shrunk, less the price of the number (Zellner 1986; Liang et al., J. Am. Stat. Assoc. 103, 2008, for
the mixture over v).
"""

from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis

SURVIVES = 1e-3  # share of a direction's energy that has to be left beside the nuisance parameters


def lengths(energy: Array) -> Array:
    """Lengths of columns from their energies; infinite, so that nothing is left of it when divided,
    for a column that is too small for the single precision in which columns are kept. energy: (p,).
    """
    return np.where(energy > np.finfo(np.float32).tiny, np.sqrt(energy), np.inf)


@dataclass(frozen=True)
class ScoreTest:
    """What one hypothesis would explain.

    Args:
        hypothesis: who.
        A, B: of the module's head, per plausible size, (p,) and (p, p).
        raw: energy of each column before projection, (p,).
    """

    hypothesis: Hypothesis
    A: Array
    B: Array
    raw: Array

    @property
    def names(self) -> tuple[str, ...]:
        """Of its columns."""
        return self.hypothesis.names

    def gain(self) -> tuple[float, int]:
        """Fall of the deviance with these columns, and its degrees of freedom."""
        size = lengths(self.raw)
        values, vectors = np.linalg.eigh(self.B / np.outer(size, size))
        there = values > SURVIVES
        gains = (vectors.T @ (self.A / size))[there] ** 2 / values[there]
        return float(gains.sum()), int(there.sum())

    @property
    def absorbed(self) -> float:
        """Share of the columns' energy that the nuisance parameters take."""
        return 1 - float(np.trace(self.B) / max(self.raw.sum(), 1e-300))


SIZES = 10.0 ** np.arange(-6, 3, 2)
"""Prior variances of a listed effect's size, in plausible sizes squared: no grade is known."""
ENERGIES = 10.0 ** np.arange(0, 9)
"""Prior energies of a number of a curve, in units of the noise: nothing is known of its size."""
DEVIATIONS = np.array([1e-4, 1e-3, 0.01, 0.03])
"""Prior shares of a law's energy by which one number of its real form may deviate from the
textbook's. ``docs/diagnosis_model.md`` says what the largest rests on.
"""
ANY_SHARE = np.array([1 / 7, 3 / 5, 5 / 3, 7.0])
"""Energy of the rest of a law in energies of what a name explains of it, where any share is as
probable as another: the middles of four quarters.
"""


def log_bayes_factor(gain: Array, ratio: Array) -> Array:
    """Of directions, averaged over their prior widths.

    Args:
        gain: fall of the deviance along each, (n,) or (n, m).
        ratio: prior variance over that of the estimate, for each width first, (k, n) or (k, n, m).
    """
    by_width = gain * (0.5 * ratio / (1 + ratio))
    by_width -= 0.5 * np.log1p(ratio)
    top = by_width.max(axis=0)
    by_width -= top
    return np.asarray(top + np.log(np.exp(by_width, out=by_width).mean(axis=0)))


def any_of(log_factors: Array) -> Array:
    """Of m directions together, every set of at least one of them being as probable as another,
    (n,). log_factors: of each, (n, m).
    """
    m = log_factors.shape[1]
    every = np.logaddexp(0.0, log_factors).sum(axis=1)  # with that of none, which is taken off
    nothing = np.log(-np.expm1(-np.maximum(every, np.finfo(float).tiny)))
    return np.asarray(every + nothing - m * np.log(2) - np.log1p(-(0.5**m)))
