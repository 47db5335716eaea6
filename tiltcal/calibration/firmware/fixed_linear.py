"""Bias, scale, axes, g-sensitivity and their temperature in integers, with the worst error.

Readings are 32-bit integers, products 64-bit. Each number has as many binary places as its largest
value leaves room for; that value follows from the range of the readings, to which they are held,
and from the terms. So no sum overflows, whatever is read.
"""

from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np

from tiltcal.calibration.firmware.fixed_point import (
    MEMORY_PLACES,
    FixedMatrix,
    FixedPolynomial,
    FixedTemperature,
    decimals,
    fixed_temperature,
    places_for,
)
from tiltcal.calibration.firmware.linear_terms import ROUNDS, LinearTerms, SensorTerms, over_range
from tiltcal.calibration.firmware.log_units import LogUnit
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import G0
from tiltcal.setup.sensor import Sensor

RANGE = {"acceleration": 16 * G0, "rate": 2000 / 180 * pi}  # SI, where no full_scale is stated
BIAS_BITS, SLOPE_BITS, MEMORY_BITS = 32, 29, 28


@dataclass(frozen=True)
class Range:
    """The readings that are taken: to ``limit`` in the unit of the log, with ``places``."""

    limit: float
    places: int

    @property
    def whole(self) -> int:
        """The largest reading as an integer."""
        return int(self.limit * 2.0**self.places)


@dataclass(frozen=True)
class FixedSensor:
    """The numbers of one sensor, ``numbers`` for the template.

    Args:
        readings, force: what is taken; force: None without g-sensitivity.
        places: of the corrected reading.
        error: worst of a corrected reading, in the unit of the log.
    """

    terms: SensorTerms
    readings: Range
    force: Range | None
    places: int
    error: float
    numbers: dict[str, Any]


def fixed_sensors(terms: LinearTerms) -> tuple[list[FixedSensor], FixedTemperature | None]:
    """All sensors of a calibration, and the temperature where it has one.

    Raises:
        TiltcalError: terms over temperature that are too large for these steps.
    """
    if terms.memory is None:
        return [_without_temperature(s) for s in terms.sensors], None
    heat = fixed_temperature(terms, terms.memory)
    return [_with_temperature(s, terms, heat) for s in terms.sensors], heat


def range_of(sensor: Sensor, unit: LogUnit, places: int | None = None) -> Range:
    """The readings of a sensor that are taken: its full scale, or 16 g and 2000 deg/s.

    Args:
        sensor, unit: whose log.
        places: binary places of a reading; as many as fit if not given, none of counts.
    """
    full = sensor.full_scale or RANGE["acceleration" if sensor.is_accelerometer else "rate"]
    limit = full / unit.factor + float(np.abs(unit.zero).max())
    if unit.counts:
        return Range(min(np.ceil(limit), 2.0**31 - 1), 0)
    return Range(limit, places_for(limit, 31) if places is None else places)


def _without_temperature(s: SensorTerms) -> FixedSensor:
    readings = range_of(s.sensor, s.unit)
    k = len(s.offset)
    matrix, limits, places = s.inverse, np.full(k, readings.limit), [readings.places] * k
    force = None
    if s.force is not None:
        force = range_of(s.force.sensor, s.force.unit)
        matrix = np.hstack([matrix, -s.inverse @ s.force.matrix])
        limits, places = np.append(limits, np.full(3, force.limit)), places + [force.places] * 3
    fixed = FixedMatrix.of(matrix, -s.inverse @ s.offset, limits, places)
    numbers = {"matrix": fixed.matrix, "constant": fixed.constant, "shift": fixed.shift}
    return FixedSensor(s, readings, force, fixed.places, fixed.error, numbers)


def _with_temperature(s: SensorTerms, terms: LinearTerms, heat: FixedTemperature) -> FixedSensor:
    powers = over_range(s.bias, terms)
    powers[0] += s.offset
    bias = FixedPolynomial.of(powers, BIAS_BITS)
    memory_size = float(np.abs(s.memory).max())
    memory = FixedPolynomial.of(s.memory[None], MEMORY_BITS)
    largest = range_of(s.sensor, s.unit).limit + bias.bound + memory_size * heat.most
    places = min(places_for(largest, 31), bias.places, memory.places + MEMORY_PLACES)
    readings = range_of(s.sensor, s.unit, places)
    left = (
        bias.error
        + bias.slope * heat.unit
        + memory_size * heat.memory
        + memory.error * heat.most
        + 2.0 ** (-places)  # the bias and the memory are rounded to these places
    )
    slope = FixedPolynomial.of(over_range(s.slope, terms).reshape(-1, s.inverse.size), SLOPE_BITS)
    fixed, error = _solved(s, slope, heat, largest, places, left)
    numbers = {
        "matrix": fixed.matrix,
        "constant": fixed.constant,
        "shift": fixed.shift,
        "bias": bias.coefficients,
        "bias_shift": bias.places - places,
        "memory": memory.coefficients[0] if memory_size else [],
        "memory_shift": memory.places + MEMORY_PLACES - places,
        "widen": places - readings.places,
        "slope": slope.coefficients if len(s.slope) else [],
        "slope_shift": slope.places + fixed.places - places,
        "rounds": ROUNDS + 1,
    }
    return FixedSensor(s, readings, None, fixed.places, error, numbers)


def _solved(
    s: SensorTerms,
    slope: FixedPolynomial,
    heat: FixedTemperature,
    largest: float,
    places: int,
    left: float,
) -> tuple[FixedMatrix, float]:
    """The matrix, and the error of f in ``f = inverse (left - slope f)`` by repeated insertion.

    Args:
        largest: size of ``left``.
        places: of it.
        left: its error.

    Raises:
        TiltcalError: the insertion does not converge.
    """
    k = len(s.offset)
    gain = float(np.abs(s.inverse).sum(axis=1).max())
    share = gain * k * slope.bound if len(s.slope) else 0.0
    if share >= 0.5:
        raise TiltcalError(
            f"fixed point, sensor {s.sensor.name}",
            found=f"axes that change by {share:.2g} of themselves over temperature",
            need="less than a half",
            do="use the floating-point part",
        )
    limits: Array = np.full(k, largest / (1 - share))
    reach = gain * largest / (1 - share)
    fixed = FixedMatrix.of(s.inverse, np.zeros(k), limits, [places] * k, reach)
    if len(s.slope):
        turned = k * (slope.error + slope.slope * heat.unit) * fixed.bound
        left += turned + 2.0 ** (-places - 1)
    return fixed, (gain * left + fixed.error) / (1 - share)


def stated(found: FixedSensor) -> dict[str, Any]:
    """Range, resolution and worst error of a sensor, in words, for the header."""
    unit, force = found.terms.unit, found.terms.force
    words: dict[str, Any] = {
        "limit": f"{found.readings.limit:.6g}",
        "whole": found.readings.whole,
        "places": found.readings.places,
        "out_places": found.places,
        "resolution": decimals(2.0**-found.readings.places),
        "out_resolution": decimals(2.0**-found.places),
        "error": decimals(found.error),
        "unit": unit.written,
        "corrected_unit": unit.corrected,
        "k": len(found.terms.offset),
        "name": found.terms.sensor.name,
        "force": None,
    }
    if force is not None and found.force is not None:
        words["force"] = {
            "name": force.sensor.name,
            "unit": force.unit.written,
            "limit": f"{found.force.limit:.6g}",
            "whole": found.force.whole,
            "places": found.force.places,
        }
    return words | found.numbers
