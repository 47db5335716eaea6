"""Numbers as ROS 2 messages in CDR, little-endian: many messages of one layout at once."""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from tiltcal.core.arrays import Array

_CDR = bytes([0, 1, 0, 0])
_SECOND = 10**9  # ns
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
    for values, place, covariance in (
        (rate, _RATE, _RATE_COVARIANCE),
        (force, _FORCE, _FORCE_COVARIANCE),
    ):
        if values is None:
            numbers[:, covariance] = -1.0
        else:
            numbers[:, place : place + 3] = values
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
    head[:, 0], head[:, 1] = stamps // _SECOND, stamps % _SECOND
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
