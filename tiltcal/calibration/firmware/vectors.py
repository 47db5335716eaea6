"""Test vectors for firmware: readings, and what ``tiltcal correct`` makes of them."""

import numpy as np

from tiltcal.calibration.correction import correct_pieces, temperature_terms
from tiltcal.calibration.firmware.fixed_linear import FixedSensor, Range, fixed_sensors, range_of
from tiltcal.calibration.firmware.fixed_point import READ_PLACES
from tiltcal.calibration.firmware.inclinometer_export import STEEPEST, readings_of
from tiltcal.calibration.firmware.linear_terms import LinearTerms, has_integers, linear_terms
from tiltcal.calibration.firmware.log_units import LogUnit, log_unit, with_recorded_units
from tiltcal.calibration.result import Calibration, setup_of
from tiltcal.core.arrays import Array
from tiltcal.recordings.recording import Recording
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup

ROWS = 400
FASTEST = 2.0  # rad/s
SPAN = 30.0  # degC about T0
LONGEST_MS = 2000  # between readings


def firmware_vectors(calibration: Calibration, log: Recording | None = None) -> Recording:
    """A recording with the corrected columns added.

    Args:
        calibration: with the set-up it was made with.
        log: whose first rows are used. If not given, readings are drawn over the whole range of
            the integers, and stand on whole integers; times on whole milliseconds.

    Raises:
        TiltcalError: the calibration cannot be exported, or the log lacks a sensor.
    """
    setup = with_recorded_units(setup_of(calibration), calibration)
    given = _drawn(calibration, setup) if log is None else _first_rows(log)
    written: list[Recording] = []
    correct_pieces([given], calibration, written.append)
    return written[0]


def _first_rows(log: Recording) -> Recording:
    columns = {name: log.column(name)[:ROWS] for name in log.column_names}
    return Recording.from_columns(log.time[:ROWS], columns, source=log.source)


def _drawn(calibration: Calibration, setup: Setup) -> Recording:
    rng = np.random.default_rng(ROWS)
    time = np.concatenate([[0], np.cumsum(rng.integers(1, LONGEST_MS, ROWS - 1))]) * 1e-3
    columns: dict[str, Array] = {}
    if calibration.bias_tables:
        (sensor,) = (setup.named(n) for n in calibration.sensors())
        columns |= _within_tables(calibration, sensor, setup.site.gravity, rng)
    elif not has_integers(calibration, setup):
        columns |= _plausible(calibration, setup, rng)
    elif any(setup.named(n).kind == "inclinometer" for n in calibration.sensors()):
        for name in calibration.sensors():
            columns |= _inclined(setup.named(name), rng)
    else:
        terms = linear_terms(calibration, setup)
        for fixed in fixed_sensors(terms)[0]:
            columns |= _over_range(fixed, rng)
        if terms.memory is not None:
            columns["temperature_degC"] = _there_and_back(terms, rng)
    return Recording.from_columns(time, columns, source="test vectors")


def _plausible(
    calibration: Calibration, setup: Setup, rng: np.random.Generator
) -> dict[str, Array]:
    """Readings of all sensors at inclinations up to that of ``STEEPEST``, or at rates up to
    ``FASTEST``, and temperatures about T0.
    """
    columns: dict[str, Array] = {}
    for sensor in setup.sensor:
        if sensor.kind == "inclinometer":
            columns |= _inclined(sensor, rng)
            continue
        unit = log_unit(sensor)
        values = rng.uniform(-FASTEST, FASTEST, (ROWS, len(sensor.axes)))
        if sensor.is_accelerometer:
            steep, around = rng.uniform(0, STEEPEST, ROWS), rng.uniform(0, 2 * np.pi, ROWS)
            x, y = np.sin(steep) * np.cos(around), np.sin(steep) * np.sin(around)
            up = np.column_stack([x, y, np.cos(steep)])
            values = setup.site.gravity * up[:, list(sensor.axis_indices)]
        for axis, column in zip(sensor.axes, values.T, strict=True):
            columns[f"{sensor.name}_{axis}_{unit.written}"] = (
                column / unit.factor + unit.zero[sensor.axes.index(axis)]
            )
    if temperature_terms(calibration, setup) is not None:
        T0 = calibration.value("temperature.T0")
        path = np.interp(np.linspace(0, 2, ROWS), [0, 1, 2], [-SPAN, SPAN, -SPAN])
        columns["temperature_degC"] = T0 + path + rng.normal(0, 0.1, ROWS)
    return columns


