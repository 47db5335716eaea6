"""The library of measuring schemes: which faces, edges and corners are turned up, and the table
angles that do it.
"""

from itertools import product

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import DEG
from tiltcal.setup.setup import Rig
from tiltcal.setup.tables import Axis, tables

TUMBLE_STEP = 30  # deg


def directions(scheme: str) -> Array:
    """Up in the body frame at each position of a scheme, (n, 3).

    ``6``: the faces. ``8``: the corners, where all products of two axes show and K2 hides in the
    bias. ``12``: the edges, where K2 and the products show. ``24``: the faces four times (on the
    table ``three`` in four headings). ``tumble``: the three coordinate planes every 30 deg, where
    K2, K3 and the products show (IEEE 1293 multi-point tumble).
    """
    faces = np.array([sign * e for e in np.eye(3) for sign in (1.0, -1.0)])
    if scheme == "8":
        return np.array(list(product((1.0, -1.0), repeat=3))) / np.sqrt(3)
    if scheme == "12":
        signs = list(product((1.0, -1.0), repeat=2))
        return np.array(
            [
                a * np.eye(3)[i] + b * np.eye(3)[j]
                for i, j in ((0, 1), (0, 2), (1, 2))
                for a, b in signs
            ]
        ) / np.sqrt(2)
    if scheme == "24":
        return np.tile(faces, (4, 1))
    if scheme == "tumble":
        angles = np.arange(0, 360, TUMBLE_STEP) * DEG
        planes = [
            np.outer(np.cos(angles), np.eye(3)[i]) + np.outer(np.sin(angles), np.eye(3)[j])
            for i, j in ((2, 0), (2, 1), (0, 1))
        ]
        return np.vstack(planes)
    return faces


def label_of(up: Array) -> str:
    """The operator's label for an up direction: ``+x``, or ``[0.707, 0, 0.707]``.

    Args:
        up: in the body frame, (3,).
    """
    i = int(np.argmax(np.abs(up)))
    if abs(up[i]) > 1 - 1e-9:
        return ("+" if up[i] > 0 else "-") + "xyz"[i]
    return "[" + ", ".join(f"{round(float(v), 6) + 0.0:g}" for v in up) + "]"


def table_angles(rig: Rig, up: Array, number: int, subject: str) -> Array:
    """Angles of the table's axes, rad, outermost first, that turn ``up`` of the nominal body frame
    up.

    Args:
        rig: table and mounting.
        up: (3,).
        number: number of the pose.
        subject: subject of messages.

    Raises:
        TiltcalError: the table cannot reach every direction.
    """
    table = rig.kind
    if table.pointing is None:
        *able, last = (t.name for t in tables().values() if t.pointing or not t.axes)
        raise TiltcalError(
            subject,
            found=f"table {rig.table}",
            need=f"{', '.join(able)} or {last}",
            do="write the moves one by one",
        )
    (tilt, _), (turn, _) = table.pointing
    angles = dict.fromkeys(table.axis_names, 0.0)
    angles[tilt], angles[turn] = _pointed(table.pointing, rig.mount_rotation @ up)
    if table.axis_names[0] not in table.tilting:
        angles[table.axis_names[0]] = (number // 6) * 90 * DEG
    return np.array(list(angles.values()))


def _pointed(axes: tuple[Axis, Axis], up: Array) -> tuple[float, float]:
    """Angles a, b of axes about e and d, rad, with ``R_d(b)^T R_e(a)^T z = up``.

    R_e(a)^T z = z cos a + (z x e) sin a has a component along d, which b leaves as it is, and one
    across it, which b turns; a is chosen so that the latter is not negative.
    """
    z = np.eye(3)[2]
    (_, e), (_, d) = ((name, np.eye(3)["xyz".index(about)]) for name, about in axes)
    side = np.cross(z, e)
    along, across = d @ up, np.linalg.norm(np.cross(d, up))
    a, start = (
        (np.arctan2(across, along), side) if d @ z else (np.arctan2((side @ d) * along, across), z)
    )
    b = np.arctan2(np.cross(up, start) @ d, up @ start) if across > 1e-9 else 0.0
    return float(a), float(b)
