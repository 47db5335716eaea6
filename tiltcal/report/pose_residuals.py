"""Residuals by pose and tilt errors before and after, for a certificate."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tiltcal.calibration.result import Calibration
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import angle_between, best_rotation
from tiltcal.core.units import ARCSEC, DEG, G0
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment
from tiltcal.recordings.static_poses import Poses, find_poses
from tiltcal.report.plots import Plot, Trace, axes, colour, points
from tiltcal.setup.setup import Setup
from tiltcal.validation.accuracy import estimated_up, predicted_tilt


@dataclass(frozen=True)
class PoseRow:
    """One pose.

    Args:
        start_s, end_s: of the dwell.
        label: label of the operator, or empty.
        angles: of the table axes, deg.
        residuals: corrected specific force less the true one, ug, by channel; of unknown attitude
            one ``norm``.
        before, after: tilt error of the uncorrected and of the corrected mean, arcsec; None where
            the attitude is not known.
        up: in the body frame, (3,); None where the attitude is not known.
        uncorrected: as the residuals, of the reading itself.
    """

    start_s: float
    end_s: float
    label: str
    angles: Mapping[str, float]
    residuals: Mapping[str, float]
    before: float | None
    after: float | None
    up: Array | None = None
    uncorrected: Mapping[str, float] = field(default_factory=dict)

    def inclination(self, axis: int) -> float:
        """Angle of a body axis above the horizontal, deg; 0 where the attitude is not known."""
        up = 0.0 if self.up is None else self.up[axis]
        return float(np.degrees(np.arcsin(np.clip(up, -1, 1))))


@dataclass(frozen=True)
class Tilt:
    """Tilt error over some directions, arcsec.

    Args:
        before, after: root mean square of the uncorrected and of the corrected reading.
        worst_before, worst_after: largest of them; None where it is predicted and not measured.
        over: the directions, and the basis of the figures, as text.
    """

    before: float
    after: float
    over: str
    worst_before: float | None = None
    worst_after: float | None = None


def pose_rows(
    calibration: Calibration,
    recording: Recording,
    setup: Setup,
    segments: Sequence[Segment] | None = None,
) -> list[PoseRow]:
    """Residuals of the poses of a recording; none where the result is not a sensor's force."""
    names = calibration.sensors()
    if not names or not is_force(calibration, setup):
        return []
    try:
        poses = find_poses(recording, setup, setup.named(names[0]), segments)
    except TiltcalError:
        return []
    return _rows(calibration, poses, setup)


def residual_plot(rows: Sequence[PoseRow]) -> Plot | None:
    """The residual of each dwell by channel, before and after calibration; None without any."""
    channels = list(rows[0].residuals) if rows else []
    if not channels:
        return None
    number = np.arange(1, len(rows) + 1)
    text = [f"{r.label} {r.start_s:.2f} to {r.end_s:.2f} s".strip() for r in rows]
    traces: list[Trace] = []
    for k, name in enumerate(channels):
        before = [r.uncorrected.get(name, np.nan) for r in rows]
        hollow: dict[str, Any] = {
            "visible": "legendonly",
            "marker": {"symbol": "circle-open", "size": 6, "color": colour(k)},
        }
        hover = "dwell %{x}: %{y:.4g} µg"
        traces.append(
            points(number, [r.residuals[name] for r in rows], name, k, text=text, hover=hover)
        )
        traces.append(points(number, before, f"{name} before", k, text=text, hover=hover, **hollow))
    return Plot(
        traces,
        f"Residual of each of the {len(rows)} dwells after calibration; before: choose it in the"
        " legend.",
        f"Residual of {len(rows)} dwells by channel after calibration",
        axes("dwell", "residual, µg", showlegend=True),
        height=280,
    )


def is_force(calibration: Calibration, setup: Setup) -> bool:
    """Whether the result corrects a specific force at any attitude: no base tilt, no placing-angle
    table, no gyro, no model over temperature.
    """
    names = calibration.sensors()
    special = any(n.startswith(("base.", "temperature.")) for n in calibration.parameters)
    accelerometer = bool(names) and setup.named(names[0]).is_accelerometer
    return accelerometer and not special and not calibration.bias_tables


def _rows(calibration: Calibration, poses: Poses, setup: Setup) -> list[PoseRow]:
    g, sensor = setup.site.gravity, poses.sensor
    known = np.asarray(~np.isnan(poses.up).any(axis=1))
    free = calibration.method == "norm"
    f = calibration.correct(sensor, poses.means, g)
    errors = np.full((2, len(poses)), np.nan)
    if known.sum() >= 3 or (known.any() and not free):
        up = poses.up[known]
        errors[:, known] = [_tilt_errors(x[known], up, g, free) for x in (poses.means, f)]
    both = np.array([f, poses.means])
    if known.all() and not free:
        both, channels = both - g * poses.up[:, list(sensor.axis_indices)], list(sensor.axes)
    elif f.shape[1] == 3:
        both, channels = np.linalg.norm(both, axis=2)[:, :, None] - g, ["norm"]
    else:
        both, channels = np.zeros((2, len(f), 0)), []
    micro, raw = both / (1e-6 * G0)
    return [
        PoseRow(
            span.start_s,
            span.end_s,
            span.label or "",
            {n: float(poses.angles[n][k] / DEG) for n in setup.rig.kind.turning if poses.angles},
            dict(zip(channels, map(float, micro[k]), strict=True)),
            _arcsec(errors[0, k]),
            _arcsec(errors[1, k]),
            None if free or not known[k] else poses.up[k],
            dict(zip(channels, map(float, raw[k]), strict=True)),
        )
        for k, span in enumerate(poses.spans)
    ]


def _arcsec(angle: float) -> float | None:
    """An angle in arcsec; None where it is NaN. angle: rad."""
    return None if np.isnan(angle) else float(angle / ARCSEC)


def _tilt_errors(f: Array, up: Array, g: float, free: bool) -> Array:
    """Angle between true and estimated up at each pose, rad, (m,).

    Two channels do not distinguish up from down: their third component takes the pose's own sign.
    """
    estimate = estimated_up(f, g)
    if f.shape[1] == 2:
        estimate[:, 2] *= np.where(up[:, 2] < 0, -1.0, 1.0)
    if free:
        estimate = estimate @ best_rotation(up, estimate).T
    return angle_between(estimate, up)


def measured_tilt(rows: Sequence[PoseRow]) -> Tilt | None:
    """Tilt error over the poses of the recording; None where no attitude is known."""
    pairs = [(r.before, r.after) for r in rows if r.before is not None and r.after is not None]
    if not pairs:
        return None
    before, after = np.array(pairs).T
    return Tilt(
        float(np.sqrt(np.mean(before**2))),
        float(np.sqrt(np.mean(after**2))),
        f"{len(pairs)} poses of the recording, which are also those of the fit",
        float(before.max()),
        float(after.max()),
    )


def expected_tilt(calibration: Calibration, setup: Setup) -> Tilt | None:
    """What the calibration changes over all directions, and what its covariance leaves; None where
    the result is not a sensor's force.
    """
    if not is_force(calibration, setup):
        return None
    sensor = setup.named(calibration.sensors()[0])
    if len(sensor.axes) == 1:
        return None
    before, after, over = predicted_tilt(setup, sensor, calibration)
    text = f"{over}; by the parameters and their covariance (noise, stated references)"
    return Tilt(before / ARCSEC, after / ARCSEC, text)
