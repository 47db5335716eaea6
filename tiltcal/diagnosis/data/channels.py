"""Single channels of a recording, in SI, and recordings with some of their values changed."""

from collections.abc import Sequence

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.core.units import COLUMN_UNITS, split_unit
from tiltcal.effects.base import Effect
from tiltcal.effects.data.labelling_faults import ColumnFault
from tiltcal.recordings.recording import Recording
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.setup.tables import axis_of


def column_values(recording: Recording, sensor: Sensor, axis: str) -> tuple[Index, Array, Array]:
    """Rows, times and SI values of a channel where it was sampled, (n,) each."""
    samples = recording.sensor(sensor)
    values = samples.values[:, sensor.axes.index(axis)]
    there = ~np.isnan(values)
    return samples.rows[there], samples.time[there], values[there]


def written(recording: Recording, sensor: Sensor, axis: str) -> Array:
    """A channel as the file has it, in the file's unit, (n,); NaN where it was not sampled."""
    return recording.column(str(recording.channel(f"{sensor.name}_{axis}")))


def as_written(change: Array, sensor: Sensor, column: str) -> Array:
    """A change of a channel, SI, (n,), in the unit of its column."""
    unit = str(split_unit(column)[1])
    if sensor.input is not None and unit == sensor.input.unit:
        return np.asarray(change * sensor.input.slope)
    return np.asarray(change / COLUMN_UNITS[unit].factor)


def changed(
    recording: Recording, sensor: Sensor, axis: str, rows: Index, value: float | Array
) -> Recording:
    """A copy with some rows of a channel set to a value, or one each, as written (NaN: not
    sampled). rows: (m,); value: in the unit of the column.
    """
    if not len(rows):
        return recording
    name = str(recording.channel(f"{sensor.name}_{axis}"))
    columns = {n: recording.column(n).copy() for n in recording.column_names}
    columns[name][rows] = value
    return recording.rewritten(columns)


def shifted(recording: Recording, sensor: Sensor, time: float, lost: int) -> Recording:
    """A copy whose readings of a sensor are moved on by ``lost`` samples from a time (s) on, none
    where they were lost.
    """
    rows = _sampled(recording.sensor(sensor).rows)
    start = int(np.searchsorted(recording.time[rows], time))
    columns = {n: recording.column(n).copy() for n in recording.column_names}
    for axis in sensor.axes:
        values = columns[str(recording.channel(f"{sensor.name}_{axis}"))]
        later = values[rows[start : len(rows) - lost]].copy()
        values[rows[start : start + lost]] = np.nan
        values[rows[start + lost :]] = later
    return recording.rewritten(columns)


def _sampled(rows: Index) -> Index:
    """The rows on which a sensor was sampled, the empty ones among them: where it reads on every
    k-th row, all of these.
    """
    step = int(np.median(np.diff(rows)))
    regular = not np.any((rows - rows[0]) % step)
    return np.arange(rows[0], rows[-1] + 1, step) if regular else rows


def without_readout(recording: Recording, rows: Index) -> Recording:
    """A copy whose table was not read on some rows. rows: (m,)."""
    columns = {n: recording.column(n).copy() for n in recording.column_names}
    for name in columns:
        if axis_of(name) is not None:
            columns[name][rows] = np.nan
    return recording.rewritten(columns)


def undo_labelling_faults(
    recording: Recording, setup: Setup, effects: Sequence[Effect]
) -> Recording:
    """A copy whose columns mean what they say: units, signs and exchanged axes of these effects
    undone.
    """
    mapped = [e for e in effects if isinstance(e, ColumnFault)]
    for effect in sorted(mapped, key=lambda e: -e.order):
        sensor = setup.named(str(effect.sensor))
        if not recording.has(sensor):
            continue
        samples = recording.sensor(sensor)
        n = len(sensor.axes)
        P = effect.matrix(sensor.axes)
        values = samples.values @ np.linalg.inv(P).T if n > 1 else samples.values / P[0, 0]
        columns = {name: recording.column(name).copy() for name in recording.column_names}
        for k, axis in enumerate(sensor.axes):
            name = str(recording.channel(f"{sensor.name}_{axis}"))
            unit = samples.units[k]
            written = values if sensor.input is None else sensor.input.from_si(values)
            factor = COLUMN_UNITS[unit].factor if sensor.input is None else 1.0
            columns[name][samples.rows] = written[:, k] / factor
        recording = recording.rewritten(columns)
    return recording


def meant_matrix(effect: Effect, sensor: Sensor) -> Array:
    """What an effect does to the meaning of a sensor's channels, (k, k)."""
    return (
        effect.matrix(sensor.axes) if isinstance(effect, ColumnFault) else np.eye(len(sensor.axes))
    )
