"""The score test of a hypothesis at an operating point, the adjustable terms projected out.

For whitened columns U of a hypothesis, an orthonormal basis Q of the terms that are fitted anyway
and the whitened residual r, A = U'(I - QQ')r and B = U'(I - QQ')U hold everything: the gain in
deviance A'B^-1 A ~ chi2(rank, lambda), the expected values B^-1 A and the absorbed share.
"""

from collections.abc import Sequence
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

    def gain(self, keep: Sequence[int] | None = None) -> tuple[float, int]:
        """Fall of the deviance with these columns (all), and its degrees of freedom."""
        index = self._index(keep)
        if len(index) == 1:
            i = index[0]
            there = self.B[i, i] > SURVIVES * max(self.raw[i], 1e-300)
            return (float(self.A[i] ** 2 / self.B[i, i]), 1) if there else (0.0, 0)
        values, vectors, size = self._directions(index)
        return float((((vectors.T @ (self.A[index] / size)) ** 2) / values).sum()), len(values)

    def estimate(self, keep: Sequence[int] | None = None) -> tuple[Array, Array]:
        """Expected values of these columns, SI, and their covariance. (m,) and (m, m)."""
        index = self._index(keep)
        values, vectors, size = self._directions(index)
        unit = np.array([self.hypothesis.size(self.names[i]) for i in index])
        C = (vectors / values) @ vectors.T / np.outer(size, size)
        return unit * (C @ self.A[index]), C * np.outer(unit, unit)

    def _index(self, keep: Sequence[int] | None) -> list[int]:
        return list(range(len(self.names))) if keep is None else list(keep)

    def _directions(self, index: list[int]) -> tuple[Array, Array, Array]:
        """Eigenvalues and vectors of B that survive, its columns scaled by ``size``."""
        size = lengths(self.raw[index])
        values, vectors = np.linalg.eigh(self.B[np.ix_(index, index)] / np.outer(size, size))
        keep = values > SURVIVES
        return values[keep], vectors[:, keep], size

    @property
    def absorbed(self) -> float:
        """Share of the columns' energy that the nuisance parameters take."""
        return 1 - float(np.trace(self.B) / max(self.raw.sum(), 1e-300))
