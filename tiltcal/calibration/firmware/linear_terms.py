"""Bias, scale, axes, g-sensitivity and their temperature as numbers in the units of the log."""

import re
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial

from tiltcal.calibration.correction import temperature_terms
from tiltcal.calibration.firmware.log_units import LogUnit, log_unit, triad_with
from tiltcal.calibration.result import Calibration
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.instrument.model import InstrumentModel
from tiltcal.instrument.temperature import Memory, TemperatureTerms
from tiltcal.recordings.recording import Recording
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup

LINEAR = ("bias_", "scale_", "cross_", "gsens_", "temp")
OWNERS = ("temperature.", "base.")  # of parameters that belong to no sensor
ROUNDS = 6  # in C: each reduces the error by the size of the axes' terms over temperature


@dataclass(frozen=True)
class ForceTerms:
    """What the specific force adds to the readings of a gyro.

    Args:
        sensor: the accelerometer triad; unit: of its log.
        matrix: unit of the gyro's log per unit of the triad's log, (k, 3).
    """

    sensor: Sensor
    unit: LogUnit
    matrix: Array


@dataclass(frozen=True)
class SensorTerms:
    """``left = reading - offset - force.matrix force - bias(T) - memory h``, then
    ``f = inverse (left - slope(T) f)``; all in the units of the log.

    Args:
        sensor, unit: whose.
        offset: (k,); inverse: (k, k).
        force: of a gyro with g-sensitivity.
        bias: coefficients of (T - T0)^1, 2 ..., (order, k).
        memory: by h, (k,).
        slope: coefficients of (T - T0)^1, 2 ..., (order, k, k).
    """

    sensor: Sensor
    unit: LogUnit
    offset: Array
    inverse: Array
    force: ForceTerms | None
    bias: Array
    memory: Array
    slope: Array


@dataclass(frozen=True)
class LinearTerms:
    """What a calibration does to readings.

    Args:
        sensors: the terms of each.
        memory: of the temperature; None without temperature.
        reference: T0, degC; smoothing: time constant of the temperature's low-pass, s.
        lowest, highest: temperatures of the calibration, whole degC.
    """

    sensors: tuple[SensorTerms, ...]
    memory: Memory | None = None
    reference: float = 0.0
    smoothing: float = 0.0
    lowest: float = 0.0
    highest: float = 0.0


def linear_terms(
    calibration: Calibration, setup: Setup, log: Recording | None = None
) -> LinearTerms:
    """The numbers of a calibration in the units of a log.

    Raises:
        TiltcalError: it has other terms, or a sensor whose correction is not linear.
    """
    sensors = [setup.named(n) for n in calibration.sensors()]
    _require_linear(calibration, sensors)
    found = tuple(_sensor_terms(calibration, s, setup, log) for s in sensors)
    terms = temperature_terms(calibration, setup)
    if terms is None:
        return LinearTerms(found)
    return LinearTerms(
        found,
        terms.memory,
        calibration.value("temperature.T0"),
        terms.value("smoothing"),
        float(np.floor(calibration.value("temperature.lowest"))),
        float(np.ceil(calibration.value("temperature.highest"))),
    )


def has_integers(calibration: Calibration, setup: Setup) -> bool:
    """Whether the terms of a calibration have a version in integers: those of ``LINEAR`` along the
    axes that a sensor has, and of inclinometers bias, scale factor and cross-axis terms.
    """
    sensors = [setup.named(n) for n in calibration.sensors()]
    inclined = [s.kind == "inclinometer" for s in sensors]
    allowed = LINEAR[:3] if any(inclined) else LINEAR
    names = [n.partition(".")[2] for n in calibration.parameters if not n.startswith(OWNERS)]
    bent = any(s.kind == "accelerometer" and _bent(calibration, s) for s in sensors)
    return (
        all(name.startswith(allowed) for name in names)
        and not bent
        and not calibration.effects
        and (all(inclined) or not any(inclined))
    )


def _require_linear(calibration: Calibration, sensors: list[Sensor]) -> None:
    if not sensors:
        raise TiltcalError(
            f"calibration by {calibration.method}",
            found="no sensor",
            need="terms of a sensor",
            do="calibrate one",
        )
    for sensor in sensors:
        if not re.fullmatch(r"[A-Za-z0-9_]+", sensor.name):
            raise TiltcalError(
                f"sensor '{sensor.name}'",
                found="a name that C does not allow",
                need="letters, digits and _",
                do="rename it in the scenario and calibrate again",
            )


def _bent(calibration: Calibration, sensor: Sensor) -> bool:
    """Whether the correction of an accelerometer needs the axis that it lacks."""
    missing = sorted({0, 1, 2} - set(sensor.axis_indices))
    return bool(np.any(calibration.sensitivity(sensor)[:, missing]))


def _sensor_terms(
    calibration: Calibration, sensor: Sensor, setup: Setup, log: Recording | None
) -> SensorTerms:
    unit = log_unit(sensor, log)
    model = calibration.of_sensor(sensor, setup.site.gravity)
    rows = list(sensor.axis_indices)
    zero, M = model.linear(sensor)
    inverse = np.asarray(np.linalg.inv(M[:, rows]), dtype=float)
    offset = unit.zero + zero / unit.factor
    force = _force_terms(model, sensor, unit, setup, log)
    if force is not None:
        offset = offset - force.matrix @ force.unit.zero
    scale = unit.corrected_factor / unit.factor
    terms = model.temperature_terms(sensor) or TemperatureTerms()
    bias, slope, memory = terms.coefficients(sensor)
    return SensorTerms(
        sensor,
        unit,
        offset,
        inverse / scale,
        force,
        bias / unit.factor,
        memory / unit.factor,
        slope[:, :, rows] * scale,
    )


def _force_terms(
    model: InstrumentModel, sensor: Sensor, unit: LogUnit, setup: Setup, log: Recording | None
) -> ForceTerms | None:
    G = model.follows_force(sensor)
    if G is None:
        return None
    triad = triad_with(sensor, setup)
    of_force = log_unit(triad, log)
    return ForceTerms(triad, of_force, G * of_force.factor / unit.factor)


def over_range(coefficients: Array, terms: LinearTerms) -> Array:
    """Coefficients of powers of T - T0, from the first on, (n, ...), as those of powers of u from
    the zeroth on, (n + 1, ...): u runs from -1 to 1 over the temperatures of the calibration.
    """
    middle, half = (terms.highest + terms.lowest) / 2, (terms.highest - terms.lowest) / 2
    warm = Polynomial([middle - terms.reference, half])
    found = np.zeros((len(coefficients) + 1, *coefficients.shape[1:]))
    for place in np.ndindex(coefficients.shape[1:]):
        powers = Polynomial([0.0, *(row[place] for row in coefficients)])
        composed = np.asarray(powers(warm).coef)
        found[(slice(0, len(composed)), *place)] = composed
    return found
