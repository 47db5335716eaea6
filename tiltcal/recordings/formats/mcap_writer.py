"""Recordings as MCAP files of ROS 2 messages, for PlotJuggler, Foxglove and ROS.

The module contains the definitions of the messages in the form MCAP stores them, and their encoding
in CDR, little-endian, many messages of one layout at once.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tiltcal.core.arrays import Array, Index
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import replacing
from tiltcal.core.optional_library import library
from tiltcal.core.units import COLUMN_UNITS, split_unit
from tiltcal.recordings.recording import Recording
from tiltcal.setup.tables import angle_channel, axis_names

_LINE = "=" * 80
_HEADER = """
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"""
_TIME = """
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_QUATERNION = """
MSG: geometry_msgs/Quaternion
float64 x 0
float64 y 0
float64 z 0
float64 w 1
"""
_VECTOR = """
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"""


def _joined(*parts: str) -> str:
    return f"\n{_LINE}".join(part.rstrip("\n") for part in parts) + "\n"


IMU = _joined(
    """std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
""",
    _HEADER,
    _TIME,
    _QUATERNION,
    _VECTOR,
)
TEMPERATURE = _joined(
    """std_msgs/Header header
float64 temperature
float64 variance
""",
    _HEADER,
    _TIME,
)
JOINT_STATE = _joined(
    """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
""",
    _HEADER,
    _TIME,
)


_CDR = bytes([0, 1, 0, 0])
_SECOND_NS = 10**9  # ns
_IMU = 37
"""Numbers of an Imu message: orientation and 9 of its covariance, then twice 3 and 9."""
_RATE, _RATE_COVARIANCE, _FORCE, _FORCE_COVARIANCE = 13, 16, 25, 28
Stamps = npt.NDArray[np.int64]


def imu_messages(stamps: Stamps, force: Array | None, rate: Array | None) -> Iterator[bytes]:
    """``sensor_msgs/Imu``; what was not measured has -1 as the first number of its covariance.

    Args:
        stamps: ns, (n,).
        force: m/s2, (n, 3).
        rate: rad/s, (n, 3).
    """
    numbers = np.zeros((len(stamps), _IMU))
    numbers[:, 3] = 1.0
    numbers[:, 4] = -1.0
    for values, offset, covariance in (
        (rate, _RATE, _RATE_COVARIANCE),
        (force, _FORCE, _FORCE_COVARIANCE),
    ):
        if values is None:
            numbers[:, covariance] = -1.0
        else:
            numbers[:, offset : offset + 3] = values
    return _messages(stamps, b"", numbers)


def temperature_messages(stamps: Stamps, degC: Array) -> Iterator[bytes]:
    """``sensor_msgs/Temperature``.

    Args:
        stamps: ns, (n,).
        degC: (n,).
    """
    return _messages(stamps, b"", np.column_stack([degC, np.zeros(len(degC))]))


def joint_messages(stamps: Stamps, names: list[str], angles: Array) -> Iterator[bytes]:
    """``sensor_msgs/JointState`` with positions only.

    Args:
        stamps: ns, (n,).
        names: of the k axes.
        angles: rad, (n, k).
    """
    middle = _count(len(names))
    for name in names:
        middle = _padded(middle, 4) + _string(name)
    middle = _padded(middle, 4) + _count(len(names))
    empty = bytes(8)  # no velocities, no efforts
    return _messages(stamps, middle, angles, empty)


def _messages(stamps: Stamps, middle: bytes, numbers: Array, tail: bytes = b"") -> Iterator[bytes]:
    """Header, bytes that are the same in all messages, numbers (n, k), and the end."""
    head = np.empty((len(stamps), 2), dtype="<u4")
    head[:, 0], head[:, 1] = stamps // _SECOND_NS, stamps % _SECOND_NS
    frame = _padded(_string("imu"), 4)
    between = _padded(bytes(8) + frame + middle, 8)[8:]
    body = np.ascontiguousarray(numbers, dtype="<f8")
    for k in range(len(stamps)):
        yield _CDR + head[k].tobytes() + between + body[k].tobytes() + tail


def _count(n: int) -> bytes:
    return int(n).to_bytes(4, "little")


def _string(text: str) -> bytes:
    raw = text.encode() + b"\0"
    return _count(len(raw)) + raw


def _padded(data: bytes, size: int) -> bytes:
    return data + bytes(-len(data) % size)


_LATEST = 2.0**31  # s that a stamp of ROS can hold
_SCHEMAS = {
    "sensor_msgs/msg/Imu": IMU,
    "sensor_msgs/msg/Temperature": TEMPERATURE,
    "sensor_msgs/msg/JointState": JOINT_STATE,
}


@dataclass(frozen=True)
class Triad:
    """Three columns of a sensor.

    Args:
        name: of the sensor.
        quantity: acceleration or rate.
        rows: of the recording, (m,).
        values: SI, (m, 3).
    """

    name: str
    quantity: str
    rows: Index
    values: Array