def _over_range(fixed: FixedSensor, rng: np.random.Generator) -> dict[str, Array]:
    s = fixed.terms
    found = _columns(s.sensor, s.unit.written, fixed.readings, rng)
    if s.force is not None and fixed.force is not None:
        found |= _columns(s.force.sensor, s.force.unit.written, fixed.force, rng)
    return found


def _columns(
    sensor: Sensor, unit: str, readings: Range, rng: np.random.Generator
) -> dict[str, Array]:
    """Readings of each axis, the ends of the range first."""
    found = {}
    for axis in sensor.axes:
        whole = rng.integers(-readings.whole, readings.whole, ROWS, endpoint=True)
        whole[:2] = readings.whole * rng.permutation([-1, 1])
        found[f"{sensor.name}_{axis}_{unit}"] = np.asarray(
            whole * 2.0**-readings.places, dtype=float
        )
    return found


def _there_and_back(terms: LinearTerms, rng: np.random.Generator) -> Array:
    """Temperatures from the lowest to the highest and back, with noise, degC, (ROWS,)."""
    path = np.interp(
        np.linspace(0, 2, ROWS), [0, 1, 2], [terms.lowest, terms.highest, terms.lowest]
    )
    noisy = np.clip(path + rng.normal(0, 0.1, ROWS), terms.lowest, terms.highest)
    return np.asarray(np.round(noisy * 2**READ_PLACES) / 2**READ_PLACES)


def _within_tables(
    calibration: Calibration, sensor: Sensor, gravity: float, rng: np.random.Generator
) -> dict[str, Array]:
    """Readings of a level at placing angles that its tables hold."""
    corrector = calibration.placing(sensor, gravity)
    held = {} if corrector is None else corrector.tables
    betas = {}
    for axis in "xy":
        low, high = held[axis].range_deg if axis in held else (-45.0, 45.0)
        betas[axis] = np.radians(rng.uniform(max(low, -80.0), min(high, 80.0), ROWS))
    force = np.column_stack([-np.tan(betas["y"]), np.tan(betas["x"]), np.ones(ROWS)])
    force *= gravity / np.linalg.norm(force, axis=1)[:, None]
    unit = log_unit(sensor)
    shown = force[:, ["xyz".index(axis) for axis in sensor.axes]]
    return _written(sensor, shown, unit, range_of(sensor, unit))


def _inclined(sensor: Sensor, rng: np.random.Generator) -> dict[str, Array]:
    """Readings of an inclinometer at inclinations up to that for which its error is stated."""
    steep, around = rng.uniform(0, STEEPEST - 0.02, ROWS), rng.uniform(0, 2 * np.pi, ROWS)
    up = np.sin(steep)[:, None] * np.column_stack([np.cos(around), np.sin(around)])
    shown = np.arcsin(up[:, ["xy".index(axis) for axis in sensor.axes]])
    return _written(sensor, shown, log_unit(sensor), readings_of(sensor))


def _written(sensor: Sensor, values: Array, unit: LogUnit, readings: Range) -> dict[str, Array]:
    """Values in SI, (ROWS, k), as columns of whole integers with the places of the readings."""
    whole = np.round((values / unit.factor + unit.zero) * 2.0**readings.places)
    names = [f"{sensor.name}_{axis}_{unit.written}" for axis in sensor.axes]
    return {n: np.asarray(c * 2.0**-readings.places) for n, c in zip(names, whole.T, strict=True)}
