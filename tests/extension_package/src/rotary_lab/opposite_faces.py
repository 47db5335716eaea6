"""Bias and scale factor from pairs of opposite faces."""

import numpy as np

from tiltcal.calibration.result import Calibration, Estimate
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.static_poses import Poses, find_poses
from tiltcal.setup.setup import Setup

STRAIGHT = 0.9999  # cosine to the vertical, at least, of an axis that counts as up or down


def opposite_faces(recording: Recording, setup: Setup) -> Calibration:
    """Half the sum and half the difference of the readings with an axis up and down.

    Args:
        recording: dwells with each axis up and down, with the table's readout.
        setup: with one accelerometer.

    Errors: a cross-axis term enters only with the square of the pose's error.
    """
    (sensor,) = setup.sensors("accelerometer")
    poses = find_poses(recording, setup, sensor)
    found: dict[str, Estimate] = {}
    g = setup.site.gravity
    for k, (axis, i) in enumerate(zip(sensor.axes, sensor.axis_indices, strict=True)):
        up, down = (poses.subset(side * poses.up[:, i] > STRAIGHT) for side in (1.0, -1.0))
        high, low = up.means[:, k].mean(), down.means[:, k].mean()
        sigma = float(np.hypot(_sigma_of_mean(up, k), _sigma_of_mean(down, k))) / 2
        found[f"{sensor.name}.bias_{axis}"] = Estimate((high + low) / 2, sigma, "m_s2")
        found[f"{sensor.name}.scale_{axis}"] = Estimate((high - low) / (2 * g) - 1, sigma / g, "1")
    covariance = np.diag([estimate.sigma**2 for estimate in found.values()])
    return Calibration("opposite_faces", "good", found, covariance, poses=poses.spans)


def _sigma_of_mean(poses: Poses, k: int) -> float:
    """Standard uncertainty of a channel's mean over poses, SI."""
    variances = [poses.covariance(j)[k, k] for j in range(len(poses))]
    return float(np.sqrt(np.sum(variances))) / len(poses)
