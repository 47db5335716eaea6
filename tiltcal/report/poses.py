"""The poses of recordings and designs, for pictures: where gravity points in the body frame."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import unit
from tiltcal.core.units import DEG
from tiltcal.forward.kinematics import closed_form
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.replay import replay
from tiltcal.recordings.static_poses import find_poses
from tiltcal.setup.schedule import build_schedule
from tiltcal.setup.sequence import Step
from tiltcal.setup.setup import Setup
from tiltcal.setup.trajectory import Drive, Jet


@dataclass(frozen=True)
class Pose:
    """One pose.

    Args:
        up: in the body frame, (3,); gravity points the other way.
        angles: of the table axes, deg; empty where hand-held.
        start_s: s from the first stamp of the recording.
        group: recording and mounting, or design, as text.
        mount: R_mount, (3, 3).
    """

    up: Array
    angles: Mapping[str, float]
    start_s: float
    group: str
    mount: Array

    @property
    def label(self) -> str:
        """Angles, time and direction, for a label."""
        up = ", ".join(f"{u:+.3f}" for u in self.up)
        return f"{self.angles_and_time}; up ({up})"

    @property
    def angles_and_time(self) -> str:
        """Angles and time, for a label."""
        angles = ", ".join(f"{name} {angle:.4g}°" for name, angle in self.angles.items())
        when = f"from {self.start_s:.4g} s"
        return f"{angles}; {when}" if angles else when


def poses_of(recordings: Sequence[Recording], setup: Setup) -> list[Pose]:
    """The poses of some recordings of one set-up: by the table's readout and the nominal table, of
    hand-held ones by the accelerometer. A recording that determines none gives none.
    """
    found: list[Pose] = []
    for recording in recordings:
        own = _by_readout if setup.rig.axes else _by_hand
        try:
            found += own(recording, setup)
        except TiltcalError:
            continue
    return found


def poses_at(
    setup: Setup, up: Array, angles: Array, axes: Sequence[str], starts: Array, group: str
) -> list[Pose]:
    """The poses of a design.

    Args:
        axes: names of the axes that tilt.
        setup: rig; its nominal mounting is used throughout.
        up: in the body frame, (n, 3).
        angles: of ``axes``, rad, (n, axes).
        starts: of the readings, s, (n,).
        group: what the poses belong to, as text.
    """
    named = [dict(zip(axes, row, strict=True)) for row in (angles / DEG).tolist()]
    return [
        Pose(u, where, float(start), group, setup.rig.mount_rotation)
        for u, where, start in zip(up, named, starts, strict=True)
    ]


def poses_of_steps(steps: Sequence[Step], setup: Setup, group: str) -> list[Pose]:
    """The dwells of a sequence of steps.

    Args:
        steps: steps of a sequence.
        setup: site, table and sensors.
        group: what the poses belong to, as text.
    """
    schedule = build_schedule(tuple(steps), setup.rig)
    legs = [leg for leg in schedule.legs if leg.stop >= 0]
    drive = schedule.drive(np.array([(leg.t0 + leg.t1) / 2 for leg in legs]))
    up = closed_form(setup, drive).up
    starts = [start for start, _ in drive.mounts[1:]]
    return [
        Pose(
            up[k],
            _turned(setup, {name: np.asarray(jet.x)[k] for name, jet in drive.axes.items()}),
            leg.t0,
            group,
            drive.mounts[int(np.searchsorted(starts, leg.t0, side="right"))][1],
        )
        for k, leg in enumerate(legs)
    ]


def _turned(setup: Setup, positions: Mapping[str, float]) -> dict[str, float]:
    """Angles of the axes that turn, deg. positions: of all axes, rad and m."""
    return {name: float(positions[name] / DEG) for name in setup.rig.kind.turning}


def drive_of(poses: Sequence[Pose], setup: Setup) -> Drive:
    """The table at standstill in some poses, one a second."""
    time = np.arange(len(poses), dtype=float)
    zero = np.zeros(len(poses))
    axes = {
        name: Jet(np.array([p.angles.get(name, 0.0) for p in poses]) * DEG, zero, zero)
        for name in setup.rig.axis_names
    }
    mounts = [
        (k, p.mount)
        for k, p in enumerate(poses)
        if k == 0 or not np.array_equal(p.mount, poses[k - 1].mount)
    ]
    level = np.full(len(poses), setup.site.temperature_degC)
    return Drive(time, axes, 0.0, level, float(level[0]), np.arange(len(poses)), tuple(mounts))


def _by_readout(recording: Recording, setup: Setup) -> Iterator[Pose]:
    course = replay(recording, setup)
    standstills = np.flatnonzero(np.bincount(course.stop[course.stop >= 0]))
    if not len(standstills):
        return
    order = np.flatnonzero(course.stop >= 0)
    first = order[np.searchsorted(course.stop[order], standstills)]
    last = order[np.searchsorted(course.stop[order], standstills, side="right") - 1]
    middle = (first + last) // 2
    zero = np.zeros(len(middle))
    axes = {name: Jet(angle[middle], zero, zero) for name, angle in course.angles.items()}
    up = closed_form(setup, course.standing(course.time[middle], axes)).up
    starts = [start for start, _ in course.mounts[1:]]
    text = str(recording.metadata.get("mount", setup.rig.mount)).split(";")
    for k, row in enumerate(middle):
        position = int(np.searchsorted(starts, course.time[row], side="right"))
        yield Pose(
            up[k],
            _turned(setup, {name: angle[row] for name, angle in course.angles.items()}),
            float(course.time[first[k]] - course.time[0]),
            f"{recording.source}, mount {text[position].rpartition(':')[2].strip()}",
            course.mounts[position][1],
        )


def _by_hand(recording: Recording, setup: Setup) -> Iterator[Pose]:
    sensor = next((s for s in setup.sensor if len(s.axes) == 3 and s.is_accelerometer), None)
    if sensor is None or not recording.has(sensor):
        return
    poses = find_poses(recording, setup, sensor)
    for mean, span in zip(poses.means, poses.spans, strict=True):
        start = span.start_s - float(recording.time[0])
        yield Pose(unit(mean), {}, start, recording.source, np.eye(3))
