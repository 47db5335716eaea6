"""Columns of a foreign file: what their names and their file say of quantity, axis and unit."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.data_quality.check import Finding, in_rows
from tiltcal.recordings.formats.cells import numbers_in
from tiltcal.recordings.formats.raw_table import Raw, RawFile
from tiltcal.recordings.formats.unit_words import bare_name, stated_unit, unit_of

_ROLES = (
    (
        "command",
        r"cmd|command|set_?point|desired|target|demand|motor|(^|_)esc(_|$|\d)|thr(ottle)?(_|$)|pwm"
        r"|servo|(^|_)rc_?(in|out)|torque|effort|actuator",
    ),
    (
        "estimate",
        r"filt|smooth|kalman|(^|_)ekf|estim|fused|fusion|(^|_)est(_|$)|predict|(^|_)bias|(^|_)std"
        r"|sigma|variance|residual|innov|(^|_)mean(_|$)|(^|_)avg",
    ),
    ("free", r"free_?acc|lin_?acc(?!el)|gravity_?free|user_?acc"),
    (
        "time",
        r"time(stamp)?|^t$|stamp|^sec(ond)?s?$|^utc|epoch?(_|$)|elapsed|^date|^zeit|^received$|时间",
    ),
    (
        "counter",
        r"count|packet|instance|(^|_)i(_?d)?$|(^|_)n?_?samples?(_?(no|num|index))?$|(^|_)index|(^|_)seq|^n$",
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
    (
        "status",
        r"status|state|flag|valid|error|mode|frame_id|clipp|event|trigger|sync|marker|button|armed"
        r"|alarm|quality|crc|checksum|parity",
    ),
    (
        "other",
        r"press|baro|humid|alt|volt|current|batt|gps|lat(itude)?$|lon(gitude)?$|device_id|speed"
        r"|veloc|(^|_)vel(_|$)|distance|range",
    ),
    ("label", r"label|pose|position_?name|note|comment"),
    ("outer", r"outer"),
    ("middle", r"middle"),
    ("inner", r"inner"),
    (
        "angle",
        r"angle|winkel|teilkopf|drehtisch|azim|elev|encoder|table|turn|axis|tilt|yaw|roll|pitch|head|posit|角度|转台",
    ),
)
_PATTERNS = tuple((role, re.compile(pattern)) for role, pattern in _ROLES)
_AXIS = re.compile(r"(?:^|_)([xyz])(?:_|$)|(?<=[a-z])([xyz])$|([xyzXYZ])轴?$")
_AXIS_WORD = re.compile(r"(^|_)([xyz])_axis(?=_|$)|(?<=_)axis_([xyz]$)|^axis_(?=[xyz]$)")
"""The word at an axis that would make it an angle of a table: ``x-axis``, ``Axis Y``."""
_INDEX = re.compile(r"\[([0-2])\]$|_([1-3])$")


@dataclass(frozen=True)
class Meaning:
    """Meaning of a column name.

    Args:
        role: accel, gyro, temperature, time ...; empty where the name does not state it.
        axis: x, y or z; empty where the name states none.
        group: the name without the axis: columns of one sensor share it.
    """

    role: str
    axis: str
    group: str


def meaning_of(name: str, table: str = "") -> Meaning:
    """The meaning of a column's name; the name of its table helps where the column states
    nothing.
    """
    plain = _AXIS_WORD.sub(r"\1\2\3", _plain(bare_name(name)))
    axis, group = _axis_of(plain, bare_name(name))
    role = _role_of(plain) or _role_of(group)
    of_table = _role_of(_plain(table))
    if not role and (axis or of_table not in _WITH_AXES):
        role = of_table
    return Meaning(role, axis, f"{table}:{group}")


_WITH_AXES = ("accel", "gyro", "magnetometer", "free")
"""Roles that a table gives only to columns with an axis: not to its counters and times."""


def _plain(name: str) -> str:
    """Small letters, parts joined by ``_``."""
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


_BY_UNIT = dict.fromkeys(("m_s2", "g", "mg", "ug", "gal"), "accel") | dict.fromkeys(
    ("rad_s", "deg_s", "deg_h"), "gyro"
)
"""Role of a column whose name states an axis and a unit only."""
ANGLES = ("deg", "rad", "arcsec")
REMARKS = {
    "command": "a command, no reading",
    "estimate": "an estimate or the output of a filter, no reading",
    "quaternion": "a quaternion",
    "free": "an acceleration without gravity",
}
"""Why columns of some roles are left out."""
_MOSTLY = 0.9  # share of numbers among the filled cells of a channel


@dataclass(frozen=True)
class Channel:
    """A column.

    Args:
        table: it stands in.
        source: as ``from`` names it: its name, or its number from 1.
        name: for messages.
        raw: values as read, (n,).
        meaning: of its name.
        unit: stated by the file; empty where it states none.
    """

    table: str
    source: int | str
    name: str
    raw: Raw
    meaning: Meaning
    unit: str

    @property
    def numeric(self) -> bool:
        """Whether its values are numbers."""
        return self.raw.dtype.kind in "if"

    @property
    def values(self) -> Array:
        """As floats, (n,)."""
        return np.asarray(self.raw, dtype=float)

    @property
    def whole(self) -> bool:
        """Whether all its values are whole numbers, and not all the same."""
        known = self.values[np.isfinite(self.values)]
        return bool(len(known)) and bool(np.all(known == np.round(known)))


def channels_of(
    file: RawFile, decimal: str = "point", known: Mapping[int, str] = MappingProxyType({})
) -> tuple[list[Channel], list[Finding]]:
    """All columns of all tables, in their order, and the cells of channels that are no numbers.

    Args:
        file: what was read of it.
        decimal: mark of numbers in text.
        known: index of a column that goes by number -> name that it has nevertheless.
    """
    found: list[Channel] = []
    faults: list[Finding] = []
    for table in file.tables:
        names = table.names
        numbered = names == [str(k + 1) for k in range(len(names))]
        for k, (name, raw) in enumerate(table.columns):
            by_number = numbered or names.count(name) > 1 or not name
            title = known.get(k, name)
            stated = unit_of(table.units[name]) if name in table.units else stated_unit(title)
            bare = numbered and k not in known
            meaning = Meaning("", "", "") if bare else meaning_of(title, table.name)
            if not meaning.role and meaning.axis:
                meaning = replace(meaning, role=_BY_UNIT.get(stated or "", ""))
            if not meaning.role and stated in ANGLES:
                meaning = replace(meaning, role="angle")
            shown = f"column {k + 1}" if by_number else name
            shown += f" ({title})" if k in known else ""
            raw, fault = _mended(raw, shown, decimal)
            faults += fault
            found.append(
                Channel(table.name, k + 1 if by_number else name, shown, raw, meaning, stated or "")
            )
    return found, faults


def _mended(raw: Raw, name: str, decimal: str) -> tuple[Raw, list[Finding]]:
    """A column of text with few cells that are no numbers, as numbers."""
    if raw.dtype != object:
        return raw, []
    values, bad = numbers_in(raw, decimal)
    if np.isfinite(values).sum() <= _MOSTLY * max(len(raw) - sum(t is None for t in raw), 1):
        return raw, []
    text = f"{name}: cells that are no numbers, {in_rows(bad)}"
    return values, [Finding("text", (name,), bad, text, repair="empty_text")] if len(bad) else []
