"""The checks of a log, on a recording of stated sensors."""

from collections.abc import Iterable

import numpy as np

from tiltcal.core.units import COLUMN_UNITS, split_unit
from tiltcal.data_quality.log import Log
from tiltcal.data_quality.registry import Inspection, inspect_log
from tiltcal.recordings.recording import Recording, is_reading
from tiltcal.setup.sensor import Sensor


def inspect_recording(recording: Recording, sensors: Iterable[Sensor] | None = None) -> Inspection:
    """What the checks say of the stamps, the table, the temperature and some sensors.

    Args:
        recording: as it was read.
        sensors: whose readings are checked; None: all columns.
    """
    names = recording.column_names
    limits: dict[str, float] = {}
    rates: dict[str, float] = {}
    if sensors is not None:
        read = [n for n in names if not is_reading(n)]
        for sensor in sensors:
            columns = [recording.channel(f"{sensor.name}_{axis}") for axis in sensor.axes]
            own = [n for n in columns if n is not None]
            limit = sensor.converter.limit if sensor.converter is not None else sensor.full_scale
            if limit is not None and sensor.input is None:
                limits |= {n: limit / COLUMN_UNITS[str(split_unit(n)[1])].factor for n in own}
            rates |= dict.fromkeys(own, sensor.rate_hz)
            read += own
        names = read
    columns_of = {name: recording.column(name) for name in names}
    return inspect_log(Log.of(recording.time, columns_of, limits=limits, rates=rates))


def with_repaired_readings(recording: Recording, inspection: Inspection) -> Recording:
    """The recording with the readings that are repaired with certainty."""
    before = {n: recording.column(n) for n in recording.column_names}
    changed = {
        name: c.values
        for name, c in inspection.repaired.channels.items()
        if c.is_reading and not np.array_equal(c.values, before[name], equal_nan=True)
    }
    return recording.rewritten(before | changed) if changed else recording
