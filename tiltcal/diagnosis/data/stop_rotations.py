"""Random rotations of an axis at its stops, and of the instrument at each mounting: what each does
to the readings.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.diagnosis.data.observations import Columns, Observations
from tiltcal.effects.base import Effect
from tiltcal.effects.mount.mounting import MountMisalignment, RemountRepeatability
from tiltcal.effects.table.readout import EncoderZero, SettingScatter, zero_of
from tiltcal.recordings.replay import Replay


class StopRotation(NamedTuple):
    """A rotation of one axis at one stop.

    Args:
        recording: number of the recording.
        stop: number of the stop.
        columns: change of the readings per radian, interpolated between stops, SI, by channel.
    """

    recording: int
    stop: int
    columns: Columns


def stated_settings(observations: Observations, around: Sequence[Effect]) -> list[list[Columns]]:
    """See ``Observations.settings``."""
    axes = observations.scenario.rig.kind.turning
    stated = {axis: sigma for axis in axes if (sigma := stated_scatter(observations, axis))}
    seated = _scatter(e for e in observations.known if isinstance(e, RemountRepeatability))
    found: list[list[Columns]] = [[] for _ in observations.recordings if stated or seated]
    for number, rotation in mounting_rotations(observations, around) if seated else ():
        found[number].append({i: seated * column for i, column in rotation.items()})
    for axis, sigma in stated.items():
        for one in stop_rotations(observations, axis, around):
            part = {i: sigma * column for i, column in one.columns.items()}
            found[one.recording].append(part)
    return found


def stated_scatter(observations: Observations, axis: str) -> float:
    """Standard deviation, rad, about its setting with which the scenario states that an axis
    stops.
    """
    rig = observations.scenario.rig
    scatters = (e for e in observations.known if isinstance(e, SettingScatter))
    return _scatter(e for e in scatters if e.acts_on(axis, rig))


def _scatter(effects: Iterable[Effect]) -> float:
    """Standard deviation, rad, of rotations by independent effects."""
    return float(np.hypot.reduce([e.value("sigma") for e in effects]))


SMALL = 1e-4  # rad: the rotation by which its linear effect is probed


def stop_rotations(
    observations: Observations, axis: str, around: Sequence[Effect]
) -> Iterator[StopRotation]:
    """The rotation of an axis at each stop at which it shows. A stop in which the instrument was
    mounted anew is two: someone worked at the table.

    Args:
        observations: with the courses of a table.
        axis: that turns.
        around: effects that act as well.
    """
    zero = EncoderZero({zero_of(axis): -SMALL}, None, None, "found")
    whole = observations.changes(zero, around)
    for number, course in enumerate(observations.courses):
        resting = np.flatnonzero(course.stop >= 0)
        visits = np.column_stack([course.stop, _mountings(course)])[resting]
        for visit in np.unique(visits, axis=0):
            there = (visits == visit).all(axis=1).astype(float)
            weight = np.interp(np.arange(len(course.stop)), resting, there)
            part = _per_radian(observations, whole, number, weight)
            if any(np.any(c) for c in part.values()):
                yield StopRotation(number, int(visit[0]), part)


def mounting_rotations(
    observations: Observations, around: Sequence[Effect]
) -> Iterator[tuple[int, Columns]]:
    """The rotations of the instrument on its faceplate at each mounting, about x, y and z: number
    of the recording, and the change of the readings per radian, SI, by channel.

    Args:
        observations: with the courses of a table.
        around: effects that act as well.
    """
    for axis in "xyz":
        tilt = MountMisalignment({f"tilt_{axis}": SMALL}, None, None, "found")
        whole = observations.changes(tilt, around)
        for number, course in enumerate(observations.courses):
            mounting = _mountings(course)
            for one in np.unique(mounting):
                there = (mounting == one).astype(float)
                yield number, _per_radian(observations, whole, number, there)


def _per_radian(
    observations: Observations, whole: Columns, recording: int, weight: Array
) -> Columns:
    """The part of the change by a rotation of SMALL that a recording's rows have, per radian, SI.

    Args:
        observations: whose channels.
        whole: the change by that rotation of all rows, SI.
        recording: its number.
        weight: of the rotation in each row of it, (n,).
    """
    return {
        i: column * weight[observations.channels[i].rows] / SMALL
        for i, column in whole.items()
        if observations.channels[i].recording == recording
    }


def _mountings(course: Replay) -> Index:
    """Number of the mounting of each row, (n,)."""
    return np.searchsorted([start for start, _ in course.mounts], course.time, "right")
