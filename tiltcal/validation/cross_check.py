"""Is this calibration good on that other recording?"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.calibration.result import Calibration
from tiltcal.calibration.validity import Test, chi2_test
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import best_rotation, tangents
from tiltcal.core.tabular import Tabular
from tiltcal.core.units import ARCSEC, DEG
from tiltcal.effects.sensor.dynamics import placing_angle
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment
from tiltcal.recordings.static_poses import Poses, find_poses
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.validation.accuracy import estimated_up

AGREES = "agrees with its uncertainty"


@dataclass(frozen=True)
class Check(Tabular):
    """How well a calibration predicts another recording.

    Args:
        accepted: within the limit, or without one within its own uncertainty.
        judged_by: ``tilt`` against known attitudes, ``norm`` where they are not known, ``base`` for
            a base tilt, ``table`` for placing-angle tables.
        rms, worst: error over the dwells, rad.
        expected: rms error that noise and the calibration's covariance predict, rad.
        poses: error of each dwell, rad, (m,).
        tests: statistical ones.
        statement: as text.
    """

    accepted: bool
    judged_by: str
    rms: float
    worst: float
    expected: float
    poses: Array
    spans: Sequence[tuple[float, float]]
    tests: Sequence[Test]
    statement: str

    def as_columns(self) -> Mapping[str, Sequence[float]]:
        """Beginning, end and error of each dwell."""
        return {
            "start_s": [a for a, _ in self.spans],
            "end_s": [b for _, b in self.spans],
            "error_arcsec": [float(e / ARCSEC) for e in self.poses],
        }

    def headline(self) -> str:
        """The judgement."""
        return f"{'accepted' if self.accepted else 'not accepted'}: {self.statement}"


def check(
    calibration: Calibration,
    recording: Recording,
    setup: Setup,
    limit: float | None = None,
    segments: Sequence[Segment] | None = None,
) -> Check:
    """Judge a calibration on a recording it has not seen.

    Args:
        calibration: of an accelerometer or inclinometer.
        recording: with dwells; attitudes by readout or label make it a tilt check, else only the
            norm is judged.
        setup: of the recording.
        limit: largest rms tilt error, rad; without it the error has to agree with its own
            uncertainty at 0.1 %.
        segments: dwells to use.

    Raises:
        TiltcalError: it calibrates nothing that senses gravity, or neither attitudes nor a triad
            can judge it.
    """
    sensor = _judged_sensor(calibration, setup)
    poses = find_poses(recording, setup, sensor, segments)
    known = np.asarray(~np.isnan(poses.up).any(axis=1))
    if "base.roll" in calibration.parameters:
        return _base_check(calibration, recording, setup, limit, segments)
    if calibration.bias_tables:
        return _table_check(calibration, poses, setup.site.gravity, limit, recording.source)
    by_norm = not known.any() or (calibration.method == "norm" and known.sum() < 3)
    if by_norm and len(sensor.axes) < 3:
        raise TiltcalError(
            recording.source,
            found=f"no known attitude, and {len(sensor.axes)} axes of {sensor.name}",
            need="table readout or direction labels, or a triad to judge by the norm",
            do="label the dwells",
        )
    if not by_norm:
        poses = poses.subset(known)
    free_rotation = calibration.method == "norm" and not by_norm
    measure = _Measure(poses, setup, by_norm, free_rotation)
    residual = measure.residual(calibration.correct(sensor, poses.means, setup.site.gravity))
    covariance = measure.covariance(calibration)
    error = np.abs(residual) if by_norm else np.linalg.norm(residual.reshape(-1, 2), axis=1)
    dof = residual.size - (3 if measure.free_rotation else 0)
    chi2 = float(residual @ np.linalg.solve(covariance, residual))
    own = measure.covariance(calibration, rotation=False)
    expected = float(np.sqrt(np.trace(own) / len(poses)))
    text = f"errors against noise and covariance over {len(poses)} dwells"
    test = chi2_test(AGREES, chi2, dof, text)
    return _answer(error, expected, test, "norm" if by_norm else "tilt", limit, poses)


def _judged_sensor(calibration: Calibration, setup: Setup) -> Sensor:
    sensors = [s for s in map(setup.named, calibration.sensors()) if s.is_accelerometer]
    if not sensors:
        raise TiltcalError(
            f"calibration by {calibration.method}",
            found="no parameter of an accelerometer or inclinometer",
            need="one that senses gravity",
            do="check it on what it calibrates",
        )
    return sensors[0]


class _Measure:
    """Errors of the dwells as one vector with its covariance: |f|/g - 1 each, or two tangential
    components of up each.
    """

    def __init__(self, poses: Poses, setup: Setup, by_norm: bool, free_rotation: bool) -> None:
        self.poses, self.g = poses, setup.site.gravity
        self.by_norm, self.free_rotation = by_norm, free_rotation
        if not by_norm:
            self.basis = tangents(poses.up)  # (m, 2, 3)

    def residual(self, f: Array) -> Array:
        """Errors of corrected forces, rad, (m,) or (2 m,)."""
        if self.by_norm:
            return np.asarray(np.linalg.norm(f, axis=1) / self.g - 1)
        up = estimated_up(f, self.g)
        if self.free_rotation:
            up = up @ best_rotation(self.poses.up, up).T
        return np.einsum("mij,mj->mi", self.basis, up - self.poses.up).ravel()

    def covariance(self, calibration: Calibration, rotation: bool = True) -> Array:
        """Of the residual, from the calibration's covariance (common to all dwells) and each
        dwell's own noise.
        """
        base = self._residual_of_means(calibration, self.poses.means)
        total = self._common_covariance(calibration, base)
        self._add_noise(total, calibration, base)
        if self.free_rotation and rotation:  # three directions that the best rotation removes
            axes = np.array([np.cross(e, self.poses.up) for e in np.eye(3)])
            turns = np.einsum("mij,amj->ami", self.basis, axes).reshape(3, -1)
            total += turns.T @ turns
        return total + 1e-30 * np.eye(len(base))

    def _residual_of_means(self, calibration: Calibration, means: Array) -> Array:
        return self.residual(calibration.correct(self.poses.sensor, means, self.g))

    def _common_covariance(self, calibration: Calibration, base: Array) -> Array:
        """The calibration's covariance, along its eigenvectors."""
        parameters = calibration.parameters
        values, vectors = np.linalg.eigh(calibration.covariance)
        columns = []
        for step, vector in zip(np.sqrt(np.maximum(values, 0.0)), vectors.T, strict=True):
            changed = {
                name: replace(estimate, value=estimate.value + step * d)
                for (name, estimate), d in zip(parameters.items(), vector, strict=True)
            }
            shifted = replace(calibration, parameters=changed)
            columns.append(self._residual_of_means(shifted, self.poses.means) - base)
        common = np.array(columns).T
        return common @ common.T if columns else np.zeros((len(base), len(base)))

    def _add_noise(self, total: Array, calibration: Calibration, base: Array) -> None:
        """Add each dwell's own noise to its block of a covariance."""
        poses = self.poses
        size = len(base) // len(poses)
        sigmas = np.sqrt(np.diag(poses.noise) * poses.inflation / poses.counts[:, None])
        for i in range(len(poses.sensor.axes)):
            shifted = poses.means.copy()
            shifted[:, i] += sigmas[:, i] * poses.spread[:, i]
            change = self._residual_of_means(calibration, shifted) - base
            for k, row in enumerate(change.reshape(-1, size)):
                block = slice(k * size, (k + 1) * size)
                total[block, block] += np.outer(row, row)


