"""The score test of a hypothesis at an operating point, the adjustable terms projected out.

For whitened columns U of a hypothesis, an orthonormal basis Q of the terms that are fitted anyway
and the whitened residual r, A = U'(I - QQ')r and B = U'(I - QQ')U hold everything: the gain in
deviance A'B^-1 A ~ chi2(rank, lambda), the expected values B^-1 A and the absorbed share.
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
