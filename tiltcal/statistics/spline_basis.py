"""B-splines with equal steps that are constant in intervals of standstill."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from tiltcal.core.arrays import Array, Index

if TYPE_CHECKING:
    from scipy.sparse import csr_array

ORDER = 4  # of the differences that are penalised
DEGREE = 2 * ORDER - 1  # of a smoothing spline with that penalty


@dataclass(frozen=True)
class SplineBasis:
    """B-splines with equal steps; the coefficients of one rest are one coefficient.

    Args:
        start, end: s; step: of the knots, s.
        rests: (begin, end) of each, s, in order of time, without overlap.
    """

    start: float
    end: float
    step: float
    rests: tuple[tuple[float, float], ...]

    @cached_property
    def knots(self) -> Array:
        """s, (coefficients + DEGREE + 1,)."""
        steps = max(int(np.ceil((self.end - self.start) / self.step)), 1)
        found: Array = self.start + self.step * np.arange(-DEGREE, steps + DEGREE + 1.0)
        return found

    @cached_property
    def group(self) -> Index:
        """Which free coefficient each coefficient is, rising, (coefficients,)."""
        middle = self.knots[: -DEGREE - 1] + self.step * (DEGREE + 1) / 2
        middle = np.clip(middle, self.start, self.end)
        begins, ends = np.array(self.rests).reshape(-1, 2).T
        which = np.searchsorted(begins, middle, side="right") - 1
        inside = (which >= 0) & (middle <= ends[which] if len(ends) else False)
        rest = np.where(inside, which, -1)
        tied = (rest[1:] == rest[:-1]) & (rest[1:] >= 0)
        return np.concatenate([[0], np.cumsum(~tied)])

    @cached_property
    def _tie(self) -> "csr_array":
        from scipy.sparse import csr_array

        rows = np.arange(len(self.group))
        return csr_array((np.ones(len(rows)), (rows, self.group)))

    def design(self, time: Array) -> "csr_array":
        """Values of the free splines, (m, free). time: s, held at the ends, (m,)."""
        from scipy.interpolate import BSpline

        at = np.clip(time, self.start, self.end)
        return BSpline.design_matrix(at, self.knots, DEGREE) @ self._tie

    @cached_property
    def differences(self) -> "csr_array":
        """Differences of the coefficients, (coefficients - ORDER, free); all zero inside a rest."""
        from scipy.sparse import csr_array, eye_array

        operator = csr_array(eye_array(len(self.group)))
        for _ in range(ORDER):
            operator = operator[1:] - operator[:-1]
        found = csr_array(operator @ self._tie)
        found.eliminate_zeros()
        return found

    @cached_property
    def moves(self) -> tuple[Index, ...]:
        """Rows of ``differences`` of each move: those between two rests. (m,) each."""
        rows = np.flatnonzero(np.diff(self.differences.indptr) > 0)
        return tuple(np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)) if len(rows) else ()
