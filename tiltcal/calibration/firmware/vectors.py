"""Test vectors for firmware: readings, and what ``tiltcal correct`` makes of them."""

from dataclasses import replace
from itertools import product

import numpy as np

from tiltcal.calibration.correction import correct_pieces, temperature_terms
from tiltcal.calibration.firmware.fixed_model import STEEPEST, Range, range_of
from tiltcal.calibration.firmware.fixed_temperature import READ_PLACES, temperature_range
from tiltcal.calibration.firmware.log_units import log_unit, with_recorded_units
from tiltcal.calibration.firmware.model_export import SensorModel, sensor_models
from tiltcal.calibration.result import Calibration, setup_of
from tiltcal.core.arrays import Array
from tiltcal.core.frames import tilt_of_force
from tiltcal.core.units import DEG
from tiltcal.effects.sense import Sense
from tiltcal.effects.sensor.dynamics import placing_angle
from tiltcal.recordings.recording import Recording
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup

ROWS = 400
FASTEST = 2.0  # rad/s
EDGE = 12  # directions at the steepest inclination
LONGEST_MS = 2000  # between readings


def firmware_vectors(
    calibration: Calibration,
    log: Recording | None = None,
    *,
    integers: bool = True,
    rows: int = ROWS,
) -> Recording:
    """A recording with the corrected columns added.

    Args:
        calibration: with the set-up it was made with.
        log: whose first rows are used. If not given, readings are drawn over the whole range of
            the integers, and stand on whole integers; times on whole milliseconds.
        integers: whether the header has them; without, readings are at |f| = g and at slow rates.
        rows: how many.

    Raises:
        TiltcalError: the calibration cannot be exported, or the log lacks a sensor.
    """
    setup = with_recorded_units(setup_of(calibration), calibration)
    given = (
        _first_rows(log, rows) if log is not None else _drawn(calibration, setup, integers, rows)
    )
    written: list[Recording] = []
    correct_pieces([given], calibration, written.append)
    return written[0]


def _first_rows(log: Recording, rows: int) -> Recording:
    columns = {name: log.column(name)[:rows] for name in log.column_names}
    return Recording.from_columns(log.time[:rows], columns, source=log.source)


def _drawn(calibration: Calibration, setup: Setup, integers: bool, rows: int) -> Recording:
    rng = np.random.default_rng(ROWS)
    time = np.concatenate([[0], np.cumsum(rng.integers(1, LONGEST_MS, rows - 1))]) * 1e-3
    columns: dict[str, Array] = {}
    if calibration.bias_tables:
        (sensor,) = (setup.named(n) for n in calibration.sensors())
        columns |= _within_tables(calibration, sensor, setup.site.gravity, rng, rows)
        return Recording.from_columns(time, columns, source="test vectors")
    terms = temperature_terms(calibration, setup)
    if terms is not None:
        columns["temperature_degC"] = _there_and_back(calibration, rng, rows)
        course = terms.course(time, columns["temperature_degC"])
    for m in sensor_models(calibration, setup):
        force = [] if m.force is None or m.force[0].name in calibration.sensors() else [m.force[0]]
        if integers and not m.is_steep:
            for sensor in [m.sensor, *force]:
                columns |= _whole_range(sensor, rng, rows)
            continue
        given = Sense.at_rest(m.sensor, m.model.gravity, np.zeros((rows, 3)))
        if terms is not None:
            warm = course.level - calibration.value("temperature.T0")
            given = replace(given, temperature=warm, temperature_memory=course.memory)
        columns |= _read(m, given, rng)
        for sensor in force:
            columns |= _written(sensor, m.model.gravity * _directions(sensor, rng, rows))
    return Recording.from_columns(time, columns, source="test vectors")


def _whole_range(sensor: Sensor, rng: np.random.Generator, rows: int) -> dict[str, Array]:
    """Readings of each axis: first the ends and the middle of the range in all combinations."""
    readings = range_of(sensor, log_unit(sensor))
    whole = rng.integers(-readings.whole, readings.whole, (rows, len(sensor.axes)), endpoint=True)
    ends = rng.permutation(list(product((-1, 0, 1), repeat=len(sensor.axes))))[:rows]
    whole[: len(ends)] = readings.whole * ends
    return _columns(sensor, whole.astype(float), readings)


