"""ROS messages as rows of numbers: their scalar fields by name, and their units."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from tiltcal.recordings.formats.raw_table import RawTable, typed

STAMP = "header.stamp"
RECEIVED = "received"
"""The time a message was written to the bag, ns."""
_TIMES = {"builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"}
_UNITS = {
    "sensor_msgs/msg/Imu": {
        "linear_acceleration": "m/s2",
        "angular_velocity": "rad/s",
    },
    "sensor_msgs/msg/Temperature": {"temperature": "degC"},
    "sensor_msgs/msg/JointState": {"position": "rad", "velocity": "rad/s"},
}
_MOST = 8  # a longer array is no set of channels


class Topic:
    """The messages of one topic, collected as columns."""

    def __init__(self, name: str, kind: str) -> None:
        self.name, self.kind = name, kind
        self.rows: list[dict[str, Any]] = []

    def add(self, message: Any, received: int) -> None:
        """Add a message that was received at a time, ns."""
        self.rows.append({RECEIVED: received} | dict(scalars(message)))

    def table(self) -> RawTable:
        """The columns that all messages have, with the units of the message type."""
        names = [n for n in self.rows[0] if all(n in row for row in self.rows)]
        columns = [(n, typed(np.array([row[n] for row in self.rows]))) for n in names]
        known = _UNITS.get(self.kind, {})
        units = {n: known[n.split(".")[0]] for n in names if n.split(".")[0] in known}
        units |= {n: "ns" for n in names if n in (STAMP, RECEIVED)}
        kept = tuple((n, values) for n, values in columns if values is not None)
        return RawTable(self.name, kept, units, {"message type": self.kind})


def scalars(message: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """(name, value) of each number and text in a message, nested names joined by points."""
    if getattr(message, "__msgtype__", "") in _TIMES:
        yield name, int(message.sec) * 10**9 + int(message.nanosec)
    elif is_dataclass(message):
        for field in fields(message):
            inner = f"{name}.{field.name}" if name else field.name
            if not inner.endswith(("covariance", "__msgtype__")):
                yield from scalars(getattr(message, field.name), inner)
    elif isinstance(message, dict):
        for key, value in message.items():
            yield from scalars(value, f"{name}.{key}" if name else str(key))
    elif isinstance(message, bool | int | float | str | np.number):
        yield name, message
    elif isinstance(message, list | tuple | np.ndarray) and len(message) <= _MOST:
        for k, value in enumerate(message, start=1):
            if isinstance(value, int | float | np.number):
                yield f"{name}_{k}", value
