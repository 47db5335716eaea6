"""S1: poses of known attitude: six positions, and every other set of labelled or table-read poses
(8, 12, 24 positions, tumble).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.calibration.methods.common import (
    leave_out_rms,
    pick_sensor,
    whitening_of_means,
    wrap_up,
)
from tiltcal.calibration.methods.known_attitude_checks import face_tests, fixture_rotation
from tiltcal.calibration.methods.screening import require_unsaturated
from tiltcal.calibration.methods.terms import term_columns
from tiltcal.calibration.result import Calibration
from tiltcal.calibration.validity import Test, chi2_test, threshold_test, verdict_of
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import G0
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment
from tiltcal.recordings.static_poses import Poses, find_poses, group_directions
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.statistics.least_squares import Fit, linear_fit

NAME = "six_position"
LINEAR = ("bias", "scale", "cross_axis")
DRIFT = "drift"


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


def six_position(
    recording: Recording,
    setup: Setup,
    *,
    segments: Sequence[Segment] | None = None,
    sensor: str | None = None,
    terms: Sequence[str] = LINEAR,
) -> Calibration:
    """Bias, scale factor and cross-axis terms from poses whose attitude is known.

    Model: ``reading_i = b_i + (1 + S_i) f_i + sum_j C_ij f_j`` with f = g up; further linear
    effects of the catalogue can be named in ``terms``. Weighted least squares on pose means. With
    ``drift`` among the terms the bias of each channel may drift linearly, ``+ d_i t / T``. The
    drift is a nuisance parameter: it is reported in a warning and not kept; the bias is that at
    the first stamp.

    Args:
        recording: a continuous log; the dwells are found, or given as ``segments``.
        setup: with an accelerometer or inclinometer; attitudes from the table's readout, else from
            labels.
        segments: dwells to use.
        sensor: which, when several fit.
        terms: to estimate.

    Raises:
        TiltcalError: no pose has a known attitude, or a term is unknown.

    Errors:
        A pose error e enters scale as e^2/2 and cross-axis as e. A rotation common to all poses
            (fixture, mounting) is the antisymmetric part of the cross-axis matrix: the two cannot
            be distinguished. K3 is absorbed by the scale factor.

    Source: seed S1 (CN patent on six-position cross-coupling calibration); PHYSICS 6 (1).
    """
    _require_names(terms)
    used = pick_sensor(setup, recording, ("accelerometer", "inclinometer"), sensor, NAME)
    require_unsaturated(recording, used)
    poses, warnings = _poses_of_known_attitude(
        find_poses(recording, setup, used, segments), recording
    )
    start, end = float(recording.time[0]), float(recording.time[-1])
    model = Model(setup, terms, start, end - start)
    fit, units = solve(poses, model)
    tests = [*_fit_tests(poses, model, fit), *face_tests(poses)]
    warnings.append(fixture_rotation(fit, used))
    determined = not fit.dropped and fit.dof > 0
    if not determined:
        words = f"{len(poses)} poses do not determine the model"
        tests.append(threshold_test("determined", len(fit.dropped), False, words, dof=fit.dof))
    heldout = _heldout(poses, model) if not fit.dropped else {}
    if DRIFT in terms:
        fit, units, words = _without_drift(fit, units, used)
        warnings.append(words)
    return wrap_up(
        NAME,
        verdict_of(tests, determined),
        fit,
        units,
        tests,
        warnings,
        poses,
        recording,
        equation=f"{used.name}_i = bias_i + (1 + scale_i) f_i + sum_j cross_ij f_j",
        inverse="f = M^-1 (reading - bias)",
        heldout=heldout,
    )


def _require_names(terms: Sequence[str]) -> None:
    """Refuse anything but a list of names."""
    listed = isinstance(terms, Sequence) and not isinstance(terms, str)
    if not listed or not all(isinstance(t, str) for t in terms):
        raise TiltcalError(
            f"method {NAME}, option terms",
            found=repr(terms),
            need="a list of names",
            do='write terms=\'["bias", "scale"]\'',
        )


def _poses_of_known_attitude(poses: Poses, recording: Recording) -> tuple[Poses, list[str]]:
    """The poses whose attitude is known, and a warning where there are others."""
    known = np.asarray(~np.isnan(poses.up).any(axis=1))
    if not known.any():
        raise TiltcalError(
            recording.source,
            found=f"{len(poses)} dwells without table readout or direction label",
            need="attitudes: table columns, or labels such as +x, -z, [0, 1, 1]",
            do="label the dwells, or use --method norm",
        )
    if known.all():
        return poses.subset(known), []
    unknown = f"{np.sum(~known)} of {len(known)}"
    return poses.subset(known), [f"{unknown} dwells have no known attitude and are not used"]


def solve(poses: Poses, model: Model) -> tuple[Fit, list[str]]:
    """Weighted least squares on pose means: the fit, and the units of its parameters."""
    names, units, columns = model.columns(poses)
    whiten = whitening_of_means(poses)
    error = poses.means - model.ideal(poses)
    design = [W @ columns[:, k, :].T for k, W in enumerate(whiten)]
    target = [W @ error[k] for k, W in enumerate(whiten)]
    fit = linear_fit(names, np.vstack(design), np.concatenate(target))
    return fit, [u for n, u in zip(names, units, strict=True) if n in fit.names]


def _without_drift(fit: Fit, units: Sequence[str], sensor: Sensor) -> tuple[Fit, list[str], str]:
    """The fit without its drift parameters, its units, and the drift in words."""
    keep = np.array([f".{DRIFT}_" not in n for n in fit.names], dtype=bool)
    drifts = ", ".join(
        f"{fit.names[k][-1]} {fit.values[k] / G0 * 1e6:.4g} +- {fit.sigmas[k] / G0 * 1e6:.2g}"
        for k in np.flatnonzero(~keep)
    )
    kept = replace(
        fit,
        names=tuple(np.array(fit.names)[keep].tolist()),
        values=fit.values[keep],
        covariance=fit.covariance[np.ix_(keep, keep)],
    )
    words = (
        f"a linear drift of {sensor.name} over the recording was fitted as well: {drifts} ug; the"
        " bias is that at the first stamp"
    )
    return kept, [u for u, k in zip(units, keep, strict=True) if k], words


def _fit_tests(poses: Poses, model: Model, fit: Fit) -> list[Test]:
    """Are the redundant equations consistent, and if not, does a quadratic term explain why?"""
    words = f"residuals of {fit.dof} redundant equations against the noise of the means"
    tests = [chi2_test("fit", fit.chi2, fit.dof, words)]
    terms = model.terms
    if "K2" in terms or "bias" not in terms or fit.dof < 3 or fit.dropped:
        return tests
    wider, _ = solve(poses, replace(model, terms=[*terms, "K2"]))
    gained = len(wider.names) - len(fit.names)
    # otherwise these poses cannot separate K2 from the linear terms
    if gained > 0 and set(fit.names) <= set(wider.names):
        drop = fit.chi2 - wider.chi2
        sizes = ", ".join(f"{n} {wider.value(n):.3g}" for n in wider.names if ".K2_" in n)
        words = f"a quadratic term (ug/g2: {sizes}) reduces chi2 by {drop:.3g}"
        tests.append(chi2_test("second order", drop, gained, words))
    return tests


def _heldout(poses: Poses, model: Model) -> dict[str, float]:
    """Rms residual of directions left out of the fit, SI."""
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
