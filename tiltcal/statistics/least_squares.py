"""Weighted least squares: values, covariance, unobservable combinations; linear in one step, else
Gauss-Newton. With it, orthonormal bases of the column space of a design matrix.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from tiltcal.core.arrays import Array, Mask

DISTINCT = 1e-9  # least share of a column's energy that is a direction of its own, per column


def column_space(columns: Array) -> Array:
    """An orthonormal basis of the space of some columns, (n, rank)."""
    if not columns.any():
        return columns[:, :0]
    Q = columns @ inverse_root(columns.T @ columns)
    # a second pass removes the rounding errors of the small directions
    values, vectors = np.linalg.eigh(Q.T @ Q)
    return np.asarray(Q @ (vectors / np.sqrt(values)))


def space_with_prior(columns: Array, random: Array) -> Array:
    """Orthonormal columns of a mean model, as far as the observations hold them, (n, rank).

    A normal size of unit variance is one more observation, "size = 0 with unit noise": the columns
    are orthonormal with these, whose rows are left out.

    Args:
        columns: of any size, in units of the noise, (n, p).
        random: of a normal size of unit variance, (n, q).
    """
    if not random.shape[1]:
        return column_space(columns)
    both = np.column_stack([columns, random])
    prior = np.eye(random.shape[1], both.shape[1], columns.shape[1])
    return column_space(np.vstack([both, prior]))[: len(columns)]


def inverse_root(gram: Array, energy: Array | None = None) -> Array:
    """Combinations of columns that are orthonormal, and span the columns' space, (p, rank).

    Args:
        gram: inner products of the columns, (p, p).
        energy: squared lengths against which rounding is judged, (p,); of the columns
            themselves when None.
    """
    energy = np.diag(gram) if energy is None else energy
    size = np.where(energy > 0, np.sqrt(energy), np.inf)
    values, vectors = np.linalg.eigh(gram / np.outer(size, size))
    keep = values > DISTINCT * np.isfinite(size).sum()
    return np.asarray(vectors[:, keep] / np.sqrt(values[keep]) / size[:, None])


SINGULAR = 1e-8  # of the largest singular value of the column-scaled design


@dataclass(frozen=True)
class CommonErrors:
    """Errors that several observations share, such as those of a reference.

    With independent errors of unit variance, and columns u that belong to the fit, the covariance
    of the observations is ``C = 1 + U U'``. Its inverse square root weights observations and design
    (generalised least squares); with the eigenvectors E and eigenvalues v of U'U, and W = U E, it
    is ``1 - W (1 / (r (1 + r))) W'``, r = sqrt(1 + v).

    Args:
        columns: what one standard deviation of each error adds to the whitened observations,
            (n, q).
        fitted: which are part of the covariance; the others are propagated only, (q,).
    """

    columns: Array
    fitted: Mask

    def weight(self, rows: Array) -> Array:
        """``C^-1/2`` times some whitened observations or columns of them, (n,) or (n, p)."""
        W, r = self._turned
        return np.asarray(rows - W @ ((W.T @ rows).T / (r * (1 + r))).T)

    def unweighted(self, rows: Array) -> Array:
        """``C^1/2`` times some weighted observations: what they were before, (n,) or (n, p)."""
        W, r = self._turned
        return np.asarray(rows + W @ ((W.T @ rows).T / (1 + r)).T)

    def lost(self) -> Array:
        """D of ``C^-1 = 1 - D D'``: the directions in which observations say less, (n, k)."""
        W, r = self._turned
        return np.asarray(W / r)

    @property
    def log_det(self) -> float:
        """Logarithm of the determinant of ``C``."""
        return float(2 * np.log(self._turned[1]).sum())

    def times(self, matrix: Array) -> "CommonErrors":
        """Of linear combinations of the observations. matrix: (m, n)."""
        return replace(self, columns=matrix @ self.columns)

    def followed_by(self, count: int) -> "CommonErrors":
        """Of more observations, which are independent of them."""
        more = np.zeros((count, self.columns.shape[1]))
        return replace(self, columns=np.concatenate([self.columns, more]))

    def propagated(self) -> "CommonErrors":
        """The same errors where the observations are whitened by all of their covariance."""
        return replace(self, fitted=np.zeros_like(self.fitted))

    @cached_property
    def _turned(self) -> tuple[Array, Array]:
        """W and r of the formula."""
        U = self.columns[:, self.fitted]
        values, vectors = np.linalg.eigh(U.T @ U)
        return U @ vectors, np.sqrt(1 + np.maximum(values, 0.0))