def _read(m: SensorModel, given: Sense, rng: np.random.Generator) -> dict[str, Array]:
    """What a sensor reads of directions of gravity, or of rates up to ``FASTEST``.

    Args:
        m: its model.
        given: temperatures, of (n,) rows.
        rng: draws the input.
    """
    sensor, rows, gravity = m.sensor, len(given.time), m.model.gravity
    if sensor.is_accelerometer:
        given = replace(given, force=gravity * _directions(sensor, rng, rows))
        values = m.model.predict(sensor, given)
    else:
        values = rng.uniform(-FASTEST, FASTEST, (rows, len(sensor.axes)))
    if m.is_angle:
        values = tilt_of_force(values, gravity)
    return _written(sensor, values)


def _directions(sensor: Sensor, rng: np.random.Generator, rows: int) -> Array:
    """Upward directions, (rows, 3): no axis steeper than ``STEEPEST``, and the one that the sensor
    lacks within it from the vertical.
    """
    missing = sorted({0, 1, 2} - set(sensor.axis_indices))
    around = 2 * np.pi * (np.arange(EDGE) + 0.25) / EDGE  # no axis level, where a reading may jump
    rim = np.sin(STEEPEST) * np.column_stack([np.cos(around), np.sin(around)])
    # the edge first: about the axis that is lacking, or about z
    found = np.insert(rim, missing[0] if missing else 2, np.cos(STEEPEST), axis=1)
    while len(found) < rows:
        drawn = rng.normal(size=(2 * rows, 3))
        drawn /= np.linalg.norm(drawn, axis=1)[:, None]
        drawn[:, missing] = np.abs(drawn[:, missing])
        flat = (np.abs(drawn) <= np.sin(STEEPEST)).all(axis=1)
        if len(missing) == 1:
            flat = drawn[:, missing[0]] >= np.cos(STEEPEST)
        found = np.concatenate([found, drawn[flat]])
    return found[:rows]


def _there_and_back(calibration: Calibration, rng: np.random.Generator, rows: int) -> Array:
    """Temperatures from the lowest to the highest and back, with noise, degC, (rows,)."""
    lowest, highest = temperature_range(calibration)
    path = np.interp(np.linspace(0, 2, rows), [0, 1, 2], [lowest, highest, lowest])
    noisy = np.clip(path + rng.normal(0, 0.1, rows), lowest, highest)
    return np.asarray(np.round(noisy * 2**READ_PLACES) / 2**READ_PLACES)


def _within_tables(
    calibration: Calibration, sensor: Sensor, gravity: float, rng: np.random.Generator, rows: int
) -> dict[str, Array]:
    """Readings of a level at placing angles that its tables hold, up to ``STEEPEST``."""
    corrector = calibration.placing(sensor, gravity)
    held = {} if corrector is None else corrector.tables
    force = np.zeros((0, 3))
    level = sensor.model_copy(update={"axes": ("x", "y")})
    while len(force) < rows:
        drawn = gravity * _directions(level, rng, rows)
        inside = drawn[:, 2] > 0
        for axis, table in held.items():
            low, high = table.range_deg
            inside &= np.abs(placing_angle(axis, drawn) / DEG - (low + high) / 2) < (high - low) / 2
        force = np.concatenate([force, drawn[inside]])
    return _written(sensor, force[:rows, ["xyz".index(axis) for axis in sensor.axes]])


def _written(sensor: Sensor, values: Array) -> dict[str, Array]:
    """Values in SI, (n, k), as columns of whole integers with the places of the readings."""
    unit = log_unit(sensor)
    readings = range_of(sensor, unit)
    whole = np.round((values / unit.factor + unit.zero) * 2.0**readings.places)
    return _columns(sensor, whole, readings)


def _columns(sensor: Sensor, whole: Array, readings: Range) -> dict[str, Array]:
    """Whole integers, (n, k), as columns of the log."""
    names = [f"{sensor.name}_{axis}_{log_unit(sensor).written}" for axis in sensor.axes]
    return {n: np.asarray(c * 2.0**-readings.places) for n, c in zip(names, whole.T, strict=True)}
