"""The readings of a sensor as columns of a recording."""

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import COLUMN_UNITS, split_unit
from tiltcal.recordings.recording import Recording
from tiltcal.setup.sensor import Sensor


def to_column(sensor: Sensor, values: Array, unit: str, rounded: bool) -> Array:
    """SI readings, (n, k), in the unit of a column; raw output values are whole numbers."""
    if sensor.input is not None and unit == sensor.input.unit:
        raw = sensor.input.from_si(values)
        return np.rint(raw) if rounded and unit == "LSB" else raw
    return np.asarray(values / COLUMN_UNITS[unit].factor)


def sensor_columns(
    sensor: Sensor,
    values: Array,
    rows: "np.ndarray[tuple[int], np.dtype[np.intp]]",
    n: int,
    seed: int | None,
) -> dict[str, Array]:
    """Columns of a sensor, (n,) each, NaN: not sampled. values: SI, (m, axes); rows: (m,)."""
    written = to_column(sensor, values, sensor.column_unit, seed is not None)
    columns = {}
    for i, axis in enumerate(sensor.axes):
        full = np.full(n, np.nan)
        full[rows] = written[:, i]
        columns[f"{sensor.name}_{axis}_{sensor.column_unit}"] = full
    return columns


def columns_like(
    sensor: Sensor, values: Array, motion: Recording, seed: int | None
) -> dict[str, Array]:
    """The columns of ``motion``, where it has them, with predicted values. values: SI, (n,
    axes).
    """
    columns = {}
    for i, axis in enumerate(sensor.axes):
        name = (
            motion.channel(f"{sensor.name}_{axis}") or f"{sensor.name}_{axis}_{sensor.column_unit}"
        )
        columns[name] = to_column(sensor, values, str(split_unit(name)[1]), seed is not None)[:, i]
    return columns
