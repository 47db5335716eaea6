"""The units in which a log holds a sensor's readings, and in which they are corrected."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.calibration.correction import corrected_unit
from tiltcal.calibration.result import Calibration
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import COLUMN_UNITS, split_unit
from tiltcal.recordings.recording import Recording
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup


@dataclass(frozen=True)
class LogUnit:
    """SI = ``factor`` (reading - ``zero``); corrected SI = ``corrected_factor`` corrected reading.

    Args:
        written: unit of the reading's columns; factor: SI per unit; zero: in that unit, (k,).
        corrected: unit of the corrected columns; corrected_factor: SI per unit.
        counts: whether readings are whole numbers.
    """

    written: str
    factor: float
    zero: Array
    corrected: str
    corrected_factor: float
    counts: bool


def with_recorded_units(setup: Setup, calibration: Calibration) -> Setup:
    """A set-up whose sensors are in the units of the columns that they were calibrated from.

    Args:
        setup: the calibration was made with.
        calibration: it is left as it is where its provenance names no columns.
    """
    columns = calibration.provenance.get("columns", {})
    sensors = tuple(_with_unit(s, columns.get(s.name)) for s in setup.sensor)
    return setup.model_copy(update={"sensor": sensors})


def _with_unit(sensor: Sensor, unit: str | None) -> Sensor:
    if unit not in COLUMN_UNITS or COLUMN_UNITS[unit].quantity != sensor.quantity:
        return sensor  # counts and volts are those of its input
    return sensor.model_copy(update={"unit": unit, "input": None})


def log_unit(sensor: Sensor, log: Recording | None = None) -> LogUnit:
    """The units of a sensor: those of a log, otherwise those of its own columns.

    Raises:
        TiltcalError: the log has no column of the sensor, several units, or a raw unit that the
            scenario does not convert.
    """
    k = len(sensor.axes)
    written = sensor.column_unit if log is None else _unit_in(log, sensor)
    corrected = corrected_unit(written, sensor)
    out = COLUMN_UNITS[corrected].factor
    if sensor.input is not None and written == sensor.input.unit:
        zero = np.broadcast_to(np.asarray(sensor.input.zero, dtype=float), (k,))
        counts = written == "LSB"
        return LogUnit(written, 1 / sensor.input.slope, zero, corrected, out, counts)
    return LogUnit(written, COLUMN_UNITS[written].factor, np.zeros(k), corrected, out, False)


def _unit_in(log: Recording, sensor: Sensor) -> str:
    units = [str(split_unit(name)[1]) for name in _columns(log, sensor)]
    raw = COLUMN_UNITS[units[0]].quantity == "raw"
    if len(set(units)) > 1 or (raw and (sensor.input is None or sensor.input.unit != units[0])):
        raise TiltcalError(
            f"{log.source}, sensor {sensor.name}",
            found="units " + ", ".join(units),
            need="one unit for all axes, that of the scenario's input where it is raw",
            do="choose another log",
        )
    return units[0]


def _columns(log: Recording, sensor: Sensor) -> Sequence[str]:
    names = [log.channel(f"{sensor.name}_{axis}") for axis in sensor.axes]
    if None in names:
        log.sensor(sensor)  # says what is missing
    return [str(name) for name in names]


def triad_with(sensor: Sensor, setup: Setup) -> Sensor:
    """The accelerometer triad whose force a rate sensor follows.

    Raises:
        TiltcalError: the set-up has none.
    """
    triads = [s for s in setup.sensors("accelerometer") if len(s.axes) == 3]
    if not triads:
        raise TiltcalError(
            f"sensor {sensor.name}",
            found="g-sensitivity, and no accelerometer triad in the set-up",
            need="the force that it follows",
            do="calibrate without gsens",
        )
    return triads[0]
