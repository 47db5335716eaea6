"""Sign conventions, all of them: rotations, mountings, tilt, gravity, Earth's rate.

World: x East, y North, z Up, gravity (0, 0, -g). An accelerometer senses the specific force f = a -
gravity, so level at rest it reads (0, 0, +g). ``R_ab`` takes components in b to components in a.
"""

import re
from collections.abc import Sequence
from math import asin, cos, radians, sin, sqrt

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import DEG, EARTH_RATE

AXES = ("x", "y", "z")


def rotation(axis: str, angle: float) -> Array:
    """Right-handed rotation by ``angle`` (rad) about a coordinate axis, (3, 3)."""
    i = AXES.index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    c, s = cos(angle), sin(angle)
    R = np.eye(3)
    R[j, j], R[j, k], R[k, j], R[k, k] = c, -s, s, c
    return R


def skew(v: Array) -> Array:
    """Matrix of the cross product: ``skew(v) @ u == cross(v, u)``."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


_FACTOR = r"R([xyz])\(\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*\)"
_MOUNT = re.compile(rf"{_FACTOR}(?:\s*[*@]\s*(?=R)|\s+(?=R)|$)")


def parse_mount(text: str) -> Array:
    """``identity`` or a product such as ``Rx(90) Rz(180)`` (degrees) -> R_mount, (3, 3).

    Raises:
        TiltcalError: the text is neither.
    """
    R = np.eye(3)
    standstill = text.strip()
    if standstill in ("", "identity"):
        return R
    while standstill:
        match = _MOUNT.match(standstill)
        if match is None:
            raise TiltcalError(
                f"mount '{text}'",
                found=f"'{standstill}'",
                need="identity or factors such as Rz(180)",
                do="correct it",
            )
        R = R @ _exact_quarter_turn(match.group(1), float(match.group(2)))
        standstill = standstill[match.end() :]
    return R


def _exact_quarter_turn(axis: str, degrees: float) -> Array:
    R = rotation(axis, radians(degrees))
    return np.round(R) if degrees % 90 == 0 else R


def parse_mounts(text: str) -> list[tuple[float, Array]]:
    """A recording's mount metadata, ``identity; 350.5 s: Rz(180)`` -> [(from time, R_mount)], the
    first from -inf.

    Raises:
        TiltcalError: a part is no mounting or has no time.
    """
    found: list[tuple[float, Array]] = []
    for k, part in enumerate(text.split(";")):
        when, colon, mount = part.partition(":")
        if not colon:
            when, mount = "-inf s", part
        try:
            start = float(when.strip().removesuffix("s"))
        except ValueError:
            start = float("nan")
        if start != start or bool(colon) != (k > 0) or (found and start <= found[-1][0]):
            raise TiltcalError(
                f"mount '{text}'",
                found=f"'{part.strip()}'",
                need="a mounting, or '<time> s: <mounting>' after the first",
                do="correct the metadata line",
            )
        found.append((start, parse_mount(mount)))
    return found


def parse_up(label: str) -> Array | None:
    """The operator's label as the up direction in body axes: ``+x`` -> (1, 0, 0), ``[0, 1, 1]`` ->
    unit vector.

    Returns None for free text, which is not a direction.
    """
    text = label.strip()
    if re.fullmatch(r"[-+][xyz]", text):
        up = np.zeros(3)
        up[AXES.index(text[1])] = 1.0 if text[0] == "+" else -1.0
        return up
    if text.startswith("[") and text.endswith("]"):
        try:
            up = np.array([float(part) for part in text[1:-1].replace(",", " ").split()])
        except ValueError:
            return None
        if up.shape == (3,) and np.all(np.isfinite(up)) and np.linalg.norm(up) > 0:
            return np.asarray(up / np.linalg.norm(up))
    return None


def parse_turn(label: str) -> tuple[Array, float, float | None] | None:
    """The operator's label as a turn about a body axis: ``turn z 360``, ``turn -x 90 +- 0.02 deg``.

    Returns None for free text, which is no turn; else the axis as a unit vector, (3,), the angle
    about it, rad, and its standard uncertainty, rad, None where it is not stated.
    """
    number = r"(\d+\.?\d*)"
    pattern = rf"turn ([-+]?)([xyz]) ([-+]?){number}(?: ?\+-? ?{number})?(?: ?deg)?"
    found = re.fullmatch(pattern, " ".join(label.lower().replace("±", "+-").split()))
    if found is None:
        return None
    way = -1.0 if (found[1] == "-") != (found[3] == "-") else 1.0
    sigma = None if found[5] is None else float(found[5]) * DEG
    return np.eye(3)[AXES.index(found[2])], way * float(found[4]) * DEG, sigma


def tilt_of_force(force: Array, g: float) -> Array:
    """Elevation of body axes above the horizontal plane, ``asin(f / g)``, rad. Beyond +-g it stays
    at +-90 deg.

    Args:
        force: specific force, m/s2, (n,).
        g: gravity, m/s2.
    """
    return np.asarray(np.arcsin(np.clip(force / g, -1.0, 1.0)))


# of gravity: the typical bias of an accelerometer in the catalogue of effects. It may change the
# derivative of the arcsine at s, 1/cos, by the part |s| 0.025 / cos^2; Newton's steps towards an
# adjustment need less than a half
STEEP = 0.025


def is_steep(tilt: Array) -> Mask:
    """Whether elevations are so near +-90 deg, where the arcsine has a pole, that the bias of an
    ordinary accelerometer turns its derivative into another, (n,): from 77 deg on.

    Args:
        tilt: elevation, rad, (n,).
    """
    return np.asarray(np.cos(tilt) ** 2 < 2 * STEEP * np.abs(np.sin(tilt)))


def force_of_tilt(tilt: Array, g: float) -> Array:
    """Specific force along an axis of elevation ``tilt`` (rad), m/s2: ``g sin(tilt)``.

    Args:
        tilt: elevation, rad, (n,).
        g: gravity, m/s2.
    """
    return np.asarray(g * np.sin(tilt))


def base_rotation(roll: float, pitch: float) -> Array:
    """R_base = Rx(roll) Ry(pitch): roll about East, pitch about North. Both in rad; (3, 3)."""
    return rotation("x", roll) @ rotation("y", pitch)


def base_tilt(horizontal: Array, g: float) -> tuple[float, float]:
    """Roll and pitch (rad) of a rotation axis from the horizontal force (h_x, h_y) seen in the
    base's frame.

    ``roll = asin(h_y / g)``, ``pitch = -asin(h_x / (g cos roll))`` (docs/interfaces.md, "Frames and
    signs").

    Raises:
        TiltcalError: the force is larger than gravity allows.
    """
    h_x, h_y = float(horizontal[0]), float(horizontal[1])
    if h_x * h_x + h_y * h_y > g * g:
        raise TiltcalError(
            "base tilt",
            found=f"a horizontal force of {sqrt(h_x**2 + h_y**2):.4g} m/s2",
            need=f"less than g = {g} m/s2",
            do=(
                "check the unit and sign of the channels, and that the two positions are a half"
                " turn apart"
            ),
        )
    roll = asin(h_y / g)
    return roll, -asin(h_x / (g * cos(roll)))


def earth_rate(latitude: float, heading: float = 0.0) -> Array:
    """Earth's rotation in the world frame, rad/s, (3,). ``heading``: azimuth of the table's North
    mark, clockwise.
    """
    north, up = EARTH_RATE * cos(latitude), EARTH_RATE * sin(latitude)
    return np.array([-north * sin(heading), north * cos(heading), up])


def normal_gravity(latitude: float, height: float = 0.0) -> float:
    """Gravity on the WGS 84 ellipsoid with the free-air gradient, m/s2 (Somigliana; good to some
    5e-4 m/s2).
    """
    s2 = sin(latitude) ** 2
    return (
        9.7803253359 * (1 + 0.00193185265241 * s2) / sqrt(1 - 0.00669437999013 * s2)
        - 3.086e-6 * height
    )


def input_axis(elevation: float, azimuth: float) -> Array:
    """Unit vector of a FOG's input axis: azimuth from body x towards y, elevation towards z (rad).
    (3,).
    """
    return np.array([cos(elevation) * cos(azimuth), cos(elevation) * sin(azimuth), sin(elevation)])


def best_rotation(a: Array, b: Array) -> Array:
    """The rotation R that minimises sum |a_k - R b_k|^2, (3, 3). a, b: (n, 3). Kabsch (1976)."""
    u, _, vt = np.linalg.svd(a.T @ b)
    return np.asarray(u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt)


def angle_between(a: Array, b: Array) -> Array:
    """Angle between unit-free vectors, rad, accurate for small angles. a, b: (n, 3) -> (n,)."""
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1)))


def sphere(n: int) -> Array:
    """``n`` nearly equally spread unit vectors (Fibonacci spiral), (n, 3)."""
    k = np.arange(n) + 0.5
    z = 1 - 2 * k / n
    phi = np.pi * (1 + sqrt(5)) * k
    r = np.sqrt(1 - z * z)
    return np.column_stack([r * np.cos(phi), r * np.sin(phi), z])


def unit(v: Sequence[float] | Array) -> Array:
    """``v`` divided by its length. v: (3,)."""
    w = np.asarray(v, dtype=float)
    w = np.ldexp(w, -np.frexp(np.abs(w).max())[1])  # exact, and its square is a number
    return np.asarray(w / np.linalg.norm(w))


def tangents(up: Array) -> Array:
    """Two orthogonal unit vectors across each direction, (m, 3) -> (m, 2, 3)."""
    helper = np.where(np.abs(up[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(up, helper)
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack([first, np.cross(up, first)], axis=1)
