"""Recordings as MCAP files of ROS 2 messages, for PlotJuggler, Foxglove and ROS."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import replacing
from tiltcal.core.optional_library import library
from tiltcal.core.units import COLUMN_UNITS, split_unit
from tiltcal.recordings.formats import ros_encoding, ros_schemas
from tiltcal.recordings.recording import Recording
from tiltcal.setup.tables import angle_channel, axis_names

_SECOND = 1e9  # ns
_LATEST = 2.0**31  # s that a stamp of ROS can hold
_SCHEMAS = {
    "sensor_msgs/msg/Imu": ros_schemas.IMU,
    "sensor_msgs/msg/Temperature": ros_schemas.TEMPERATURE,
    "sensor_msgs/msg/JointState": ros_schemas.JOINT_STATE,
}


@dataclass(frozen=True)
class Triad:
    """Three columns of a sensor.

    Args:
        name: of the sensor; quantity: acceleration or rate.
        rows: of the recording, (m,); values: SI, (m, 3).
    """

    name: str
    quantity: str
    rows: Index
    values: Array


@dataclass(frozen=True)
class _Stream:
    topic: str
    kind: str
    stamps: ros_encoding.Stamps
    messages: Iterator[bytes]


def write_mcap(recording: Recording, path: Path) -> None:
    """Write triads as ``sensor_msgs/Imu``, the temperature and the table angles beside them.

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
        messages = ros_encoding.imu_messages(at, force.values, rate.values)
        yield _Stream("/imu", "sensor_msgs/msg/Imu", at, messages)
    for t in (*forces, *rates):
        at = stamps[t.rows]
        is_force = t.quantity == "acceleration"
        messages = ros_encoding.imu_messages(
            at, t.values if is_force else None, None if is_force else t.values
        )
        yield _Stream(f"/{t.name}", "sensor_msgs/msg/Imu", at, messages)
    if (name := recording.channel("temperature")) is not None:
        values = recording.column(name)
        rows = np.flatnonzero(~np.isnan(values))
        messages = ros_encoding.temperature_messages(stamps[rows], values[rows])
        yield _Stream("/temperature", "sensor_msgs/msg/Temperature", stamps[rows], messages)
    axes = [a for a in axis_names() if recording.channel(angle_channel(a)) is not None]
    if axes:
        angles = np.column_stack([np.asarray(recording.table(a)) for a in axes])
        rows = np.flatnonzero(~np.isnan(angles).any(axis=1))
        messages = ros_encoding.joint_messages(stamps[rows], axes, angles[rows])
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


def _stamps(recording: Recording) -> ros_encoding.Stamps:
    """Time stamps, ns, (n,)."""
    zero = float(recording.metadata.get("time zero", "0").partition(" ")[0])
    if not (recording.time.min() + zero >= 0 and recording.time.max() + zero < _LATEST):
        raise TiltcalError(
            recording.source,
            found=f"times from {recording.time.min() + zero:.9g} s",
            need="times after 1970 and before 2038, in s",
            do="shift time_s so that it begins at 0",
        )
    return np.round(recording.time * _SECOND).astype(np.int64) + int(zero * _SECOND)
