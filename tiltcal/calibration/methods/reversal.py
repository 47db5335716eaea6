"""What reversal methods share: the angles of the dwells, the mounting, and the model of a channel
on a tilted base.
"""

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import base_rotation, parse_mounts
from tiltcal.core.units import DEG
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.static_poses import Poses
from tiltcal.setup.setup import Setup
from tiltcal.setup.tables import VERTICAL, angle_channel

READOUT = angle_channel(VERTICAL.axis_names[0])
LEAST_SPREAD = 30 * DEG


def require_vertical(setup: Setup, method: str, do: str) -> None:
    """Refuse any other table.

    Raises:
        TiltcalError: the table has another axis than one about the vertical.
    """
    if setup.rig.directions != VERTICAL.directions:
        raise TiltcalError(
            f"method {method}",
            found=f"table {setup.rig.table}",
            need=f"table {VERTICAL.name}",
            do=do,
        )


def dwell_angles(poses: Poses, recording: Recording) -> Array:
    """Angle of the outermost axis at each dwell, rad, (m,).

    Raises:
        TiltcalError: it was not read, or the dwells are not at different angles.
    """
    angles = next(iter(poses.angles.values()), None)
    if angles is None or np.isnan(angles).any():
        raise TiltcalError(
            recording.source,
            found=f"dwells without a readout of {READOUT}",
            need="the angle of every position",
            do=f"record {READOUT}_deg, or name the dwells with --segments",
        )
    spread = np.abs(np.angle(np.exp(1j * (angles - angles[0])))).max()
    if len(poses) < 2 or spread < LEAST_SPREAD:
        raise TiltcalError(
            recording.source,
            found=f"{len(poses)} dwell(s), all at one angle of the table",
            need="two positions half a turn apart",
            do="turn the table by 180 deg and record again",
        )
    return angles


def off_half_turn(angles: Array) -> float:
    """How far the best pair of dwells is from half a turn, rad. angles: of the dwells, rad,
    (n,).
    """
    return float(np.abs(np.angle(-np.exp(1j * (angles[:, None] - angles[None, :])))).min())


def mount_of(recording: Recording, setup: Setup) -> Array:
    """R_mount of the recording, (3, 3)."""
    return parse_mounts(recording.metadata.get("mount", setup.rig.mount))[0][1]


def attitudes(roll: float, pitch: float, angles: Array, mount: Array) -> Array:
    """R_wb at each angle of the table, (m, 3, 3): ``R_base Rz(outer) R_mount``."""
    turned = np.zeros((len(angles), 3, 3))
    turned[:, 0, 0] = turned[:, 1, 1] = np.cos(angles)
    turned[:, 1, 0] = np.sin(angles)
    turned[:, 0, 1] = -turned[:, 1, 0]
    turned[:, 2, 2] = 1.0
    return np.asarray(base_rotation(roll, pitch) @ turned @ mount)
