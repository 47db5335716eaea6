"""What the sensor reads now."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import force_of_tilt
from tiltcal.guide.stream import Stream
from tiltcal.setup.sensor import Sensor

FELT = 0.5  # of gravity: a triad that reads less says nothing of its attitude


@dataclass(frozen=True)
class Reading:
    """Means over some time.

    Args:
        columns: by column name, as the stream has them.
        force: in the sensing form, m/s2, (k,); None without samples.
        up: up in the body frame, (3,); None where the readings do not determine it.
    """

    columns: Mapping[str, float] = field(default_factory=dict)
    force: Array | None = None
    up: Array | None = None


def read_between(
    stream: Stream, sensor: Sensor, gravity: float, start: float, end: float
) -> Reading:
    """The means of a sensor between two instants of a stream, s.

    Args:
        stream: samples so far.
        sensor: accelerometer or inclinometer.
        gravity: m/s2.
        start, end: s.
    """
    rows = slice(stream.since(start), int(np.searchsorted(stream.time, end, side="right")))
    recording = stream.recording(rows)
    try:
        values = recording.sensor(sensor).values
    except TiltcalError:
        return Reading()
    values = values[~np.isnan(values).any(axis=1)]
    if not len(values):
        return Reading()
    force = values.mean(axis=0)
    if sensor.kind == "inclinometer":
        force = force_of_tilt(force, gravity)
    names = [str(recording.channel(f"{sensor.name}_{axis}")) for axis in sensor.axes]
    columns = {name: float(np.nanmean(recording.column(name))) for name in names}
    return Reading(columns, force, _up(sensor, force, gravity))


def _up(sensor: Sensor, force: Array, gravity: float) -> Array | None:
    """Up in the body frame, (3,). force: in the sensing form, m/s2, (k,)."""
    own = list(sensor.axis_indices)
    up = np.zeros(3)
    up[own] = force / gravity
    if len(own) == 2:  # upright: an inclinometer is not turned over
        (third,) = set(range(3)) - set(own)
        up[third] = np.sqrt(max(0.0, 1 - float(up @ up)))
    size = float(np.linalg.norm(up))
    return up / size if len(own) > 1 and size > FELT else None
