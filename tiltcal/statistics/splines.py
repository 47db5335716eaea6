"""Cubic and B-splines, and the smooth course of a vector that they describe.

The course comes from noisy linear readings of the vector, with intervals of standstill.

It is a B-spline. Differences of its coefficients are penalised, which is a prior: between two
standstills the fourth differences are white noise of one variance, and that variance is the most
probable one given the readings (restricted maximum likelihood). About a course that is known
roughly their tails are those of Student's t: a hand lets go at once. At a standstill the course is
constant. The estimate is the posterior mean; a Rauch-Tung-Striebel smoother of a four times
integrated white noise gives the same course, here with as many states as there are knots.

Sources: Eilers, Marx (1996), flexible smoothing with B-splines and penalties; Wecker, Ansley
(1983), the signal extraction approach to nonlinear regression and spline smoothing; Wahba (1985), a
comparison of GCV and GML for choosing the smoothing parameter; Aravkin, Burke, Pillonetto (2014),
robust and trend-following Student's t Kalman smoothers; Lange, Little, Taylor (1989), robust
statistical modeling using the t distribution, for its reweighting and its four degrees of freedom.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from tiltcal.core.arrays import Array, Index

if TYPE_CHECKING:
    from scipy.sparse import csr_array


@cache
def cardinal_splines(
    knots: tuple[float, ...], ends: Literal["natural", "not-a-knot"] = "natural"
) -> Any:
    """The cubic splines that are one at a knot and zero at the others; of three knots that are
    ``not-a-knot`` the parabolas.
    """
    from scipy.interpolate import CubicSpline, PPoly

    if len(knots) == 2:  # straight: nothing to solve
        slope = 1 / (knots[1] - knots[0])
        return PPoly(np.array([[[-slope, slope]], [[1.0, 0.0]]]), knots)
    return CubicSpline(knots, np.eye(len(knots)), bc_type=ends)


ORDER = 4  # of the differences that are penalised
DEGREE = 2 * ORDER - 1  # of a smoothing spline with that penalty


@dataclass(frozen=True)
class SplineBasis:
    """B-splines with equal steps; the coefficients of one standstill are one coefficient.

    Args:
        start, end: s.
        step: of the knots, s.
        standstills: (begin, end) of each, s, in order of time, without overlap.
    """

    start: float
    end: float
    step: float
    standstills: tuple[tuple[float, float], ...]

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
        begins, ends = np.array(self.standstills).reshape(-1, 2).T
        which = np.searchsorted(begins, middle, side="right") - 1
        inside = (which >= 0) & (middle <= ends[which] if len(ends) else False)
        standstill = np.where(inside, which, -1)
        tied = (standstill[1:] == standstill[:-1]) & (standstill[1:] >= 0)
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
        """Differences of the coefficients, (coefficients - ORDER, free); all zero inside a
        standstill.
        """
        from scipy.sparse import csr_array, eye_array

        operator = csr_array(eye_array(len(self.group)))
        for _ in range(ORDER):
            operator = operator[1:] - operator[:-1]
        found = csr_array(operator @ self._tie)
        found.eliminate_zeros()
        return found

    @cached_property
    def moves(self) -> tuple[Index, ...]:
        """Rows of ``differences`` of each move: those between two standstills. (m,) each."""
        rows = np.flatnonzero(np.diff(self.differences.indptr) > 0)
        return tuple(np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)) if len(rows) else ()


# of the penalty over the readings: the weights that are tried, as far as rounding allows
DECADES = np.arange(-12.0, 9.0, 2.0)
TAILS = 4.0  # degrees of freedom of the differences about a course that is known
RIDGE = 1e-10  # of a component's largest weight: what no reading touches stays finite


@dataclass(frozen=True)
class LinearReadings:
    """Scalar readings of a vector course: value = direction . course(time) + noise.

    Args:
        time: s, (m,).
        direction: (m, d).
        value: (m,).
        weight: one over the variance, 0 for a reading without information, (m,).
    """

    time: Array
    direction: Array
    value: Array
    weight: Array


@dataclass(frozen=True)
class SmoothCourse:
    """The most probable course.

    Args:
        basis: its splines.
        coefficients: (free, d).
        roughness: weight of the penalty of each move, in the unit of the readings' weights.
    """

    basis: SplineBasis
    coefficients: Array
    roughness: Array

    def at(self, time: Array) -> Array:
        """The course at these times, (m, d). time: s, (m,)."""
        return np.asarray(self.basis.design(time) @ self.coefficients)


def most_probable_course(
    basis: SplineBasis, readings: Sequence[LinearReadings], before: SmoothCourse | None = None
) -> SmoothCourse:
    """The course with the largest posterior probability, smoothness estimated for each move.

    A move is judged by the readings from the standstill before it to the one after it.

    Args:
        basis: where the knots and the standstills are.
        readings: of one or several sensors, not empty.
        before: the course as it is known, on the same basis: differences that are large in it are
            penalised less.
    """
    shares = np.ones(basis.differences.shape[0]) if before is None else _shares(before)
    system = _System.of(basis, readings, shares)
    weights = np.array([_smoothness(system.of_move(rows)) for rows in basis.moves])
    penalty = np.zeros_like(system.matrix)
    for rows, weight in zip(basis.moves, weights, strict=True):
        penalty += weight * _banded(system.differences[rows], system.size, len(system.matrix))
    found, _ = _solved(system.matrix + penalty, system.side)
    # normal equations lose half of the digits: what the readings leave brings them back
    more, _ = _solved(system.matrix + penalty, system.left_by(found, weights))
    return SmoothCourse(basis, (found + more).reshape(-1, system.size), weights)


def _shares(course: SmoothCourse) -> Array:
    """What is left of the weight of each difference of a course, (coefficients - ORDER,): the
    precision of Student's t given the difference, on average one where it is normal.
    """
    d = course.coefficients.shape[1]
    size = np.sum((course.basis.differences @ course.coefficients) ** 2, axis=1)
    found = np.ones(len(size))
    for rows, weight in zip(course.basis.moves, course.roughness, strict=True):
        found[rows] = (TAILS + d) / (TAILS + weight * size[rows])
    return found


@dataclass(frozen=True)
class _System:
    """Normal equations of the readings.

    Args:
        basis: where the knots are.
        design: its values at the readings, (m, free).
        direction: (m, d).
        value, weight: (m,).
        differences: of the course, over the root of their variance in a move, (k, free).
    """

    basis: SplineBasis
    design: "csr_array"
    direction: Array
    value: Array
    weight: Array
    differences: "csr_array"

    @classmethod
    def of(cls, basis: SplineBasis, readings: Sequence[LinearReadings], shares: Array) -> "_System":
        from scipy.sparse import diags_array

        time, value, weight = (
            np.concatenate([getattr(r, name) for r in readings])
            for name in ("time", "value", "weight")
        )
        direction = np.concatenate([r.direction for r in readings])
        kept = weight > 0
        scaled = diags_array(np.sqrt(shares)) @ basis.differences
        design = basis.design(time[kept])
        return cls(basis, design, direction[kept], value[kept], weight[kept], scaled.tocsr())

    @property
    def size(self) -> int:
        """Components of the course."""
        return self.direction.shape[1]

    @cached_property
    def spread(self) -> "csr_array":
        """Derivative of each reading by each coefficient, over its standard deviation, (m, free *
        d).
        """
        from scipy.sparse import coo_array

        B, d = self.design.tocoo(), self.size
        row, column = B.coords
        data = (B.data * np.sqrt(self.weight[row]))[:, None] * self.direction[row]
        columns = column[:, None] * d + np.arange(d)
        shape = (B.shape[0], B.shape[1] * d)
        entries = (data.ravel(), (np.repeat(row, d), columns.ravel()))
        return coo_array(entries, shape=shape).tocsr()

    @cached_property
    def matrix(self) -> Array:
        """Lower bands of the normal matrix, ((DEGREE + 1) * d, free * d)."""
        found = _bands(self.spread, (DEGREE + 1) * self.size)
        largest = found[0].reshape(-1, self.size).max(axis=0, initial=0.0)
        found[0] += np.tile(RIDGE * largest, found.shape[1] // self.size)
        return found

    @cached_property
    def side(self) -> Array:
        """Right-hand side, (free * d,)."""
        return np.asarray(self.spread.T @ (self.value * np.sqrt(self.weight)))

    def left_by(self, found: Array, weights: Array) -> Array:
        """Right-hand side of what a course leaves of the readings and of its smoothness, (free *
        d,).

        Args:
            found: its coefficients, (free * d,).
            weights: of the penalty of each move, (moves,).
        """
        course = found.reshape(-1, self.size)
        residual = self.value * np.sqrt(self.weight) - self.spread @ found
        side = np.asarray(self.spread.T @ residual)
        for rows, weight in zip(self.basis.moves, weights, strict=True):
            D = self.differences[rows]
            side -= weight * (D.T @ (D @ course)).ravel()
        return side

    def of_move(self, rows: Index) -> "tuple[_System, Array, int]":
        """Readings of one move with the standstills at its ends; its penalty in bands, and its
        rank.
        """
        D = self.differences[rows]
        first, last = int(D.indices.min()), int(D.indices.max())
        lowest, highest = self._ends
        inside = (lowest >= first) & (highest <= last)
        part = _System(
            self.basis,
            self.design[inside][:, first : last + 1],
            self.direction[inside],
            self.value[inside],
            self.weight[inside],
            D,
        )
        bands = _banded(D[:, first : last + 1], self.size, (DEGREE + 1) * self.size)
        return part, bands, len(rows) * self.size

    @cached_property
    def _ends(self) -> tuple[Index, Index]:
        """First and last free coefficient that each reading depends on, (m,) each."""
        B = self.design.tocsr()
        B.sort_indices()
        ends = (B.indices[B.indptr[:-1]], B.indices[B.indptr[1:] - 1])
        return ends[0].astype(np.intp), ends[1].astype(np.intp)


def _bands(rows: "csr_array", width: int) -> Array:
    """Lower bands of rows' rows, (width, columns)."""
    product = (rows.T @ rows).tocoo()
    i, j = product.coords
    found = np.zeros((width, rows.shape[1]))
    lower = i >= j
    found[(i - j)[lower], j[lower]] = product.data[lower]
    return found


