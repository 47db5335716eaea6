"""Kalman filters for the scale of a gyro triad against one FOG (filterpy), a smoother, and their
batch twin.

With X = S/(1 + S), the bias-free reading r = (1 + S) w gives ``u . r - F = sum_i u_i r_i X_i + c +
h . f``: linear and exact in X. c is the error of the difference of the rest means, h = u' G the
g-sensitivity along the FOG's axis.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tiltcal.calibration.methods.field_log import BIAS_SPAN, FieldLog
from tiltcal.core.arrays import Array
from tiltcal.core.units import DEG

SCALE_PRIOR = 0.5  # standard deviation of X: uninformative
ZERO_PRIOR = 1.0 * DEG  # rad/s, of c: uninformative, the rests of the log determine it
GSENS_PRIOR = 0.1 * DEG  # rad/s per g and axis: 360 deg/h/g, a consumer gyro


@dataclass(frozen=True)
class Filtered:
    """The estimate of a filter, smoother or batch fit at the end of the log.

    Args:
        x: X (3), then c, then h where they are estimated.
        P: covariance.
        chi2: squared innovations (batch: residuals) in units of their variance.
        used: number of measurements.
        track: x after each measurement, (n, p); empty for the batch.
    """

    x: Array
    P: Array
    chi2: float
    used: int
    track: Array

    @property
    def scale(self) -> Array:
        """S = X / (1 - X), exactly, (3,)."""
        return np.asarray(self.x[:3] / (1 - self.x[:3]))

    @property
    def scale_covariance(self) -> Array:
        """Of S, (3, 3): dS/dX = 1 / (1 - X)^2."""
        slope = 1 / (1 - self.x[:3]) ** 2
        return np.asarray(self.P[:3, :3] * np.outer(slope, slope))


@dataclass(frozen=True)
class Problem:
    """Measurements z = H x + v with prior, in order of time.

    Args:
        z: (n,); H: (n, p); R: variance of v, (n,).
        prior: variance of x before the first, (p,).
        walk: variance that c gains a second, (rad/s)^2/s.
        step: s since the measurement before, (n,).
    """

    z: Array
    H: Array
    R: Array
    prior: Array
    walk: float
    step: Array


def patent_problem(log: FieldLog) -> Problem:
    """The patent's own: the mean of ten seconds of rest is the bias and has no error; X = [Sx Sy
    Sz] while turning.
    """
    last = np.flatnonzero(log.rest == 0)
    last = last[log.time[last] > log.time[last[-1]] - BIAS_SPAN]
    rate = log.rate - log.rate[last].mean(axis=0)
    moving = log.rest < 0
    z = rate @ log.axis - (log.fog - log.fog[last].mean())  # Z = H1 w - w_f
    H = log.axis * rate  # H = H1 H2
    return Problem(
        z[moving],
        H[moving],
        log.variance[moving],
        np.full(3, SCALE_PRIOR**2),
        0.0,
        np.zeros(int(moving.sum())),
    )


def augmented_problem(
    log: FieldLog, walk: float = 0.0, zero: float = ZERO_PRIOR, stated: Array | None = None
) -> Problem:
    """Rests and turns together, with the error of the rest mean, (with an accelerometer)
    g-sensitivity, and errors of stated references as states.

    Args:
        log: of the calibration.
        walk: variance that the zero gains a second, (rad/s)^2/s.
        zero: standard deviation of c, rad/s.
        stated: what one standard uncertainty of each reference adds to z, rad/s, (n, q).
    """
    columns = [log.axis * log.turned, np.ones((len(log.time), 1))]
    prior = [SCALE_PRIOR**2] * 3 + [zero**2]
    if log.force is not None:
        # c is counted from the first rest's pose
        columns.append(log.force - log.force[log.rest == 0].mean(axis=0))
        prior += [GSENS_PRIOR**2] * 3
    if stated is not None:
        columns.append(stated)
        prior += [1.0] * stated.shape[1]
    step = np.diff(log.time, prepend=log.time[0])
    return Problem(log.difference, np.hstack(columns), log.variance, np.array(prior), walk, step)


def kalman(problem: Problem) -> Filtered:
    """filterpy's Kalman filter over all measurements."""
    x, P, chi2, track, _ = _run(problem, keep=False)
    return Filtered(x, P, chi2, len(problem.z), track)