def _answer(
    error: Array, expected: float, test: Test, kind: str, limit: float | None, poses: Poses
) -> Check:
    rms, worst = float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())
    accepted = test.passed if limit is None else rms <= limit
    against = f"its own uncertainty ({expected / ARCSEC:.3g} arcsec expected)"
    if limit is not None:
        against = f"the limit of {limit / ARCSEC:.4g} arcsec"
    named = {
        "tilt": "tilt error",
        "norm": "error of the norm (as an angle; attitudes are not known)",
        "base": "difference of the base tilt",
        "table": "error of a horizontal axis",
    }
    statement = (
        f"{named[kind]} over {len(error)} dwells: {rms / ARCSEC:.4g} arcsec rms,"
        f" {worst / ARCSEC:.4g} worst; "
    )
    statement += ("within " if accepted else "beyond ") + against
    spans = [(s.start_s, s.end_s) for s in poses.spans]
    return Check(accepted, kind, rms, worst, expected, error, spans, [test], statement)


def _table_check(
    calibration: Calibration, poses: Poses, g: float, limit: float | None, source: str
) -> Check:
    """A placing-angle table is judged where its axis is stated to be horizontal: the corrected
    reading there is its error.
    """
    sensor = poses.sensor
    corrector = calibration.placing(sensor, g)
    fixed = calibration.correct(sensor, poses.means, g)
    error, variance, used = [], [], []
    for axis, table in corrector.tables.items() if corrector else ():
        i, j = sensor.axes.index(axis), "xyz".index(axis)
        horizontal = np.abs(poses.up[:, j]) < np.sin(1 * DEG)
        for k in np.flatnonzero(horizontal & ~np.isnan(fixed[:, i])).tolist():
            beta = placing_angle(axis, poses.up[k : k + 1])
            near = replace(table, values=table.sigmas).at(beta)[0]
            error.append((fixed[k, i] - g * poses.up[k, j]) / g)
            variance.append((poses.covariance(k)[i, i] + near**2) / g**2)
            used.append(k)
    if not error:
        raise TiltcalError(
            source,
            found="no dwell with a calibrated axis horizontal at an angle of its table",
            need="some to judge it by",
            do="record dwells on the table it was made on, at angles inside it",
        )
    e, v = np.array(error), np.array(variance)
    text = f"{len(e)} dwells against noise and table"
    test = chi2_test(AGREES, float(np.sum(e**2 / v)), len(e), text)
    keep = np.isin(np.arange(len(poses)), used)
    return _answer(np.abs(e), float(np.sqrt(v.mean())), test, "table", limit, poses.subset(keep))


def _base_check(
    calibration: Calibration,
    recording: Recording,
    setup: Setup,
    limit: float | None,
    segments: Sequence[Segment] | None,
) -> Check:
    """A base tilt is judged by measuring it again."""
    from tiltcal.calibration.methods.registry import calibrate

    again = calibrate("two_position", recording, setup, segments=segments)
    names = ["base.roll", "base.pitch"]
    difference = np.array([again.value(n) - calibration.value(n) for n in names])
    sigma = np.array(
        [np.hypot(again.parameters[n].sigma, calibration.parameters[n].sigma) for n in names]
    )
    chi2 = float(np.sum((difference / sigma) ** 2))
    test = chi2_test(AGREES, chi2, 2, "roll and pitch measured again")
    error = np.array([float(np.hypot(*difference))])
    poses = find_poses(recording, setup, _judged_sensor(calibration, setup), segments)
    return _answer(error, float(np.hypot(*sigma)), test, "base", limit, poses)
