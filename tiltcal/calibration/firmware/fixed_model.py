"""The inverse of a sensor's model in integers, with one bound of its error.

``f = A y + c + B r(f)``: the readings y, or their sines, and what the sensor reads beyond its bias
and its own channels, r, are inserted repeatedly. With Q a bound of the change of ``B r`` per unit
of each f and d one of the error of a step, n steps leave ``(I - Q)^-1 d + Q^n e``, e being the
error of ``A y + c``.
"""

from dataclasses import dataclass, replace
from math import cos, log2, pi, radians, sin, sqrt
from typing import Any

import numpy as np

from tiltcal.calibration.firmware.fixed_code import FixedCode, FixedNumber, no_integers
from tiltcal.calibration.firmware.fixed_functions import PHASE_ERROR, SINE_ERROR, TURN
from tiltcal.calibration.firmware.fixed_point import FixedMatrix, decimals, integers, places_for
from tiltcal.calibration.firmware.fixed_temperature import STATE_PLACES, FixedTemperature
from tiltcal.calibration.firmware.log_units import LogUnit
from tiltcal.calibration.firmware.model_export import SensorModel
from tiltcal.core.arrays import Array
from tiltcal.core.units import G0
from tiltcal.instrument.model import ROUNDS
from tiltcal.setup.sensor import Sensor

RANGE = {"acceleration": 16 * G0, "rate": 2000 / 180 * pi}  # SI, where no full_scale is stated
STEEPEST = radians(80)  # inclination of an axis up to which the error is stated
SINE_PLACES = 30
WIDENED = 1.01  # of the range of r in each step towards a range that maps into itself
LARGEST = 1e6  # times the range without r: none will be found


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
    """The inverse of one sensor in integers, ``numbers`` for the template.

    Args:
        model: of the sensor.
        readings, force: what is taken; force: None where it is not followed.
        places: of the corrected reading.
        error: worst of a corrected reading, in its unit.
        used: functions that its code calls.
    """

    model: SensorModel
    readings: Range
    force: Range | None
    places: int
    error: float
    used: set[str]
    numbers: dict[str, Any]


def range_of(sensor: Sensor, unit: LogUnit) -> Range:
    """The readings of a sensor that are taken: its full scale, or 16 g and 2000 deg/s; of an
    inclinometer a right angle.

    Args:
        sensor, unit: whose log.
    """
    full = sensor.full_scale or RANGE["acceleration" if sensor.is_accelerometer else "rate"]
    full = pi / 2 if sensor.kind == "inclinometer" else full
    limit = full / unit.factor + float(np.abs(unit.zero).max())
    if unit.counts:
        return Range(min(np.ceil(limit), 2.0**31 - 1), 0)
    return Range(limit, places_for(limit, 31))


@dataclass(frozen=True)
class _Inverse:
    """``f = A y + c + B r(f)`` in units of f.

    Args:
        own: A, (k, k); constant: c, (k,); beyond: B, (k, k).
        limit: of y; places: of it; error: of it.
        unit: SI per unit of f.
        least: smallest range of f.
    """

    own: Array
    constant: Array
    beyond: Array
    limit: float
    places: int
    error: float
    unit: float
    least: float = 0.0

    @classmethod
    def of(cls, m: SensorModel, readings: Range) -> "_Inverse":
        """Of a sensor: f in the corrected unit, of an inclinometer in g."""
        if m.is_angle:
            unit, own, bias = m.model.gravity, m.inverse, m.bias
            error = _phases(m, readings).error / TURN + SINE_ERROR
            constant = -m.inverse @ bias / unit
            return cls(own, constant, -m.inverse / unit, 1.0, SINE_PLACES, error, unit, 1.0)
        unit = m.unit.corrected_factor
        own = m.inverse * m.unit.factor / unit
        constant = -m.inverse @ (m.bias + m.unit.zero * m.unit.factor) / unit
        limit, places = readings.limit, readings.places
        return cls(own, constant, -m.inverse / unit, limit, places, 0.0, unit)

    def size(self, beyond: Array) -> Array:
        """Largest f, (k,), where r is at most ``beyond``, SI, (k,)."""
        k = len(self.constant)
        first = np.abs(self.own) @ np.full(k, self.limit) + np.abs(self.constant)
        return np.maximum(first + np.abs(self.beyond) @ beyond, self.least)