def _banded(differences: "csr_array", size: int, width: int) -> Array:
    """Lower bands of the penalty on every component, (width, free * size)."""
    one = _bands(differences, width // size)
    found = np.zeros((width, one.shape[1] * size))
    found[::size] = np.repeat(one, size, axis=1)
    return found


def _solved(matrix: Array, side: Array) -> tuple[Array, float]:
    """Solution and logarithm of the determinant of a banded positive matrix.

    Raises:
        numpy.linalg.LinAlgError: it is not positive.
    """
    from scipy.linalg import cho_solve_banded, cholesky_banded

    factor = cholesky_banded(matrix, lower=True, check_finite=False)
    solution = cho_solve_banded((factor, True), side, check_finite=False)
    return np.asarray(solution), 2 * float(np.log(factor[0]).sum())


def _smoothness(move: tuple[_System, Array, int]) -> float:
    """The most probable weight of a move's penalty: the restricted likelihood is largest there."""
    from scipy.optimize import minimize_scalar

    system, penalty, rank = move
    if not len(system.value):
        return 1.0
    scale = float(system.matrix[0].mean() / penalty[0].mean())

    def deviance(decade: float) -> float:
        weight = scale * 10.0**decade
        try:
            solution, determinant = _solved(system.matrix + weight * penalty, system.side)
        except np.linalg.LinAlgError:
            return float("inf")
        return determinant - float(system.side @ solution) - rank * float(np.log(weight))

    best = float(DECADES[int(np.argmin([deviance(d) for d in DECADES]))])
    found = minimize_scalar(
        deviance, bounds=(best - 2, best + 2), method="bounded", options={"xatol": 0.02}
    )
    return scale * 10.0 ** float(found.x)
