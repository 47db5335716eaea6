"""ROS messages as rows of numbers: their scalar fields by name, and their units."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from operator import attrgetter
from typing import Any

import numpy as np

from tiltcal.recordings.formats.raw_table import Raw, RawTable, typed

STAMP = "header.stamp"
RECEIVED = "received"
"""The time a message was written to the bag, ns."""
_SECOND = 10**9  # ns
_UNITS = {
    "sensor_msgs/msg/Imu": {
        "linear_acceleration": "m/s2",
        "angular_velocity": "rad/s",
    },
    "sensor_msgs/msg/Temperature": {"temperature": "degC"},
    "sensor_msgs/msg/JointState": {"position": "rad", "velocity": "rad/s"},
}
Fields = Mapping[str, Sequence[Any]]
_MOST = 8  # a longer array is no set of channels


class Topic:
    """The messages of one topic, collected as columns."""

    def __init__(self, name: str, kind: str) -> None:
        self.name, self.kind = name, kind
        self.received: list[int] = []
        self.rows: list[Any] = []
        self._read: Callable[[Any], Any] | None = None
        self._paths: list[str] = []

    def add(self, message: Any, received: int) -> None:
        """Add a message that was received at a time, ns."""
        if self._read is None:
            self._read = self._reader(message)
        self.received.append(received)
        self.rows.append(self._read(message))

    def _reader(self, message: Any) -> Callable[[Any], Any]:
        """What takes the fields of a message in the order of ``_paths``."""
        if not is_dataclass(message):
            return lambda m: dict(scalars(m))
        self._paths = list(leaves(message))
        if len(self._paths) < 2:
            return lambda m: tuple(attrgetter(p)(m) for p in self._paths)
        return attrgetter(*self._paths)

    def table(self) -> RawTable:
        """The columns that all messages have, with the units of the message type."""
        columns: list[tuple[str, Raw]] = [(RECEIVED, np.array(self.received, dtype=np.int64))]
        if self._paths:
            by_path: Fields = dict(zip(self._paths, zip(*self.rows, strict=True), strict=True))
            columns += [c for path in self._paths for c in _columns(path, by_path)]
        else:
            names = [n for n in self.rows[0] if all(n in row for row in self.rows)]
            columns += [c for n in names for c in _array(n, [row[n] for row in self.rows])]
        known = _UNITS.get(self.kind, {})
        fields_of = {n: n.split(".")[0].rstrip("_12345678") for n, _ in columns}
        units = {n: known[field] for n, field in fields_of.items() if field in known}
        units |= {n: "ns" for n, _ in columns if n in (STAMP, RECEIVED)}
        return RawTable(self.name, tuple(columns), units, {"message type": self.kind})


def leaves(message: Any, path: str = "") -> Iterator[str]:
    """Attribute paths of the numbers, texts and arrays in a message; a time as its two parts."""
    for field in fields(message):
        value, inner = getattr(message, field.name), f"{path}.{field.name}".lstrip(".")
        if is_dataclass(value):
            yield from leaves(value, inner)
        elif not inner.endswith(("covariance", "__msgtype__")):
            yield inner


def _columns(path: str, by_path: Fields) -> list[tuple[str, Raw]]:
    """The columns of a field; seconds and nanoseconds of a time become one."""
    if path.endswith(".nanosec") and f"{path[:-8]}.sec" in by_path:
        return []
    values = by_path[path]
    if path.endswith(".sec") and f"{path[:-4]}.nanosec" in by_path:
        whole = np.array(values, dtype=np.int64) * _SECOND
        return [(path[:-4], whole + np.array(by_path[f"{path[:-4]}.nanosec"], dtype=np.int64))]
    names = by_path.get(path.rpartition(".")[0] + "name", ((),))
    same = isinstance(names[0], list) and all(n == names[0] for n in names)
    return _array(path, values, names[0] if same else ())


def _array(name: str, values: Sequence[Any], parts: Sequence[Any] = ()) -> list[tuple[str, Raw]]:
    """The columns of one field over all messages; nothing where it is no channel.

    Args:
        parts: names of the members of an array, where the message states them.
    """
    first = values[0]
    if isinstance(first, bool | int | float | str | np.number):
        column = typed(np.array(values))
        return [] if column is None else [(name, column)]
    if not isinstance(first, list | tuple | np.ndarray) or not 0 < len(first) <= _MOST:
        return []
    if any(len(v) != len(first) for v in values) or isinstance(first[0], str):
        return []
    table = np.array([np.asarray(v) for v in values])
    if table.ndim != 2 or table.dtype.kind not in "iufb":
        return []
    count = table.shape[1]
    named = len(parts) == count and all(isinstance(p, str) for p in parts)
    ends = [f".{p}" for p in parts] if named else [f"_{k + 1}" for k in range(count)]
    columns = [(f"{name}{end}", typed(table[:, k])) for k, end in enumerate(ends)]
    return [(n, v) for n, v in columns if v is not None]


def scalars(message: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """(name, value) of each number, text and list in a JSON message, names joined by points."""
    if isinstance(message, dict):
        for key, value in message.items():
            yield from scalars(value, f"{name}.{key}" if name else str(key))
    elif isinstance(message, bool | int | float | str | list):
        yield name, message
