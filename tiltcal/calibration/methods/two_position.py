"""S4: two positions half a turn apart cancel the bias: the tilt of the table's rotation axis."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tiltcal.calibration.methods.common import pick_sensor, require_xy, whitening, wrap_up
from tiltcal.calibration.methods.reversal import (
    dwell_angles,
    mount_of,
    off_half_turn,
    require_vertical,
)
from tiltcal.calibration.methods.reversal_faults import Reversal, explain, solve, still_test
from tiltcal.calibration.result import Calibration
from tiltcal.calibration.screen.columns import unit_test
from tiltcal.calibration.screen.data import data_tests
from tiltcal.calibration.screen.outliers import outlier_tests
from tiltcal.calibration.validity import Test, chi2_test, threshold_test, verdict_of
from tiltcal.core.arrays import Array
from tiltcal.core.errors import one_of
from tiltcal.core.frames import base_tilt, force_of_tilt
from tiltcal.core.quantisation import lsb_width
from tiltcal.core.units import DEG
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment
from tiltcal.recordings.static_poses import Poses, find_poses
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.statistics.least_squares import Fit
from tiltcal.statistics.robust_location import ESTIMATORS, Locations, locations

NAME = "two_position"
HEAVY_TAILS = 1.5  # ratio of two standard deviations above which another estimator is suggested


def two_position(
    recording: Recording,
    setup: Setup,
    *,
    segments: Sequence[Segment] | None = None,
    sensor: str | None = None,
    estimator: str = "mean",
) -> Calibration:
    """Roll and pitch of the base, and bias plus mounting, from dwells at different angles of a
    vertical table.

    Model: ``reading = c + P R_mount^T Rz(-outer) u``, u the horizontal part of the specific force
    in the base's frame; then ``roll = asin(u_y / g)``, ``pitch = -asin(u_x / (g cos roll))``. Two
    dwells at a and a + 180 deg give half the difference and half the sum; more dwells are used by
    least squares and test each other.

    Args:
        recording: a continuous log with table_outer.
        setup: table ``vertical``, an accelerometer or inclinometer with x and y.
        segments: dwells to use.
        sensor: which, when several fit.
        estimator: of a dwell: ``mean``; ``median`` (50 % breakdown, but it sticks to codes and is
            25 % noisier); ``huber``, ``tukey`` (M-estimators); ``inliers`` (the mean after
            rejection by the median absolute deviation: keeps the dither).

    Raises:
        TiltcalError: another table, fewer than two dwells, no half turn between them, or a
            saturated channel.

    Errors:
        A scale error S makes S x tilt; K2 cancels, K3 and odd INL do not; a linear drift d leaves d
            dt/2 (A-B-A cancels it); an index error e of the half turn is taken from the readout.

    Source: Transducer and Microsystem Technologies 2009 28(12) p. 86 (docs/sources.md, "Dual-axis
    tilt and north"); docs/physics.md, "Reversal".
    """
    require_vertical(setup, NAME, "use six_position")
    one_of(estimator, ESTIMATORS, f"method {NAME}, option estimator")
    used = pick_sensor(setup, recording, ("accelerometer", "inclinometer"), sensor, NAME)
    require_xy(used, NAME)
    live = data_tests(recording, used, axes="xy")
    poses = find_poses(recording, setup, used, segments)
    angles = dwell_angles(poses, recording)
    chunks, codes = _chunks(recording, setup, used, poses)
    # an inclinometer's noise: cos(tilt)
    shown = [c / s for c, s in zip(chunks, poses.spread[:, _channels(poses)], strict=True)]
    found = locations(shown, estimator, codes)
    reversal = _reversal(poses, found, angles, mount_of(recording, setup), estimator)
    fit = solve(reversal)
    if estimator == "mean":
        live += outlier_tests(recording, poses, "xy")
    tests = [*_tests(fit, reversal, len(poses)), *live]
    if len(used.axes) == 3:
        length = np.median(np.linalg.norm(poses.means, axis=1)) / setup.site.gravity
        tests.append(unit_test(used, float(length), recording.sensor(used).units[0]))
    tests.append(_still(shown, found))
    if estimator == "median":
        tests.append(_sticky(found, poses, codes))
    return _tilt(fit, poses, tests, _notes(fit, shown, found, estimator, codes), setup, recording)


def _channels(poses: Poses) -> list[int]:
    return [poses.sensor.axes.index(a) for a in ("x", "y")]


def _chunks(
    recording: Recording, setup: Setup, sensor: Sensor, poses: Poses
) -> tuple[list[Array], Array]:
    """Samples of x and y of each dwell, m/s2, (n_i, 2), and the width of their codes."""
    samples = recording.sensor(sensor)
    values = (
        force_of_tilt(samples.values, setup.site.gravity)
        if sensor.kind == "inclinometer"
        else samples.values
    )
    complete = ~np.isnan(values).any(axis=1)
    time, values = samples.time[complete], values[complete][:, _channels(poses)]
    parts = [values[(time >= s.start_s) & (time <= s.end_s)] for s in poses.spans]
    return parts, np.array([lsb_width(values[:, i]) for i in range(2)])


def _reversal(
    poses: Poses, found: Locations, angles: Array, mount: Array, estimator: str
) -> Reversal:
    """Locations with their whitening; that of the mean is the one of all methods."""
    ij = _channels(poses)
    if estimator == "mean":
        covariance = poses.covariances[:, ij][:, :, ij]
        return Reversal(
            poses.means[:, ij], whitening(covariance), angles, mount, poses.references.of(ij)
        )
    slope = poses.spread[:, ij]
    unit = found.unit * slope[:, :, None] * slope[:, None, :]
    covariance = unit / poses.counts[:, None, None]
    covariance = covariance + np.eye(2) * poses.rounding[:, None, ij]
    return Reversal(
        found.values * slope, whitening(covariance), angles, mount, poses.references.of(ij)
    )


def _tilt(
    fit: Fit, poses: Poses, tests: list[Test], notes: list[str], setup: Setup, recording: Recording
) -> Calibration:
    """From the horizontal force to roll and pitch, with covariance."""
    g = setup.site.gravity
    roll, pitch = base_tilt(fit.values[:2], g)
    # d roll = du_y / (g cos roll); sin pitch = -u_x / (g cos roll)
    d_roll = np.array([0.0, 1 / (g * np.cos(roll))])
    by_x = np.array([-1 / (g * np.cos(roll) * np.cos(pitch)), 0.0])
    J = np.eye(4)
    J[0, :2], J[1, :2] = d_roll, by_x + np.tan(pitch) * np.tan(roll) * d_roll
    names = ("base.roll", "base.pitch", *(f"{poses.sensor.name}.bias_{a}" for a in "xy"))
    values = np.array([roll, pitch, *fit.values[2:]])
    tilted = fit.mapped(names, values, J)
    return wrap_up(
        NAME,
        verdict_of(tests),
        tilted,
        ["rad", "rad", "m_s2", "m_s2"],
        tests,
        notes,
        poses,
        recording,
        equation="reading = bias + P R_mount^T Rz(-outer) R_base^T (0, 0, g)",
        inverse="f = reading - bias",
    )


def _tests(fit: Fit, reversal: Reversal, dwells: int) -> list[Test]:
    opposite = off_half_turn(reversal.angles) / DEG
    words = f"the nearest pair is {opposite:.4g} deg off 180"
    tests = [threshold_test("half a turn", opposite, opposite < 5, words)]
    if fit.dof > 0:
        words = f"{dwells} dwells repeat within their noise (base, mounting, drift)"
        test = chi2_test("fit", fit.chi2, fit.dof, words)
        if not test.passed:
            words = f"{dwells} dwells do not repeat within their noise; {explain(reversal)}"
            test = replace(test, statement=words)
        tests.append(test)
    return tests


def _still(shown: list[Array], found: Locations) -> Test:
    """The means of the two halves of each dwell agree; outliers are clipped at 3.5 robust
    standard deviations.
    """
    limit = 3.5 * found.scale
    residuals = [np.clip(c - v, -limit, limit) for c, v in zip(shown, found.values, strict=True)]
    means = np.array([[half.mean(axis=0) for half in np.array_split(r, 2)] for r in residuals])
    counts = np.array([len(c) for c in shown])[:, None]
    noise = np.maximum(np.concatenate(residuals).std(axis=0), 1e-12)
    return still_test(means[:, 1] - means[:, 0], 2 * noise / np.sqrt(counts))


def _sticky(found: Locations, poses: Poses, codes: Array) -> Test:
    """The error of a median that sticks to a code, against its noise."""
    noise = float(np.min(np.sqrt(np.pi / 2) * found.scale)) / np.sqrt(poses.counts.min())
    code = float(codes.max())
    ratio = code / np.sqrt(24) / noise
    words = (
        f"a median sticks to LSBs of {code:.3g} m/s2: {ratio:.2g} times its noise; use the mean,"
        " or estimator=inliers"
    )
    return threshold_test("median against quantisation", ratio, ratio < 1, words)


def _notes(
    fit: Fit, shown: list[Array], found: Locations, estimator: str, codes: Array
) -> list[str]:
    notes = ["base.* is the tilt of the table's rotation axis; bias_* is bias plus mounting"]
    if fit.dof == 0:
        notes.append(
            "two dwells are not redundant: repeat the first position (A-B-A) to test drift and a"
            " moved base"
        )
    if estimator == "mean" and np.any(np.sqrt(np.diag(found.unit)) > HEAVY_TAILS * found.scale):
        gain = np.sqrt(np.diag(found.unit) / np.diag(locations(shown, "inliers", codes).unit)).max()
        if gain > HEAVY_TAILS:
            notes.append(
                f"the noise has heavy tails: --option estimator=inliers would be {gain:.2g} times"
                " as good"
            )
    elif found.rejected.max() > 0.01:
        notes.append(f"{found.rejected.max():.1%} of the samples were rejected")
    return notes
