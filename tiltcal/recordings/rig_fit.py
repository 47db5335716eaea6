"""Which table, with which senses of its axes and which mounting, turns gravity as it was read."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import parse_mount
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.static_poses import Poses, find_poses
from tiltcal.recordings.table_columns import tables_of
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Rig, Setup
from tiltcal.setup.tables import Table, tables

FITS = 0.1  # rms of the direction of gravity, rad: biases and mounting of ordinary instruments
CLEARLY_WORSE = 3.0  # times worse than another is clearly worse
POSES = 3  # distinct ones that it takes
_FIRST = ("", "Rx(90)", "Rx(180)", "Rx(270)", "Ry(90)", "Ry(270)")
_THEN = ("", "Rz(90)", "Rz(180)", "Rz(270)")
QUARTER_TURNS = tuple(f"{a} {b}".strip() or "identity" for a, b in product(_FIRST, _THEN))
"""The 24 mountings by quarter turns."""


@dataclass(frozen=True)
class RigFit:
    """A table with its mounting, and how far gravity is from it.

    Args:
        table: the kind.
        senses: +1 or -1 for each axis: -1 counts the other way.
        mount: as ``rig.mount`` states it.
        misfit: rms of the direction of gravity, rad.
    """

    table: Table
    senses: tuple[int, ...]
    mount: str
    misfit: float

    def changes(self, table: str, mount: Array) -> tuple[str, ...]:
        """Changes of a scenario with another table or mounting, as text.

        Args:
            table: that the scenario states.
            mount: R_mount that it states, (3, 3).
        """
        turned = zip(self.table.axis_names, self.senses, strict=True)
        steps = [f'set table = "{self.table.name}"'] if self.table.name != table else []
        steps += [f"change the sign of the {name} angle" for name, sense in turned if sense < 0]
        if not np.allclose(parse_mount(self.mount), mount):
            steps.append(f'set mount = "{self.mount}"')
        return tuple(steps)


def up_in_head(table: Table, angles: Array) -> Array:
    """The direction of up in the head of a table, (m, 3).

    Args:
        table: its kind.
        angles: of its axes, outermost first, rad, (m, k).
    """
    from scipy.spatial.transform import Rotation

    turned = Rotation.identity(len(angles))
    for k, direction in enumerate(table.directions):
        turned = turned * Rotation.from_euler(direction, angles[:, [k]])
    return np.asarray(turned.inv().apply([0.0, 0.0, 1.0]))


def rig_fits(up: Array, angles: Mapping[str, Array]) -> list[RigFit]:
    """Every table with these axes, in both senses of each and in 24 mountings, the simplest of
    those that fit alike first.

    Args:
        up: read direction of up in the body frame, (m, 3).
        angles: readout of each table axis, rad, (m,) each.
    """
    found = [fit for table in _with_axes(angles) for fit in _of_table(table, up, angles)]
    return sorted(found, key=lambda fit: fit.misfit)


def _with_axes(names: Mapping[str, Array]) -> list[Table]:
    return [t for t in tables().values() if t.axes and set(t.axis_names) == set(names)]


def _of_table(table: Table, up: Array, angles: Mapping[str, Array]) -> Iterator[RigFit]:
    read = np.column_stack([angles[name] for name in table.axis_names])
    for senses in product((1, -1), repeat=len(table.axes)):
        head = up_in_head(table, read * np.array(senses))
        for mount in QUARTER_TURNS:
            left = up - head @ parse_mount(mount)
            misfit = float(np.sqrt(np.mean(np.sum(left**2, axis=1))))
            yield RigFit(table, senses, mount, misfit)


def read_poses(recording: Recording, setup: Setup) -> tuple[Array, dict[str, Array]] | None:
    """Directions of up that an accelerometer triad read, (m, 3), and the table angles there, rad,
    whatever table the set-up states. None where the recording does not have both.
    """
    triad = next((s for s in setup.sensor if _is_triad(s)), None)
    possible = tables_of(recording)
    if triad is None or not possible:
        return None
    rig = Rig.model_validate(setup.rig.model_dump() | {"table": possible[0].name})
    try:
        poses = find_poses(recording, setup.model_copy(update={"rig": rig}), triad)
    except TiltcalError:
        return None
    return _directions(poses)


def _is_triad(sensor: Sensor) -> bool:
    return sensor.kind == "accelerometer" and len(sensor.axes) == 3


def _directions(poses: Poses) -> tuple[Array, dict[str, Array]] | None:
    if not poses.angles:
        return None
    length = np.linalg.norm(poses.means, axis=1)
    read = np.column_stack(list(poses.angles.values()))
    known = np.isfinite(read).all(axis=1) & (length > 0)
    if len(np.unique(np.round(read[known], 2), axis=0)) < POSES:
        return None
    up = poses.means[known] / length[known][:, None]
    return up, {name: angles[known] for name, angles in poses.angles.items()}


def suspected_rig(recording: Recording, setup: Setup) -> str | None:
    """What is wrong with the table of a set-up, where another one fits what was read and the
    stated one does not: one sentence, or None.
    """
    poses = read_poses(recording, setup) if setup.rig.axes else None
    if poses is None:
        return None
    (up, angles), rig = poses, setup.rig
    stated = _misfit(up, angles, rig)
    fits = [
        f for f in rig_fits(up, angles) if f.misfit < FITS and f.misfit < stated / CLEARLY_WORSE
    ]
    ways = simplest(fits, rig)
    if stated < FITS or not ways:
        return None
    return (
        f"gravity does not follow the table angles on table {rig.table}, mount {rig.mount}; it"
        f" would if you {'; or '.join(ways)}"
    )


def _misfit(up: Array, angles: Mapping[str, Array], rig: Rig) -> float:
    """Rms of the direction of gravity on a stated rig, rad; an axis without readout counts as 0."""
    unread = np.zeros(len(up))
    read = np.column_stack([angles.get(name, unread) for name in rig.axis_names])
    left = up - up_in_head(rig.kind, read) @ rig.mount_rotation
    return float(np.sqrt(np.mean(np.sum(left**2, axis=1))))


def simplest(fits: Sequence[RigFit], rig: Rig) -> list[str]:
    """The fewest changes that make a stated rig fit, as text, one entry a rig."""
    ways = [fit.changes(rig.table, rig.mount_rotation) for fit in fits]
    least = min((len(way) for way in ways), default=0)
    return sorted({" and ".join(way) for way in ways if len(way) == least})