def fixed_sensor(m: SensorModel, heat: FixedTemperature | None, prefix: str) -> FixedSensor:
    """The inverse of a sensor in integers.

    Args:
        m: its model.
        heat: the temperature; None where nothing follows it.
        prefix: what every C name begins with.

    Raises:
        TiltcalError: over the range a reading may stand for several inputs, or a term has no bound.
    """
    readings = range_of(m.sensor, m.unit)
    force = None if m.force is None else range_of(*m.force)
    inverse = _Inverse.of(m, readings)
    k = len(m.axes)
    code, beyond, reach = _within_itself(
        inverse, _Inputs(m, inverse.unit, force, heat, np.zeros(k)), prefix
    )
    sizes = np.array([r.size for r in beyond])
    alone = FixedMatrix.of(
        inverse.own, inverse.constant, np.full(k, inverse.limit), [inverse.places] * k
    )
    beyond = [_balanced(code, r, alone.shift + alone.places) for r in beyond]
    matrix = FixedMatrix.of(
        np.hstack([inverse.own, inverse.beyond]),
        inverse.constant,
        np.concatenate([np.full(k, inverse.limit), sizes]),
        [inverse.places] * k + [r.places for r in beyond],
        reach,
    )
    rounds, error = _bound(m, inverse, beyond, matrix)
    numbers = {
        "matrix": matrix.matrix,
        "constant": matrix.constant,
        "shift": matrix.shift,
        "rounds": rounds,
        "statements": code.statements if rounds else [],
        "results": [r.name for r in beyond] if rounds else [],
    }
    places, used = matrix.places, code.used if rounds else set[str]()
    if m.is_angle:
        added, places, error = _angles(m, readings, matrix.places, error)
        numbers |= added
        used |= {"sine", "phase", "root"}
    return FixedSensor(m, readings, force, places, error, used, numbers)


