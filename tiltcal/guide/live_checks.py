"""What can be mended while the recording goes on: data checks of the last seconds, signs and
saturation of a dwell.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from tiltcal.core.arrays import Array
from tiltcal.core.units import COLUMN_UNITS, split_unit
from tiltcal.data_quality.check import Finding
from tiltcal.data_quality.registry import BY_NAME
from tiltcal.guide.stream import Stream
from tiltcal.recordings.quality import inspect_recording
from tiltcal.setup.sensor import Sensor

ENOUGH = 1.0  # s: the checks ask for some hundred readings
LIMIT = 0.98  # of the range: a mean nearer to its end has lost some of its noise
SHOWN = 0.5  # of gravity: a channel that feels less does not show its sign
FLIPPED = -0.5  # of what acts: half way between a right and a wrong sign, with 50 % to spare
Found = tuple[str, str]
"""Kind and statement of something to mend."""


def inspected(stream: Stream, sensor: Sensor, start: float, end: float) -> list[Finding]:
    """What the data checks find in the readings of a sensor and in the stamps between two
    instants, s; notes are left out. Rows of the findings count from the beginning of the stream.
    """
    rows = slice(stream.since(start), stream.since(end) + 1)
    if rows.stop - rows.start < 2 or stream.time[rows][-1] - stream.time[rows][0] < ENOUGH:
        return []
    found = inspect_recording(stream.recording(rows), [sensor]).findings
    return [replace(f, rows=f.rows + rows.start) for f in found if BY_NAME[f.kind].answer != "note"]


def clipped(found: Sequence[Finding], first: int, last: int) -> Iterator[Found]:
    """Those findings after which nothing can be calibrated, where they lie in some rows.

    Args:
        found: in a stream.
        first, last: rows, last exclusive.
    """
    for f in found:
        inside = (f.rows >= first) & (f.rows < last)
        if BY_NAME[f.kind].answer == "refused" and inside.any():
            yield "saturation", f.statement


def saturation(sensor: Sensor, means: Mapping[str, float]) -> Iterator[Found]:
    """Channels of a dwell at the end of their stated range. means: by column name."""
    for name, mean in means.items():
        limit = range_of(sensor, name)
        if limit is not None and abs(mean) > LIMIT * limit:
            yield "saturation", f"{name}: {mean:.5g} in a dwell, the end of the range ({limit:.5g})"


def range_of(sensor: Sensor, column: str) -> float | None:
    """The stated full scale in the unit of a column; None where it is not stated in one."""
    limit = sensor.converter.limit if sensor.converter is not None else sensor.full_scale
    if limit is None or sensor.input is not None:
        return None
    return float(limit / COLUMN_UNITS[str(split_unit(column)[1])].factor)


def wrong_signs(
    sensor: Sensor, mean: Array, up: Array, gravity: float, columns: Sequence[str]
) -> Iterator[Found]:
    """Channels that read the opposite of what acts.

    Args:
        sensor: accelerometer or inclinometer.
        mean: of a dwell, in the sensing form, m/s2, (k,).
        up: up in the body frame as stated, (3,).
        gravity: m/s2.
        columns: names, (k,).
    """
    acting = gravity * up[list(sensor.axis_indices)]
    for name, read, acts in zip(columns, mean, acting, strict=True):
        if abs(acts) > SHOWN * gravity and read / acts < FLIPPED:
            yield (
                "sign",
                f"{name}: {read:.4g} m/s2 where {acts:.4g} acts: its sign is wrong, or the pose is"
                " not the stated one",
            )
