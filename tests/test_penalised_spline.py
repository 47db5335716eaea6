"""Smooth courses: against dense normal equations, and where the answer is known in closed form."""

import numpy as np
import pytest
from scipy.interpolate import BSpline

from tiltcal.statistics.splines import (
    DEGREE,
    ORDER,
    LinearReadings,
    SplineBasis,
    most_probable_course,
)

AXIS = np.array([1.0, 2.0, 2.0]) / 3


def bump(t, begin, end):
    u = np.clip((t - begin) / (end - begin), 0, 1)
    return (4 * u * (1 - u)) ** 4


def readings(seed, rests=True, sigma=(0.02, 0.01), n=120):
    """Three components and one oblique reading of a course with two bumps."""
    rng = np.random.default_rng(seed)
    t = np.sort(rng.uniform(0, 6, n))
    shape = bump(t, 1.5, 2.6) - 0.7 * bump(t, 4.0, 5.0) if rests else np.sin(2 * t)
    truth = shape[:, None] * [1.0, -0.4, 0.2] + [0.1, 0.2, 0.3]
    found = [
        LinearReadings(
            t,
            np.tile(direction, (n, 1)),
            truth @ direction + s * rng.standard_normal(n),
            np.full(n, s**-2.0),
        )
        for direction, s in zip([*np.eye(3), AXIS], [*[sigma[0]] * 3, sigma[1]], strict=True)
    ]
    return t, truth, found


def dense(basis, many):
    """Normal equations written out: every coefficient an unknown, those of a rest summed."""
    B = np.zeros((len(basis.group), basis.group[-1] + 1))
    B[np.arange(len(B)), basis.group] = 1.0
    rows, y, w = [], [], []
    for r in many:
        b = BSpline.design_matrix(r.time, basis.knots, DEGREE).toarray() @ B
        rows.append(np.einsum("mg,md->mgd", b, r.direction).reshape(len(b), -1))
        y, w = np.append(y, r.value), np.append(w, r.weight)
    X = np.concatenate(rows)
    D = np.kron(np.diff(np.eye(len(B)), ORDER, axis=0) @ B, np.eye(3))
    return X.T @ (w[:, None] * X), X.T @ (w * y), D


@pytest.mark.parametrize("rests", [((0.0, 1.2), (2.9, 3.7), (5.3, 6.0)), ()])
def test_a_course_is_the_solution_of_the_dense_normal_equations(rests):
    t, truth, many = readings(1)
    basis = SplineBasis(0.0, 6.0, 0.1, rests)
    found = most_probable_course(basis, many)
    N, b, D = dense(basis, many)
    weights = np.zeros(len(D))
    for rows, weight in zip(basis.moves, found.roughness, strict=True):
        weights[(3 * rows[:, None] + np.arange(3)).ravel()] = weight
    expected = np.linalg.solve(N + D.T @ (weights[:, None] * D), b)
    assert len(found.roughness) == max(len(rests) - 1, 1)
    np.testing.assert_allclose(
        found.coefficients.ravel(), expected, rtol=0, atol=1e-6 * np.abs(expected).max()
    )
    np.testing.assert_allclose(found.at(t), truth, atol=0.05)


def test_the_smoothness_is_the_most_probable_one():
    _, _, many = readings(2, rests=False)
    basis = SplineBasis(0.0, 6.0, 0.1, ())
    (best,) = most_probable_course(basis, many).roughness
    N, b, D = dense(basis, many)
    rank = np.linalg.matrix_rank(D)

    def deviance(weight):
        """Of all contrasts in the readings that no cubic changes, but for a constant."""
        A = N + weight * D.T @ D
        return np.linalg.slogdet(A)[1] - b @ np.linalg.solve(A, b) - rank * np.log(weight)

    assert deviance(best) < min(deviance(1.5 * best), deviance(best / 1.5))
    assert deviance(best) < min(deviance(d * best) for d in 10.0 ** np.arange(-4, 5) if d != 1)


@pytest.mark.parametrize(("slope", "most"), [(50.0, 0.92), (0.0, 1.01)])
def test_a_sudden_bend_is_smoothed_less_than_what_is_even(slope, most):
    """Mean squares of the errors over seeds, about the course that is known, and about none: a sine
    in noise of 0.02, with a line that begins at once, or without.
    """
    t = np.linspace(0.0, 6.0, 301)
    truth = 0.4 * np.sin(t) + slope * np.maximum(t - 3, 0)
    basis, errors = SplineBasis(0.0, 6.0, 0.02, ()), []
    for seed in range(20):
        read = truth + 0.02 * np.random.default_rng(seed).standard_normal(len(t))
        many = [LinearReadings(t, np.ones((len(t), 1)), read, np.full(len(t), 0.02**-2))]
        first = later = most_probable_course(basis, many)
        for _ in range(2):
            later = most_probable_course(basis, many, later)
        errors.append([np.mean((c.at(t)[:, 0] - truth) ** 2) for c in (first, later)])
    first_error, later_error = np.mean(errors, axis=0)
    assert later_error < most * first_error


def test_at_rest_it_is_the_weighted_mean_of_all_sensors():
    t, _, many = readings(3)
    basis = SplineBasis(0.0, 6.0, 0.1, ((-1.0, 7.0),))
    course = most_probable_course(basis, many).at(t)
    N = sum(r.weight[0] * len(t) * np.outer(r.direction[0], r.direction[0]) for r in many)
    b = sum(r.weight[0] * r.value.sum() * r.direction[0] for r in many)
    np.testing.assert_allclose(course, np.tile(np.linalg.solve(N, b), (len(t), 1)), rtol=1e-8)


def test_a_cubic_stays_as_it_is_also_across_a_gap():
    t, _, _ = readings(4)
    truth = np.column_stack([1 + t, t**2, t - 0.1 * t**3])
    kept = np.where((t > 2) & (t < 3), 0.0, 1.0)
    many = [LinearReadings(t, np.tile(e, (len(t), 1)), truth @ e, kept) for e in np.eye(3)]
    course = most_probable_course(SplineBasis(0.0, 6.0, 0.1, ()), many)
    np.testing.assert_allclose(course.at(t), truth, atol=1e-5)


def test_in_a_rest_nothing_moves_and_a_reading_without_weight_says_nothing():
    t, _, many = readings(5)
    basis = SplineBasis(0.0, 6.0, 0.1, ((0.0, 1.2), (2.9, 3.7), (5.3, 6.0)))
    course = most_probable_course(basis, many)
    assert np.ptp(course.at(np.linspace(3.25, 3.35, 9)), axis=0).max() < 1e-12
    silent = LinearReadings(t, np.tile(AXIS, (len(t), 1)), np.full(len(t), 1e6), np.zeros(len(t)))
    again = most_probable_course(basis, [*many, silent])
    np.testing.assert_array_equal(course.at(t), again.at(t))