def _balanced(code: FixedCode, r: FixedNumber, of_sum: int) -> FixedNumber:
    """A result with as many places as its factor in the matrix is left without: what both are
    rounded by adds the least.
    """
    return code.rounded(r, int((of_sum - log2(max(r.size, 2.0**-of_sum))) // 2))


def _within_itself(
    inverse: _Inverse, inputs: "_Inputs", prefix: str
) -> tuple[FixedCode, list[FixedNumber], float]:
    """The code of r, r, and the largest f of a range that no step leaves.

    Raises:
        TiltcalError: there is none.
    """
    m = inputs.model
    beyond = np.zeros(len(m.axes))
    first = float(inverse.size(beyond).max())
    steep = m.model.gravity * cos(STEEPEST)
    while True:
        size = inverse.size(beyond)
        if float(size.max()) > LARGEST * first:
            raise no_integers("values that grow without a bound", m.sensor.name)
        sized = replace(inputs, size=size)
        wander = 2 * np.abs(inverse.beyond) @ beyond  # two values of r differ by that
        code = FixedCode(m.beyond[0], sized.number, prefix, steep, wander)
        results = code.results(m.beyond[1])
        found = np.array([r.size for r in results])
        if np.all(found <= beyond):
            return code, results, float(size.max())
        beyond = WIDENED * np.maximum(found, beyond)


@dataclass(frozen=True)
class _Inputs:
    """What r is computed from.

    Args:
        model: of the sensor.
        unit: SI per unit of f.
        force: that is taken; None: none.
        heat: the temperature; None where nothing follows it.
        size: largest f, (k,), in its unit.
    """

    model: SensorModel
    unit: float
    force: Range | None
    heat: FixedTemperature | None
    size: Array

    def number(self, code: FixedCode, name: str) -> FixedNumber:
        """An input by its name, see ``SensorModel.beyond``."""
        kind, _, index = name.rstrip("]").partition("[")
        if kind == "force" and self.force is not None:
            limit, places = self.force.limit, self.force.places
            return FixedNumber(name, -limit, limit, places, 0.0, np.zeros(code.k))
        heat = self.heat
        if kind == "s->level" and heat is not None:
            return code.of_state(kind, heat.lowest, heat.highest, STATE_PLACES, heat.level)
        if kind == "s->memory" and heat is not None:
            return code.of_state(kind, -heat.most, heat.most, heat.memory_places, heat.memory)
        return self._solved(code, self.model.axes.index(int(index)))

    def _solved(self, code: FixedCode, channel: int) -> FixedNumber:
        """The input along a channel, SI, from the f that is solved for."""
        size, m = self.size[channel], self.model
        places = places_for(float(self.size.max()), 31)
        slope = np.eye(code.k)[channel]
        found = FixedNumber(f"x[{channel}]", -size, size, places, 0.0, slope)
        if self.unit != 1.0:
            found = code.scaled(found, self.unit)
        if "upright" in m.operations:  # |f| = g
            found = code.held(found, m.model.gravity)
        return found


def _bound(
    m: SensorModel, inverse: _Inverse, beyond: list[FixedNumber], matrix: FixedMatrix
) -> tuple[int, float]:
    """How often r is inserted, and the error of f.

    Raises:
        TiltcalError: the insertion does not converge within the rounds of `tiltcal correct`.
    """
    k = len(beyond)
    B = np.abs(inverse.beyond)
    Q = B @ np.array([r.slope for r in beyond])
    step = matrix.error + B @ np.array([r.error for r in beyond])
    step = step + np.abs(inverse.own) @ np.full(k, inverse.error)
    left = B @ np.array([r.size for r in beyond])
    rounds, small = 0, 2.0 ** (-matrix.places - 1)
    while left.max() > small:
        left, rounds = Q @ left, rounds + 1
        if rounds > ROUNDS or not np.isfinite(left).all():
            found = f"terms that change by up to {Q.max():.2g} of their input"
            raise no_integers(found, m.sensor.name)
    if not rounds:
        return 0, float((step + left).max())
    return rounds, float((np.linalg.solve(np.eye(k) - Q, step) + left).max())


def _angles(
    m: SensorModel, readings: Range, places: int, error: float
) -> tuple[dict[str, Any], int, float]:
    """Numbers, places and error of an inclinometer's readings to sines and of sines to angles.

    Args:
        m: its model.
        readings: that are taken.
        places: of the sines that were solved for.
        error: of these.
    """
    inward = _phases(m, readings)
    shift = inward.shift + inward.places
    per = 1 / (TURN * m.unit.corrected_factor)
    outward = FixedMatrix.of(np.array([[per]]), np.zeros(1), np.array([2.0**30]), [0])
    # the root across is rounded down; the steepest sine may be wrong by the error
    angle = error / sqrt(1 - (sin(STEEPEST) + error) ** 2) + PHASE_ERROR + 2.0**-places
    zero = integers(-m.unit.zero * m.unit.factor * TURN, shift)
    numbers = {
        "in_factor": inward.matrix[0][0],
        "in_shift": shift,
        "in_zero": zero,
        "sine_places": places,
        "out_factor": outward.matrix[0][0],
        "out_shift": outward.shift,
    }
    return numbers, outward.places, angle / m.unit.corrected_factor + outward.error


def _phases(m: SensorModel, readings: Range) -> FixedMatrix:
    """Of readings of an inclinometer."""
    phase = m.unit.factor * TURN
    zero = np.array([phase * float(np.abs(m.unit.zero).max())])
    return FixedMatrix.of(np.array([[phase]]), zero, np.array([readings.limit]), [readings.places])


def stated(found: FixedSensor) -> dict[str, Any]:
    """Range, resolution and worst error of a sensor, in words, for the header."""
    m = found.model
    words: dict[str, Any] = {
        "limit": f"{found.readings.limit:.6g}",
        "whole": found.readings.whole,
        "places": found.readings.places,
        "out_places": found.places,
        "resolution": decimals(2.0**-found.readings.places),
        "out_resolution": decimals(2.0**-found.places),
        "error": decimals(found.error),
        "steep": m.is_steep,
        "unit": m.unit.written,
        "corrected_unit": m.unit.corrected,
        "k": len(m.axes),
        "name": m.sensor.name,
        "angle": m.is_angle,
        "force": m.force and {"name": m.force[0].name, "unit": m.force[1].written},
    }
    if found.force is not None:
        limit = f"{found.force.limit:.6g}"
        words["force"] |= {"limit": limit, "whole": found.force.whole, "places": found.force.places}
    return words | found.numbers
