"""What the dwells so far bring: the calibration, its sigmas, and what is expected of more."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.calibration.result import Calibration
from tiltcal.calibration.screen.drift import slope_test
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import readable_unit
from tiltcal.guide.live_checks import Found, wrong_signs
from tiltcal.guide.planner import Planner
from tiltcal.guide.state import ParameterState
from tiltcal.guide.task import Task
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment
from tiltcal.recordings.static_poses import Poses, find_poses

INCOMPLETE = (
    "converged",
    "determined",
    "directions predict each other",
    "condition of the positions",
    "faces complete",
)
"""Tests that fail while poses are missing: nothing to mend as long as more are to come."""


@dataclass(frozen=True)
class Progress:
    """What the dwells so far bring.

    Args:
        planner: with the noise that was measured.
        information: of the dwells and the prior, (p, p).
        calibration: None while the dwells do not determine one.
        found: what to mend.
        up: up in the body frame at each dwell, (m, 3); NaN where it is not known.
    """

    planner: Planner
    information: Array
    calibration: Calibration | None = None
    found: tuple[Found, ...] = ()
    up: Array | None = None

    @classmethod
    def none(cls, planner: Planner) -> "Progress":
        """Before the first dwell."""
        return cls(planner, np.eye(len(planner.model.names)))

    def parameters(
        self, goals: Mapping[str, float], column_unit: str | None
    ) -> dict[str, ParameterState]:
        """Each parameter with its sigma and goal.

        Args:
            goals: in the units of CAL.json.
            column_unit: of the readings.
        """
        expected = self.planner.sigmas(self.information)
        fitted = {} if self.calibration is None else self.calibration.parameters
        found = {}
        for name, unit in zip(self.planner.model.names, self.planner.model.units, strict=True):
            factor, shown = readable_unit(unit, column_unit)
            estimate = fitted.get(name)
            found[name] = ParameterState(
                None if estimate is None else factor * estimate.value,
                factor * (expected[name] if estimate is None else estimate.sigma),
                factor * goals[name],
                shown,
                estimate is not None,
            )
        return found


def progress_of(
    task: Task, planner: Planner, recording: Recording, segments: Sequence[Segment]
) -> Progress:
    """What some dwells bring.

    Args:
        task: what is calibrated.
        planner: of its poses.
        recording: so far.
        segments: its dwells.
    """
    if not segments:
        return Progress.none(planner)
    try:
        poses = find_poses(recording, task.scenario, task.sensor, segments)
    except TiltcalError as error:
        return replace(Progress.none(planner), found=(("data", str(error)),))
    planner = planner.with_noise(_white(poses, len(planner.model.white)))
    up = poses.up
    if task.by_norm:
        up = poses.means / np.linalg.norm(poses.means, axis=1)[:, None]
    known = ~np.isnan(up).any(axis=1)
    length = np.array([s.end_s - s.start_s for s in poses.spans])
    information = planner.information(up[known], length[known])
    found = list(_signs(task, poses, recording))
    calibration = None
    determined = int(known.sum()) * len(planner.model.white) >= len(planner.model.names)
    if determined:
        try:
            calibration = task.calibrate(recording, segments)
        except TiltcalError as error:
            found.append(("calibration", str(error)))
    tests = [slope_test(poses)] if calibration is None else calibration.tests
    found += [(test.name, test.statement) for test in tests if not test.passed]
    return Progress(planner, information, calibration, tuple(found), up)


def _white(poses: Poses, channels: int) -> Array:
    """Noise of the channels per root hertz, correlated noise included, (k,); of the norm one."""
    length = np.array([s.end_s - s.start_s for s in poses.spans])
    step = float(np.median(length / poses.counts))
    variance = np.diag(poses.noise) * poses.inflation * step
    return np.sqrt(variance if channels == len(variance) else variance.mean(keepdims=True))


def _signs(task: Task, poses: Poses, recording: Recording) -> list[Found]:
    """Channels that read the opposite of what acts, each once."""
    names = [str(recording.channel(f"{task.sensor.name}_{a}")) for a in task.sensor.axes]
    found: dict[str, Found] = {}
    for mean, up in zip(poses.means, poses.up, strict=True):
        for kind, text in wrong_signs(task.sensor, mean, up, task.scenario.site.gravity, names):
            found.setdefault(text.partition(":")[0], (kind, text))
    return list(found.values())
