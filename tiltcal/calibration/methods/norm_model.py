"""Maximum likelihood of ``|f| = g``: the model, its slopes, and the fit of pose means."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.frames import AXES
from tiltcal.recordings.static_poses import Poses
from tiltcal.statistics.least_squares import CommonErrors, Fit, gauss_newton

ROUNDS = 3  # the noise of a norm depends weakly on the parameters
PAIRS = ((0, 1), (0, 2), (1, 2))
"""The axes of each symmetric cross-axis term."""


def names_of(sensor: str, terms: int) -> list[str]:
    """Parameter names: biases, scales, and with nine the symmetric cross terms (each stands for
    cross_ij = cross_ji).
    """
    names = [f"{sensor}.{term}_{a}" for term in ("bias", "scale") for a in AXES]
    cross = [f"{sensor}.cross_{AXES[i]}{AXES[j]}" for i, j in PAIRS]
    return names + cross if terms == 9 else names


def mirrored(fit: Fit) -> Fit:
    """The fit with each cross_ij repeated under the name cross_ji, so that the equation can be
    applied as written.
    """
    twins = [(k, f"{n[:-2]}{n[-1]}{n[-2]}") for k, n in enumerate(fit.names) if ".cross_" in n]
    if not twins:
        return fit
    T = np.vstack([np.eye(len(fit.names)), np.eye(len(fit.names))[[k for k, _ in twins]]])
    return fit.mapped([*fit.names, *(twin for _, twin in twins)], T @ fit.values, T)


def model_of(x: Array) -> tuple[Array, Array]:
    """Bias (3,) and symmetric M (3, 3) of a parameter vector."""
    M = np.diag(1 + x[3:6])
    for value, (i, j) in zip(x[6:], PAIRS, strict=False):
        M[i, j] = M[j, i] = value
    return x[:3], M


@dataclass(frozen=True)
class Further:
    """Errors of the readings that are fitted beside the parameters.

    Args:
        names: of their sizes, (q,).
        columns: error of each reading per unit size, SI, (q, m, 3).
        measured: of the sizes, with its standard deviation, (q,) each; infinite where nothing is.
        sigma: that.
    """

    names: tuple[str, ...]
    columns: Array
    measured: Array
    sigma: Array

    @classmethod
    def unknown(cls, columns: Array) -> "Further":
        """Sizes of which nothing is known. columns: (q, m, 3)."""
        q = len(columns)
        names = tuple(f"further {k}" for k in range(q))
        return cls(names, columns, np.zeros(q), np.full(q, np.inf))

    @property
    def rows(self) -> int:
        """How many sizes were measured."""
        return int(np.isfinite(self.sigma).sum())

    def taken_off(self, means: Array, sizes: Array) -> Array:
        """The means, (m, 3), without errors of these sizes, (q,)."""
        return np.asarray(means - np.tensordot(sizes, self.columns, axes=1))


def solve(
    poses: Poses, g: float, terms: int, start: Array | None = None, further: Further | None = None
) -> tuple[Fit, bool]:
    """Maximum likelihood from pose means; the fit and whether it converged.

    The noise of a norm depends weakly on the parameters: it is computed at the last solution and
    held constant during each solution.

    Args:
        poses: means, and their noise.
        g: m/s2.
        terms: 6 or 9.
        start: parameters to start from, SI, (terms,).
        further: errors of the readings that are fitted as well.
    """
    if further is None:
        further = Further.unknown(np.zeros((0, len(poses), 3)))
    names = [*names_of(poses.sensor.name, terms), *further.names]
    x = start_of(poses.means, g, terms) if start is None else start
    x = np.concatenate([x, further.measured])
    for _ in range(ROUNDS if start is None else 1):
        level = replace(poses, means=further.taken_off(poses.means, x[terms:]))
        sigma = norm_sigma(level, x[:terms])
        problem = partial(_whitened, poses.means, g, sigma, terms, further)
        common = common_errors(level, x[:terms], sigma).followed_by(further.rows)
        fit, converged = gauss_newton(names, x, problem, common=common)
        if fit.dropped or not converged:
            break
        x = fit.values
    return fit, converged


def directions(y: Array, x: Array) -> tuple[Array, Array]:
    """f (m, 3), and v' = (f/|f|)' M^-1 (m, 3), the derivative of |f| with the reading."""
    b, M = model_of(x)
    inverse = np.linalg.inv(M)
    f = (y - b) @ inverse.T
    return f, (f / np.linalg.norm(f, axis=1)[:, None]) @ inverse


def norm_sigma(poses: Poses, x: Array) -> Array:
    """Standard deviation of each pose's norm, (m,)."""
    _, v = directions(poses.means, x)
    return np.sqrt(np.einsum("ki,kij,kj->k", v, poses.covariances, v))


def common_errors(poses: Poses, x: Array, sigma: Array) -> CommonErrors:
    """What uncertain references add to the norms, in units of their noise.

    Args:
        poses: (m,).
        x: parameters at which it is evaluated, SI, (p,).
        sigma: noise of each norm, m/s2, (m,).
    """
    _, v = directions(poses.means, x)
    return poses.references.along(v / sigma[:, None])


def slopes_of_norm(f: Array, v: Array, terms: int) -> Array:
    """Derivative of |f| with the parameters, (m, terms)."""
    columns = [-v, -v * f]
    if terms == 9:
        columns.append(
            np.column_stack([-(v[:, i] * f[:, j] + v[:, j] * f[:, i]) for i, j in PAIRS])
        )
    return np.hstack(columns)


def _whitened(
    y: Array, g: float, sigma: Array, terms: int, further: Further, x: Array
) -> tuple[Array, Array]:
    """Residuals (|f| - g) / sigma, those of what was measured, and their Jacobian."""
    f, v = directions(further.taken_off(y, x[terms:]), x[:terms])
    columns = -np.einsum("mi,qmi->mq", v, further.columns)
    norms = (np.linalg.norm(f, axis=1) - g) / sigma
    J = np.hstack([slopes_of_norm(f, v, terms), columns]) / sigma[:, None]
    known = np.isfinite(further.sigma)
    seen = ((x[terms:] - further.measured) / further.sigma)[known]
    tail = np.hstack([np.zeros((len(known), terms)), np.diag(1 / further.sigma)])[known]
    return np.concatenate([norms, seen]), np.vstack([J, tail])


def start_of(y: Array, g: float, terms: int) -> Array:
    """Axis-aligned ellipsoid through the readings, by linear least squares; the nominal parameters
    where the quadric is no ellipsoid or an implausible one. y: means of the poses, m/s2, (n, 3);
    the parameters, SI, (p,).
    """
    x = np.zeros(terms)
    scaled = y / g
    design = np.hstack([scaled**2, scaled, np.ones((len(y), 1))])
    # a y^2 + c y + d = 0 also fits where the origin lies outside the ellipsoid
    coefficients = np.linalg.svd(design)[2][-1]
    squares, linear, constant = coefficients[:3], coefficients[3:6], coefficients[6]
    if not (np.all(squares > 0) or np.all(squares < 0)):
        return x
    centre = -linear / (2 * squares)
    scale2 = (np.sum(squares * centre**2) - constant) / squares
    if np.all((scale2 > 0.04) & (scale2 < 25)):
        x[:3], x[3:6] = centre * g, np.sqrt(scale2) - 1
    return x


def vector_of(fit: Fit, poses: Poses, terms: int) -> Array:
    """All parameters of a fit in the order of ``names_of``, 0 where one was dropped, (terms,)."""
    return np.array([fit.value(n) for n in names_of(poses.sensor.name, terms)])
