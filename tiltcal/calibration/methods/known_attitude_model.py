"""Poses of known attitude: the linear model of their means, and its fit."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.calibration.methods.common import leave_out_rms, whitening_of_means
from tiltcal.calibration.methods.terms import term_columns
from tiltcal.core.arrays import Array
from tiltcal.core.units import G0
from tiltcal.effects.base import Effect
from tiltcal.recordings.static_poses import Poses, group_directions
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.statistics.least_squares import Fit, linear_fit

DRIFT = "drift"
Turned = Callable[[Setup, tuple[Effect, ...]], Poses]
"""The poses of a recording with the uncertain references of a set-up and some errors of the
table."""
SETTLED = 0.1  # of the uncertainty of an error: adds half a per cent to it
ROUNDS = 10  # each reduces a change by the scale-factor and cross-axis terms, 0.1 at most


@dataclass(frozen=True)
class Model:
    """What is fitted to pose means.

    Args:
        setup: site and sensors.
        terms: linear effects of the sensor, and ``drift``.
        start, length: of the recording, s.
    """

    setup: Setup
    terms: Sequence[str]
    start: float
    length: float

    def ideal(self, poses: Poses) -> Array:
        """Specific force along each channel, (m, k)."""
        return np.asarray(self.setup.site.gravity * poses.up[:, list(poses.sensor.axis_indices)])

    def columns(self, poses: Poses) -> tuple[list[str], list[str], Array]:
        """Names and units of all parameters, and their columns (p, m, k)."""
        sensor = poses.sensor
        force = self.setup.site.gravity * poses.up
        linear = [t for t in self.terms if t != DRIFT]
        names, units, columns = term_columns(linear, sensor, self.setup, force)
        if DRIFT not in self.terms:
            return names, units, columns
        middles = np.array([(s.start_s + s.end_s) / 2 for s in poses.spans])
        elapsed = (middles - self.start) / self.length
        drifts = np.eye(len(sensor.axes))[:, None, :] * elapsed[None, :, None]
        names += [f"{sensor.name}.{DRIFT}_{axis}" for axis in sensor.axes]
        units += ["m_s2"] * len(sensor.axes)
        return names, units, np.concatenate([columns.reshape(-1, *drifts.shape[1:]), drifts])

    def predicted(self, poses: Poses, fit: Fit) -> Array:
        """What the fitted model predicts for the pose means, (m, k)."""
        names, _, columns = self.columns(poses)
        values = np.array([fit.value(n) for n in names])
        return np.asarray(self.ideal(poses) + np.tensordot(values, columns, axes=1))


def design_of(poses: Poses, model: Model) -> tuple[list[str], list[str], Array]:
    """Names and units of all parameters, (p,), and their whitened columns, (m k, p)."""
    names, units, columns = model.columns(poses)
    whitened = np.einsum("mij,pmj->mip", whitening_of_means(poses), columns)
    return names, units, whitened.reshape(-1, len(names))


def solve(poses: Poses, model: Model) -> tuple[Fit, list[str]]:
    """Weighted least squares on pose means: the fit, and the units of its parameters."""
    names, units, design = design_of(poses, model)
    error = poses.means - model.ideal(poses)
    whiten = whitening_of_means(poses)
    target = np.einsum("mij,mj->mi", whiten, error).ravel()
    fit = linear_fit(names, design, target, poses.references.whitened(whiten))
    return fit, [u for n, u in zip(names, units, strict=True) if n in fit.names]


def solve_about_errors(
    poses: Poses, model: Model, turned: Callable[[tuple[Effect, ...]], Poses]
) -> tuple[Poses, Fit, list[str]]:
    """The fit with the attitudes turned by what it says of stated errors of the table: a zero of a
    readout that is off by 0.5 deg acts with its square, 38 ppm, in addition to its first order.

    Args:
        poses: by the readout.
        model: of their means.
        turned: the poses with some errors of the table.

    Returns:
        The poses that were fitted, the fit, and the units of its parameters.
    """
    fit, units = solve(poses, model)
    used = np.zeros(len(poses.references.owner))
    for _ in range(ROUNDS):
        errors, values = poses.references.turning(fit.posterior)
        if not errors or np.all(np.abs(values - used) <= SETTLED * fit.posterior[1]):
            break
        poses, used = turned(errors), values
        # errors are counted from 0, as their uncertainty is stated
        means = poses.means + np.tensordot(values, poses.references.columns, axes=1)
        poses = replace(poses, means=means)
        fit, units = solve(poses, model)
    return poses, fit, units


def without_drift(fit: Fit, units: Sequence[str], sensor: Sensor) -> tuple[Fit, list[str], str]:
    """The fit without its drift parameters, its units, and the drift in words."""
    keep = np.array([f".{DRIFT}_" not in n for n in fit.names], dtype=bool)
    drifts = ", ".join(
        f"{fit.names[k][-1]} {fit.values[k] / G0 * 1e6:.4g} +- {fit.sigmas[k] / G0 * 1e6:.2g}"
        for k in np.flatnonzero(~keep)
    )
    kept = fit.selected(keep)
    words = (
        f"a linear drift of {sensor.name} over the recording was fitted as well: {drifts} ug; the"
        " bias is that at the first stamp"
    )
    return kept, [u for u, k in zip(units, keep, strict=True) if k], words


def leave_directions_out(poses: Poses, model: Model) -> dict[str, float]:
    """Rms residual of directions left out of the fit, SI, by sensor."""
    group = group_directions(poses.up)
    residuals = []
    for k in range(group.max() + 1):
        rest, out = poses.subset(group != k), poses.subset(group == k)
        if len(rest) == 0:
            return {}
        fit, _ = solve(rest, model)
        if not fit.dropped:
            residuals.append(out.means - model.predicted(out, fit))
    return {poses.sensor.name: leave_out_rms(residuals)} if residuals else {}