def no_common_errors(n: int) -> CommonErrors:
    """Of n independent observations."""
    return CommonErrors(np.zeros((n, 0)), np.zeros(0, bool))


@dataclass(frozen=True)
class Fit:
    """A solved least-squares problem in whitened coordinates.

    Args:
        names: of the parameters that the data determine, (p,).
        values: (p,).
        covariance: (p, p), for unit variance of the whitened residuals.
        residuals: whitened, (n,).
        dropped: names that the data do not determine.
        iterations: of Gauss-Newton; 1 for a linear fit.
        condition: of the column-scaled design.
        rank: number of independent parameters that were fitted; that of ``names`` unless given.
        contributions: what one standard deviation of each common error changes, (p, q).
        posterior: each common error by the data, in its standard deviations, and its standard
            deviation then, (2, q).
    """

    names: tuple[str, ...]
    values: Array
    covariance: Array
    residuals: Array
    dropped: tuple[str, ...] = ()
    iterations: int = 1
    condition: float = 1.0
    rank: int | None = None
    contributions: Array = field(default_factory=lambda: np.zeros((0, 0)))
    posterior: Array = field(default_factory=lambda: np.zeros((2, 0)))

    def selected(self, keep: Mask) -> "Fit":
        """Some of the parameters: the uncertainty of the others stays in theirs. keep: (p,)."""
        names = [name for name, kept in zip(self.names, keep, strict=True) if kept]
        return self.mapped(names, self.values[keep], np.eye(len(keep))[keep])

    def mapped(self, names: Sequence[str], values: Array, slopes: Array) -> "Fit":
        """Functions of the parameters.

        Args:
            names: of the functions, (r,).
            values: (r,).
            slopes: of each function with each parameter, (r, p).
        """
        rank = len(self.names) if self.rank is None else self.rank
        shares = self.contributions
        shares = shares if len(shares) else np.zeros((len(self.names), 0))
        covariance = slopes @ self.covariance @ slopes.T
        return replace(
            self,
            names=tuple(names),
            values=values,
            covariance=covariance,
            rank=rank,
            contributions=slopes @ shares,
        )

    @property
    def dof(self) -> int:
        """Residual degrees of freedom."""
        return len(self.residuals) - (len(self.names) if self.rank is None else self.rank)

    @property
    def chi2(self) -> float:
        """Sum of squares of the whitened residuals."""
        return float(self.residuals @ self.residuals)

    @property
    def chi2_per_dof(self) -> float:
        """chi2 / dof; 0 without degrees of freedom."""
        return self.chi2 / self.dof if self.dof > 0 else 0.0

    @property
    def sigmas(self) -> Array:
        """Standard uncertainties, (p,)."""
        return np.sqrt(np.diag(self.covariance))

    def value(self, name: str) -> float:
        """Value of a parameter; 0 when it was dropped."""
        return float(self.values[self.names.index(name)]) if name in self.names else 0.0


@dataclass(frozen=True)
class Factored:
    """A design matrix in factors: the least-squares solution is ``gain @ u.T @ target``, and its
    covariance ``gain @ gain.T``.

    Args:
        u: orthonormal basis of its column space, (n, rank).
        gain: (p, rank).
        singular: values of the column-scaled design, (rank,).
        determined: parameters without a part in the null space, (p,).
    """

    u: Array
    gain: Array
    singular: Array
    determined: Mask

    @classmethod
    def of(cls, design: Array) -> "Factored":
        """The factors of a design, (n, p)."""
        scale = np.linalg.norm(design, axis=0)
        seen = scale > SINGULAR * max(float(scale.max(initial=0.0)), 1e-300)
        scale = np.where(seen, scale, 1.0)
        u, s, vt = np.linalg.svd(np.where(seen, design, 0.0) / scale, full_matrices=False)
        rank = int(np.sum(s > SINGULAR * s[0])) if len(s) and s[0] > 0 else 0
        u, s, vt = u[:, :rank], s[:rank], vt[:rank]
        inside = np.abs((vt * vt).sum(axis=0) - 1) < 1e-9
        return cls(u, vt.T / s / scale[:, None], s, seen & inside)


