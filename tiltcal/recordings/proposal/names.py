"""What the name of a column says: which quantity, along which axis."""

import re
from dataclasses import dataclass

from tiltcal.recordings.formats.unit_words import bare_name

_ROLES = (
    ("free", r"free_?acc|lin_?acc(?!el)|gravity_?free|user_?acc"),
    ("time", r"time(stamp)?|^t$|stamp|^sec(ond)?s?$|^utc|epoch|^date|^zeit|^received$|时间"),
    (
        "counter",
        r"count|packet|(^|_)n?_?samples?(_?(no|num|index))?$|(^|_)index|(^|_)seq|^n$",
    ),
    ("quaternion", r"quat|orientation|(^|_)q_?[0-3wxyz]$"),
    ("covariance", r"covariance"),
    ("magnetometer", r"mag|^m_?[xyz]$|磁"),
    (
        "gyro",
        r"gyr|ang\w*_?(vel|rate)|drehr|omega|^(g|gy|w)_?[xyz]$|^rate(_|$)|角速度|陀螺",
    ),
    ("accel", r"acc|beschl|^ac_?[xyz]$|specific_?force|^a_?[xyz]$|^f_?[xyz]$|加速度"),
    ("fog", r"(^|_)fog"),
    ("incl", r"incl|tilt_?meter|(^|_)level|倾角"),
    ("temperature", r"temp|温度"),
    ("status", r"status|state|flag|valid|error|mode|frame_id|clipp"),
    ("other", r"press|baro|humid|alt|volt|current|batt|gps|lat(itude)?$|lon(gitude)?$|device_id"),
    ("label", r"label|pose|position_?name|note|comment"),
    ("outer", r"outer"),
    ("middle", r"middle"),
    ("inner", r"inner"),
    ("angle", r"angle|azim|elev|encoder|table|turn|axis|tilt|yaw|roll|pitch|head|posit|角度|转台"),
)
_PATTERNS = tuple((role, re.compile(pattern)) for role, pattern in _ROLES)
_AXIS = re.compile(r"(?:^|_)([xyz])(?:_|$)|(?<=[a-z])([xyz])$|([xyzXYZ])轴?$")
_INDEX = re.compile(r"\[([0-2])\]$|_([1-3])$")


@dataclass(frozen=True)
class Meaning:
    """What a name says.

    Args:
        role: accel, gyro, temperature, time ...; empty where it says nothing.
        axis: x, y or z; empty where it says none.
        group: the name without the axis: columns of one sensor share it.
    """

    role: str
    axis: str
    group: str


def meaning_of(name: str, table: str = "") -> Meaning:
    """The meaning of a column's name; the name of its table helps where the column says nothing."""
    plain = _plain(bare_name(name))
    axis, group = _axis_of(plain, bare_name(name))
    role = _role_of(plain) or _role_of(group)
    if not role or (role in ("angle", "status", "other") and _role_of(_plain(table)) == "accel"):
        role = role or _role_of(_plain(table))
    return Meaning(role, axis, f"{table}:{group}")


def _plain(name: str) -> str:
    """Small letters, words joined by ``_``."""
    name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name)
    return re.sub(r"[^0-9a-z\u4e00-\u9fff]+", "_", name.lower()).strip("_")


def _role_of(plain: str) -> str:
    return next((role for role, pattern in _PATTERNS if pattern.search(plain)), "")


def _axis_of(plain: str, name: str) -> tuple[str, str]:
    """The axis, and the name without it."""
    for found in _AXIS.finditer(plain):
        axis = (found[1] or found[2] or found[3]).lower()
        return axis, plain[: found.start()] + "*" + plain[found.end() :]
    index = _INDEX.search(name)
    if index:
        k = int(index[1]) if index[1] is not None else int(index[2]) - 1
        return "xyz"[k], _plain(name[: index.start()]) + "*"
    return "", plain
