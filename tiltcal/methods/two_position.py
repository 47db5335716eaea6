"""S4: two positions half a turn apart cancel the bias: the tilt of the table's rotation axis."""

from collections.abc import Sequence

import numpy as np

from tiltcal.calibration import Calibration, Test, chi2_test, verdict_of
from tiltcal.errors import TiltcalError
from tiltcal.fit import Fit, linear_fit
from tiltcal.frames import Array, base_tilt, force_of_tilt, rotation
from tiltcal.methods.common import pick_sensor, wrap_up
from tiltcal.methods.reversal import dwell_angles, mount_of, off_half_turn, require_vertical
from tiltcal.noise import code_width
from tiltcal.poses import Poses, find_poses
from tiltcal.recording import Recording
from tiltcal.segments import Segment
from tiltcal.setup import Sensor, Setup
from tiltcal.units import DEG

NAME = "two_position"
ESTIMATORS = ("mean", "median")


def two_position(
    recording: Recording, setup: Setup, *, segments: Sequence[Segment] | None = None, sensor: str | None = None,
    estimator: str = "mean",
) -> Calibration:  # fmt: skip
    """Roll and pitch of the base, and bias plus mounting, from dwells at different angles of a vertical table.

    Model: ``reading = c + P R_mount^T Rz(-outer) u``, u the horizontal part of the specific force in the base's frame;
    then ``roll = asin(u_y / g)``, ``pitch = -asin(u_x / (g cos roll))``. Two dwells at a and a + 180 deg give half the
    difference and half the sum; more dwells are used by least squares and test each other.

    Args:
        recording: a continuous log with table_outer.
        setup: table ``vertical``, an accelerometer or inclinometer with x and y.
        segments: dwells to use.
        sensor: which, when several fit.
        estimator: of a dwell: ``mean``, or ``median`` (robust, but it sticks to codes and is 25 % noisier).

    Raises:
        TiltcalError: another table, fewer than two dwells, or no half turn between them.

    Errors:
        A scale error S makes S x tilt; K2 cancels, K3 and odd INL do not; a linear drift d leaves d dt/2 (A-B-A cancels it);
        an index error e of the half turn is taken from the readout.

    Source: seed S4 (Transducer and Microsystem Technologies 2009 28(12) p. 86); PHYSICS 6 (4).
    """
    require_vertical(setup, NAME, "use six_position")
    if estimator not in ESTIMATORS:
        raise TiltcalError(f"method {NAME}, option estimator", found=estimator, need=" or ".join(ESTIMATORS), do="correct it")
    used = pick_sensor(setup, recording, ("accelerometer", "inclinometer"), sensor, NAME)
    if not {"x", "y"} <= set(used.axes):
        raise TiltcalError(f"method {NAME}", found=f"axes {', '.join(used.axes)}", need="x and y", do="add the other channel")
    poses = find_poses(recording, setup, used, segments)
    angles = dwell_angles(poses, recording)
    values, factor, code = poses.means, 1.0, 0.0
    if estimator == "median":
        values, factor, code = _medians(recording, setup, used, poses)
    fit = _solve(poses, values, angles, mount_of(recording, setup), factor)
    return _tilt(fit, poses, angles, estimator, code, setup, recording)


def _medians(recording: Recording, setup: Setup, sensor: Sensor, poses: Poses) -> tuple[Array, float, float]:
    """Median of each dwell, the variance of a median over that of a mean (pi/2), and the code width of the reading."""
    samples = recording.sensor(sensor)
    values = force_of_tilt(samples.values, setup.site.gravity) if sensor.kind == "inclinometer" else samples.values
    medians = [np.nanmedian(values[(samples.time >= s.start_s) & (samples.time <= s.end_s)], axis=0) for s in poses.spans]
    return np.array(medians), np.pi / 2, max(code_width(values[:, i]) for i in range(values.shape[1]))


def _solve(poses: Poses, values: Array, angles: Array, mount: Array, factor: float) -> Fit:
    """Weighted least squares for u_x, u_y and the constants of both channels."""
    channels = [poses.sensor.axes.index(a) for a in ("x", "y")]
    rows, target = [], []
    for k, angle in enumerate(angles):
        turn = (mount.T @ rotation("z", -angle))[:2, :2]
        whiten = np.linalg.inv(np.linalg.cholesky(factor * poses.covariance(k)[np.ix_(channels, channels)]))
        rows.append(whiten @ np.hstack([turn, np.eye(2)]))
        target.append(whiten @ values[k][channels])
    name = poses.sensor.name
    return linear_fit(["u_x", "u_y", f"{name}.bias_x", f"{name}.bias_y"], np.vstack(rows), np.concatenate(target))


def _tilt(fit: Fit, poses: Poses, angles: Array, estimator: str, code: float, setup: Setup, recording: Recording) -> Calibration:
    """From the horizontal force to roll and pitch, with covariance and tests."""
    g = setup.site.gravity
    roll, pitch = base_tilt(fit.values[:2], g)
    # d roll = du_y / (g cos roll); sin pitch = -u_x / (g cos roll)
    d_roll = np.array([0.0, 1 / (g * np.cos(roll))])
    d_pitch = np.array([-1 / (g * np.cos(roll) * np.cos(pitch)), 0.0]) + np.tan(pitch) * np.tan(roll) * d_roll
    J = np.eye(4)
    J[0, :2], J[1, :2] = d_roll, d_pitch
    names = ("base.roll", "base.pitch", *fit.names[2:])
    tilted = Fit(
        names,
        np.array([roll, pitch, *fit.values[2:]]),
        J @ fit.covariance @ J.T,
        fit.residuals,
        (),
        1,
        fit.condition,
    )
    tests = _tests(tilted, poses, angles, estimator, code)
    warnings = ["base.* is the tilt of the table's rotation axis; bias_* is bias plus mounting"]
    if fit.dof == 0:
        warnings.append(
            "two dwells leave nothing to check them by: repeat the first position (A-B-A) to test drift and a moved base"
        )
    return wrap_up(
        NAME, verdict_of(tests), tilted, ["rad", "rad", "m_s2", "m_s2"], tests, warnings, poses, recording,
        equation="reading = bias + P R_mount^T Rz(-outer) R_base^T (0, 0, g)", inverse="f = reading - bias",
    )  # fmt: skip


def _tests(fit: Fit, poses: Poses, angles: Array, estimator: str, code: float) -> list[Test]:
    tests = []
    opposite = off_half_turn(angles)
    tests.append(
        Test("half a turn", float(opposite / DEG), 0, float(opposite < 5 * DEG), bool(opposite < 5 * DEG),
             f"the nearest pair is {opposite / DEG:.4g} deg off 180")
    )  # fmt: skip
    if fit.dof > 0:
        tests.append(
            chi2_test(
                "fit",
                fit.chi2,
                fit.dof,
                f"{len(poses)} dwells repeat within their noise (base, mounting, drift)",
            )
        )
    if estimator == "median":
        noise = np.sqrt(np.pi / 2 * poses.noise[0, 0] / poses.counts.min())
        sticky = code / np.sqrt(24)
        tests.append(
            Test("median against codes", float(sticky / noise), 0, float(sticky < noise), bool(sticky < noise),
                 f"a median sticks to codes of {code:.3g} m/s2: {sticky / noise:.2g} times its noise; use the mean")
        )  # fmt: skip
    return tests