def linear_fit(
    names: Sequence[str], design: Array, target: Array, common: CommonErrors | None = None
) -> Fit:
    """Least squares of ``design @ values = target``, both whitened: (n, p), (n,).

    Parameters with a part in the null space are dropped and named; the others are what the data do
    determine.

    Args:
        names: of the parameters, (p,).
        design: (n, p).
        target: (n,).
        common: errors that the observations share.
    """
    common = no_common_errors(len(target)) if common is None else common
    design, target, shared = (common.weight(x) for x in (design, target, common.columns))
    factors = Factored.of(design)
    u, gain, s, keep = factors.u, factors.gain, factors.singular, factors.determined
    residuals = target - u @ (u.T @ target)
    # what the parameters cannot take up of each common error tells it
    told = np.sum(shared * shared, axis=0) - np.sum((u.T @ shared) ** 2, axis=0)
    posterior = np.array([shared.T @ residuals, np.sqrt(np.clip(1 - told, 0.0, 1.0))])
    return Fit(
        tuple(name for name, k in zip(names, keep, strict=True) if k),
        (gain @ (u.T @ target))[keep],
        gain[keep] @ gain[keep].T,
        residuals,
        tuple(name for name, k in zip(names, keep, strict=True) if not k),
        1,
        float(s[0] / s[-1]) if len(s) else float("inf"),
        len(s),
        (gain @ (u.T @ shared))[keep],
        posterior,
    )


def gauss_newton(
    names: Sequence[str],
    start: Array,
    problem: Callable[[Array], tuple[Array, Array]],
    *,
    common: CommonErrors | None = None,
    tolerance: float = 1e-4,
    limit: int = 60,
) -> tuple[Fit, bool]:
    """Minimise |r(x)|^2 by damped Gauss-Newton steps.

    scipy.optimize.least_squares finds the same values (to 2e-11 on twelve norms and nine
    parameters) in 3.2 ms (lm) or 6.1 ms (trf) instead of 2.0 ms.

    Args:
        names: of the parameters.
        start: (p,).
        problem: x -> (whitened residuals (n,), their Jacobian (n, p)).
        common: errors that the residuals share.
        tolerance: of the step, in standard uncertainties.
        limit: of iterations.

    Returns:
        The fit and whether it converged.
    """
    x = np.array(start, dtype=float)
    r, J = problem(x)
    common = no_common_errors(len(r)) if common is None else common
    r, J = common.weight(r), common.weight(J)
    damping = 0.0
    for iteration in range(1, limit + 1):  # noqa: B007  its last value is reported
        scale = np.linalg.norm(J, axis=0)
        scale[scale == 0] = 1.0
        A = np.vstack([J / scale, np.sqrt(damping) * np.eye(len(x))])
        step = np.linalg.lstsq(A, np.concatenate([-r, np.zeros(len(x))]), rcond=SINGULAR)[0] / scale
        small = np.linalg.norm(step * scale) <= tolerance * (1 + np.linalg.norm(r))
        if small and damping == 0.0:
            break
        r_new, J_new = map(common.weight, problem(x + step))
        if np.all(np.isfinite(r_new)) and r_new @ r_new <= (r @ r) * (1 + 1e-9) + 1e-18:
            x, r, J = x + step, r_new, J_new
            damping = damping / 10 if damping > 1e-6 else 0.0
        elif small:
            break
        else:
            damping = max(10 * damping, 1e-4)
            if damping > 1e12:
                break
    weighted = replace(common, columns=common.weight(common.columns)).propagated()
    fit = linear_fit(names, J, -r, weighted)
    kept = [name in fit.names for name in names]
    # here the common errors add to the residuals, whose opposites were fitted
    posterior = fit.posterior * np.array([[-1.0], [1.0]])
    done = replace(fit, values=x[kept], residuals=r, iterations=iteration, posterior=posterior)
    return done, iteration < limit and damping <= 1e12