def smoothed(problem: Problem) -> tuple[Array, Array]:
    """States (n, p) and covariances (n, p, p) of the Rauch-Tung-Striebel smoother: c at every time
    from the whole log.
    """
    _, _, _, track, (filter_, Ps) = _run(problem, keep=True)
    Qs = [_process(problem, k) for k in range(len(track))]
    Fs = [np.eye(len(problem.prior))] * len(track)
    x, P, *_ = filter_.rts_smoother(track[:, :, None], Ps, Fs, Qs)
    return np.asarray(x[:, :, 0]), np.asarray(P)


def _process(problem: Problem, k: int) -> Array:
    Q = np.zeros((len(problem.prior), len(problem.prior)))
    if len(problem.prior) > 3:
        Q[3, 3] = problem.walk * problem.step[k]
    return Q


def _run(problem: Problem, *, keep: bool) -> tuple[Array, Array, float, Array, Any]:
    from filterpy.kalman import KalmanFilter

    p, n = len(problem.prior), len(problem.z)
    f = KalmanFilter(dim_x=p, dim_z=1)
    f.x, f.P, f.F = np.zeros((p, 1)), np.diag(problem.prior), np.eye(p)
    chi2, track, Ps = 0.0, np.empty((n, p)), np.empty((n if keep else 0, p, p))
    drifting = problem.walk > 0
    for k in range(n):
        if drifting:
            f.predict(Q=_process(problem, k))
        f.R[0, 0] = problem.R[k]
        f.update(problem.z[k], H=problem.H[k : k + 1])
        chi2 += float(f.y[0, 0] ** 2 * f.SI[0, 0])
        track[k] = f.x[:, 0]
        if keep:
            Ps[k] = f.P
    return f.x[:, 0].copy(), f.P.copy(), chi2, track, (f, Ps)


def batch(problem: Problem) -> Filtered:
    """The same by one least-squares solution; with a random walk of c over all its values
    (``x[3]``: the last).
    """
    return _random_walk_batch(problem) if problem.walk > 0 else _constant_batch(problem)


def _constant_batch(problem: Problem) -> Filtered:
    root = np.sqrt(problem.prior)
    weight = 1 / np.sqrt(problem.R)
    A = np.vstack([problem.H * root * weight[:, None], np.eye(len(root))])
    target = np.concatenate([problem.z * weight, np.zeros(len(root))])
    q, r = np.linalg.qr(A)
    y = np.linalg.solve(r, q.T @ target)
    residual = target - A @ y
    factor = root[:, None] * np.linalg.inv(r)  # of the covariance
    chi2, none = float(residual @ residual), np.zeros((0, len(root)))
    return Filtered(y * root, factor @ factor.T, chi2, len(problem.z), none)


def _random_walk_batch(problem: Problem) -> Filtered:
    """Normal equations of the constants and of c at every measurement; c's are tridiagonal and are
    eliminated.
    """
    from scipy.linalg import solveh_banded

    constant = [i for i in range(len(problem.prior)) if i != 3]
    A, w = problem.H[:, constant], 1 / problem.R
    link = 1 / (problem.walk * np.maximum(problem.step[1:], 1e-9))
    band = np.zeros((2, len(w)))
    band[1] = w
    band[1, 0] += 1 / problem.prior[3]
    band[1, 1:] += link
    band[1, :-1] += link
    band[0, 1:] = -link
    columns = np.column_stack([w[:, None] * A, w * problem.z, np.eye(len(w))[:, -1]])
    solved = solveh_banded(band, columns)
    k = len(constant)
    B, C = columns[:, :k], solved[:, :k]
    P = np.linalg.inv((A.T * w) @ A + np.diag(1 / problem.prior[constant]) - B.T @ C)
    x = P @ (A.T @ (w * problem.z) - C.T @ (w * problem.z))
    last = -C[-1]  # derivative of the last c by the constants
    full, covariance = np.empty(k + 1), np.empty((k + 1, k + 1))
    full[constant], full[3] = x, solved[-1, k] + last @ x
    covariance[np.ix_(constant, constant)] = P
    covariance[3, constant] = covariance[constant, 3] = P @ last
    covariance[3, 3] = solved[-1, k + 1] + last @ P @ last
    chi2 = problem.z @ (w * problem.z) - (w * problem.z) @ solved[:, k] - x @ np.linalg.solve(P, x)
    return Filtered(full, covariance, float(chi2), len(w), np.zeros((0, k + 1)))