@dataclass(frozen=True)
class _Stream:
    topic: str
    kind: str
    stamps: Stamps
    messages: Iterator[bytes]


def write_mcap(recording: Recording, path: Path) -> None:
    """Write triads as ``sensor_msgs/Imu``, with the temperature and the table angles.

    An accelerometer and a gyro that were sampled together share the topic ``/imu``; other triads
    have ``/<sensor>``. Time stamps are ``time_s``, plus the metadata ``time zero``.

    Raises:
        TiltcalError: the library is missing, there is no triad in known units, or a stamp is not
            between 1970 and 2038.
    """
    writer = library("mcap.writer", "mcap", "MCAP files")
    streams = list(_streams(recording))
    if not any(s.kind.endswith("Imu") for s in streams):
        raise TiltcalError(
            recording.source,
            found="no accelerometer or gyro with the axes x, y, z in SI-like units",
            need="columns such as accel_x_m_s2 or gyro_x_deg_s",
            do="convert counts first: `tiltcal correct` writes SI",
        )
    with replacing(path) as temporary, temporary.open("wb") as file:
        out = writer.Writer(file)
        out.start(profile="ros2", library="tiltcal")
        for number, stream in enumerate(streams):
            data = _SCHEMAS[stream.kind].encode()
            schema = out.register_schema(stream.kind, "ros2msg", data)
            channel = out.register_channel(stream.topic, "cdr", schema)
            for k, message in enumerate(stream.messages):
                stamp = int(stream.stamps[k])
                out.add_message(channel, stamp, message, stamp, number)
        out.add_metadata("tiltcal", {k: str(v) for k, v in recording.metadata.items()})
        out.finish()


def _streams(recording: Recording) -> Iterator[_Stream]:
    stamps = _stamps(recording)
    found = triads(recording)
    forces = [t for t in found if t.quantity == "acceleration"]
    rates = [t for t in found if t.quantity == "rate"]
    if forces and rates and np.array_equal(forces[0].rows, rates[0].rows):
        force, rate = forces.pop(0), rates.pop(0)
        at = stamps[force.rows]
        messages = imu_messages(at, force.values, rate.values)
        yield _Stream("/imu", "sensor_msgs/msg/Imu", at, messages)
    for t in (*forces, *rates):
        at = stamps[t.rows]
        is_force = t.quantity == "acceleration"
        messages = imu_messages(at, t.values if is_force else None, None if is_force else t.values)
        yield _Stream(f"/{t.name}", "sensor_msgs/msg/Imu", at, messages)
    if (name := recording.channel("temperature")) is not None:
        values = recording.column(name)
        rows = np.flatnonzero(~np.isnan(values))
        messages = temperature_messages(stamps[rows], values[rows])
        yield _Stream("/temperature", "sensor_msgs/msg/Temperature", stamps[rows], messages)
    axes = [a for a in axis_names() if recording.channel(angle_channel(a)) is not None]
    if axes:
        angles = np.column_stack([np.asarray(recording.table(a)) for a in axes])
        rows = np.flatnonzero(~np.isnan(angles).any(axis=1))
        messages = joint_messages(stamps[rows], axes, angles[rows])
        yield _Stream("/table", "sensor_msgs/msg/JointState", stamps[rows], messages)


def triads(recording: Recording) -> list[Triad]:
    """The triads of accelerometers and gyros in units that convert to SI, in their order."""
    found: dict[str, dict[str, str]] = {}
    for column in recording.column_names:
        channel, unit = split_unit(column)
        name, _, axis = channel.rpartition("_")
        quantity = COLUMN_UNITS[unit].quantity if unit else ""
        if axis in ("x", "y", "z") and name and quantity in ("acceleration", "rate"):
            found.setdefault(name, {})[axis] = column
    kept = []
    for name, columns in found.items():
        if len(columns) < 3:
            continue
        units = [COLUMN_UNITS[str(split_unit(columns[a])[1])] for a in "xyz"]
        values = np.column_stack([recording.column(columns[a]) for a in "xyz"])
        rows = np.flatnonzero(~np.isnan(values).any(axis=1))
        factors = np.array([u.factor for u in units])
        kept.append(Triad(name, units[0].quantity, rows, values[rows] * factors))
    return kept


def _stamps(recording: Recording) -> Stamps:
    """Time stamps, ns, (n,)."""
    zero = float(recording.metadata.get("time zero", "0").partition(" ")[0])
    if not (recording.time.min() + zero >= 0 and recording.time.max() + zero < _LATEST):
        raise TiltcalError(
            recording.source,
            found=f"times from {recording.time.min() + zero:.9g} s",
            need="times after 1970 and before 2038, in s",
            do="shift time_s so that it begins at 0",
        )
    return np.round(recording.time * _SECOND_NS).astype(np.int64) + int(zero * _SECOND_NS)
