"""Inclinometers: angles to forces by the sine, bias and axes, and back, in floating point and in
integers.

In units of g: ``s = inverse (sin(reading) - bias - third up)``, where ``up = sqrt(1 - s.s)`` is the
force along the axis that the instrument lacks; the corrected reading is asin(s).
"""

from collections.abc import Callable
from math import cos, log2, pi, radians, tan
from typing import Any

import numpy as np

from tiltcal.calibration.firmware.fixed_linear import Range
from tiltcal.calibration.firmware.fixed_point import FixedMatrix, decimals, integers, places_for
from tiltcal.calibration.firmware.linear_export import row_of
from tiltcal.calibration.firmware.log_units import LogUnit, log_unit
from tiltcal.calibration.result import Calibration
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.recordings.recording import Recording
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup

PLACES = 30  # of sines
ROUNDS = 20  # each reduces the error by about the size of the cross-axis terms
STEEPEST = radians(80)  # inclination up to which the error is stated
SINE, ARCSINE = 7, 9  # terms of sin(90 deg v) / v and asin(x) / x in powers of the square
SHARE = 0.5  # of itself that a wrong force may add to the next one


def inclinometer_numbers(
    calibration: Calibration, setup: Setup, log: Recording | None = None
) -> dict[str, Any]:
    """What the template of inclinometers needs.

    Raises:
        TiltcalError: another sensor or other terms beside, or axes too far from their own.
    """
    sensors = [setup.named(n) for n in calibration.sensors()]
    names = [n for n in calibration.parameters if n.partition(".")[0] in calibration.sensors()]
    other = [s.name for s in sensors if s.kind != "inclinometer"]
    other += [n for n in names if not n.partition(".")[2].startswith(("bias_", "scale_", "cross_"))]
    if other:
        raise TiltcalError(
            f"calibration by {calibration.method}",
            found=", ".join(other),
            need="bias, scale and cross-axis terms of inclinometers alone",
            do="calibrate the inclinometer by itself, with these terms",
        )
    return {
        "sine": [round(abs(c) * 2.0**62) for c in _sine()],
        "arcsine": [round(c * 2.0**62) for c in _arcsine()],
        "right_angle": round(pi / 2 * 2.0**62),
        "rounds": ROUNDS,
        "sensors": [_sensor(calibration, s, setup.site.gravity, log) for s in sensors],
    }


def readings_of(sensor: Sensor, log: Recording | None = None) -> Range:
    """The readings that are taken: a right angle to both sides."""
    unit = log_unit(sensor, log)
    limit = pi / 2 / unit.factor + float(np.abs(unit.zero).max())
    return Range(np.ceil(limit), 0) if unit.counts else Range(limit, places_for(limit, 31))


def _sensor(
    calibration: Calibration, sensor: Sensor, g: float, log: Recording | None
) -> dict[str, Any]:
    """The numbers of one inclinometer."""
    unit, rows = log_unit(sensor, log), list(sensor.axis_indices)
    M = calibration.sensitivity(sensor)
    inverse = np.asarray(np.linalg.inv(M[:, rows]), dtype=float)
    missing = sorted({0, 1, 2} - set(rows))
    third = M[:, missing[0]] if len(rows) == 2 else np.zeros(len(rows))
    bias = calibration.bias(sensor) / g
    found: dict[str, Any] = {
        "name": sensor.name,
        "k": len(rows),
        "unit": unit.written,
        "corrected_unit": unit.corrected,
        "factor": repr(unit.factor),
        "per_corrected": repr(1 / unit.corrected_factor),
        "zero": row_of(unit.zero),
        "bias": row_of(bias),
        "inverse": [row_of(row) for row in inverse],
        "third": row_of(third) if third.any() else [],
    }
    return found | _fixed(sensor, unit, readings_of(sensor, log), inverse, third, bias)


def _fixed(
    sensor: Sensor, unit: LogUnit, readings: Range, inverse: Array, third: Array, bias: Array
) -> dict[str, Any]:
    """The numbers of the integers."""
    right_angle = 2 * unit.factor / pi
    inward = FixedMatrix.of(
        np.array([[right_angle]]),
        np.zeros(1),
        np.array([2 * readings.limit]),
        [readings.places],
    )
    into = inward.shift + inward.places  # places of the reading in right angles
    fixed, rounds, sines = _forces(sensor, inverse, third, bias)
    outward = FixedMatrix.of(
        np.array([[1 / unit.corrected_factor]]), np.zeros(1), np.array([pi / 2]), [PLACES]
    )
    angle = pi / 2 * inward.error  # rad
    error = sines(angle + 2.0**-31 + 1e-10) / cos(STEEPEST) + 2.0**-30
    return {
        "places": readings.places,
        "limit": f"{readings.limit:.6g}",
        "whole": readings.whole,
        "in_factor": inward.matrix[0][0],
        "in_zero": [integers(-z * right_angle * np.ones(1), into)[0] for z in unit.zero],
        "in_places": into,
        "matrix": fixed.matrix,
        "constant": fixed.constant,
        "shift": fixed.shift + fixed.places - PLACES,
        "fixed_rounds": rounds,
        "out_factor": outward.matrix[0][0],
        "out_shift": outward.shift,
        "out_places": outward.places,
        "error": decimals(error / unit.corrected_factor + outward.error),
    }


def _forces(
    sensor: Sensor, inverse: Array, third: Array, bias: Array
) -> tuple[FixedMatrix, int, Callable[[float], float]]:
    """The matrix over sines and the third force, how often it is applied, and the error of its
    result for an error of the sines.

    Raises:
        TiltcalError: repeated insertion does not converge.
    """
    k = len(bias)
    matrix = np.hstack([inverse, -(inverse @ third)[:, None]])
    fixed = FixedMatrix.of(matrix, -inverse @ bias, np.ones(k + 1), [PLACES] * (k + 1), 1.9)
    turned = float(np.abs(inverse @ third).max())
    share = 2 * turned * tan(STEEPEST)
    if share >= SHARE:
        raise TiltcalError(
            f"firmware, sensor {sensor.name}",
            found=f"a cross-axis term of {turned:.2g} from the axis that it lacks",
            need=f"less than {SHARE / 2 / tan(STEEPEST):.2g}",
            do="correct it on a computer",
        )
    rounds = 1 if not turned else 1 + int(np.ceil(34 / -log2(share)))
    gain = float(np.abs(inverse).sum(axis=1).max())

    def error(of_sine: float) -> float:
        return (gain * of_sine + turned * 2.0**-30 + fixed.error) / (1 - share) + 2.0**-34

    return fixed, rounds, error


def _powers(function: Callable[[Array], Array], highest: float, terms: int) -> list[float]:
    """Coefficients of a function of the square, over its root, by Chebyshev interpolation."""

    def of_square(w: Array) -> Array:
        root = np.sqrt(np.maximum(w, 1e-18))
        return function(root) / root

    series = np.polynomial.chebyshev.Chebyshev.interpolate(
        of_square, terms - 1, domain=[0, highest]
    )
    return [float(c) for c in series.convert(kind=np.polynomial.Polynomial).coef]


def _sine() -> list[float]:
    """Of sin(90 deg v) / v: signs alternate."""
    return _powers(lambda v: np.sin(pi / 2 * v), 1.0, SINE)


def _arcsine() -> list[float]:
    """Of asin(x) / x up to x = 1/2: all positive."""
    return _powers(np.arcsin, 0.25, ARCSINE)
