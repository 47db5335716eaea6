"""A smooth course of a vector from noisy linear readings of it, with intervals of standstill.

The course is a B-spline. Differences of its coefficients are penalised, which is a prior: between
two rests the fourth differences are white noise of one variance, and that variance is the most
probable one given the readings (restricted maximum likelihood). About a course that is known
roughly their tails are those of Student's t: a hand lets go at once. In a rest the course is
constant.
The estimate is the posterior mean; a Rauch-Tung-Striebel smoother of a four times integrated white
noise gives the same course, here with as many states as there are knots.

Sources: Eilers, Marx (1996), flexible smoothing with B-splines and penalties; Wecker, Ansley
(1983), the signal extraction approach to nonlinear regression and spline smoothing; Wahba (1985), a
comparison of GCV and GML for choosing the smoothing parameter; Aravkin, Burke, Pillonetto (2014),
robust and trend-following Student's t Kalman smoothers; Lange, Little, Taylor (1989), robust
statistical modeling using the t distribution, for its reweighting and its four degrees of freedom.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.statistics.spline_basis import DEGREE, SplineBasis

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# of the penalty over the readings: the weights that are tried, as far as rounding allows
DECADES = np.arange(-12.0, 9.0, 2.0)
TAILS = 4.0  # degrees of freedom of the differences about a course that is known
RIDGE = 1e-10  # of a component's largest weight: what no reading touches stays finite


@dataclass(frozen=True)
class LinearReadings:
    """Scalar readings of a vector course: value = direction . course(time) + noise.

    Args:
        time: s, (m,); direction: (m, d); value: (m,); weight: one over the variance, 0 for a
            reading that says nothing, (m,).
    """

    time: Array
    direction: Array
    value: Array
    weight: Array


@dataclass(frozen=True)
class SmoothCourse:
    """The most probable course.

    Args:
        basis: its splines; coefficients: (free, d).
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

    A move is judged by the readings from the rest before it to the rest after it.

    Args:
        basis: where the knots and the rests are.
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
        basis: where the knots are; design: its values at the readings, (m, free).
        direction: (m, d); value, weight: (m,).
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
        d,). found: its coefficients, (free * d,); weights: of the penalty of each move, (moves,).
        """
        course = found.reshape(-1, self.size)
        residual = self.value * np.sqrt(self.weight) - self.spread @ found
        side = np.asarray(self.spread.T @ residual)
        for rows, weight in zip(self.basis.moves, weights, strict=True):
            D = self.differences[rows]
            side -= weight * (D.T @ (D @ course)).ravel()
        return side

    def of_move(self, rows: Index) -> "tuple[_System, Array, int]":
        """Readings of one move with the rests at its ends; its penalty in bands, and its rank."""
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
