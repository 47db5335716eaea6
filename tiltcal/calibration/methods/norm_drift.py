"""The norm method with a linear drift of each bias, seen inside the dwells and between them."""

from dataclasses import replace

import numpy as np

from tiltcal.calibration.methods.norm_model import (
    directions,
    names_of,
    norm_sigma,
    slopes_of_norm,
    start_of,
)
from tiltcal.calibration.screen.drift import mean_slope
from tiltcal.core.arrays import Array
from tiltcal.core.frames import AXES
from tiltcal.recordings.static_poses import Poses
from tiltcal.statistics.least_squares import Fit, gauss_newton

ROUNDS = 3  # the noise of a norm depends weakly on the parameters


def solve_with_drift(
    poses: Poses, g: float, terms: int, start: float, length: float
) -> tuple[Fit, bool]:
    """Maximum likelihood of ``|f| = g`` with bias + drift (t - start) / length.

    The mean slope inside the dwells enters as a measurement of the drift: m norms and three slopes
    for ``terms`` + 3 parameters.

    Args:
        poses: means and slopes.
        g: m/s2.
        terms: 6 or 9.
        start, length: of the recording, s.
    """
    elapsed = _elapsed(poses, start, length)
    names = [*names_of(poses.sensor.name, terms), *(f"{poses.sensor.name}.drift_{a}" for a in AXES)]
    slope, slope_sigma = mean_slope(poses)
    x = np.concatenate([start_of(poses.means, g, terms), slope * length])
    for _ in range(ROUNDS):
        sigma = norm_sigma(replace(poses, means=_level(poses, x[terms:], elapsed)), x[:terms])

        def problem(x: Array, sigma: Array = sigma) -> tuple[Array, Array]:
            f, v = directions(_level(poses, x[terms:], elapsed), x[:terms])
            norms = (np.linalg.norm(f, axis=1) - g) / sigma
            J = np.hstack([slopes_of_norm(f, v, terms), -v * elapsed[:, None]]) / sigma[:, None]
            seen = (x[terms:] / length - slope) / slope_sigma
            tail = np.hstack([np.zeros((3, terms)), np.diag(1 / (length * slope_sigma))])
            return np.concatenate([norms, seen]), np.vstack([J, tail])

        fit, converged = gauss_newton(names, x, problem)
        if fit.dropped or not converged:
            break
        x = fit.values
    return fit, converged


def without_slope(poses: Poses, fit: Fit, start: float, length: float) -> Poses:
    """The poses with the fitted drift taken off their means. start, length: of the recording, s."""
    drift = np.array([fit.value(f"{poses.sensor.name}.drift_{a}") for a in AXES])
    return replace(poses, means=_level(poses, drift, _elapsed(poses, start, length)))


def _level(poses: Poses, drift: Array, elapsed: Array) -> Array:
    return np.asarray(poses.means - elapsed[:, None] * drift)


def _elapsed(poses: Poses, start: float, length: float) -> Array:
    middles = np.array([(s.start_s + s.end_s) / 2 for s in poses.spans])
    return np.asarray((middles - start) / length)
