"""The C header of bias, scale, axes and their temperature."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from tiltcal.calibration.result import Calibration
from tiltcal.calibration.thermal import ROUNDS, SHORTEST, Course, ThermalTerms
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup

TEMPLATE = Path(__file__).parent / "linear.h.jinja"
LINEAR = ("bias_", "scale_", "cross_", "temp")


def linear_numbers(calibration: Calibration, setup: Setup) -> dict[str, Any]:
    """What the template needs.

    Raises:
        TiltcalError: the calibration has other terms, or a sensor has fewer axes than its terms
            act along.
    """
    names = [n for n in calibration.parameters if n.partition(".")[0] in calibration.sensors()]
    other = [n for n in names if not n.partition(".")[2].startswith(LINEAR)]
    sensors = [setup.named(n) for n in calibration.sensors()]
    mixed = [s.name for s in sensors if s.is_accelerometer and len(s.axes) != 3]
    if other or mixed or not sensors:
        raise TiltcalError(
            f"calibration by {calibration.method}",
            found=", ".join(other or mixed) or "no sensor",
            need="bias, scale and cross-axis terms of a triad, or placing-angle tables",
            do="calibrate with these terms",
        )
    values = {n: e.value for n, e in calibration.parameters.items()}
    terms = ThermalTerms.among(values)
    found: dict[str, Any] = {"thermal": terms is not None, "rounds": ROUNDS}
    grid = np.zeros(0)
    if terms is not None:
        low, high = (values[f"temperature.{n}"] for n in ("lowest", "highest"))
        grid = np.arange(np.floor(low), np.ceil(high) + 1.0)
        found |= {
            "kind": terms.memory.kind,
            "memory": terms.memory.words(),
            "size": repr(max(terms.memory.size, SHORTEST)),
            "smoothing": repr(max(terms.smoothing, SHORTEST)),
            "reference": repr(terms.reference),
            "table_start": repr(float(grid[0])),
            "table_end": repr(float(grid[-1])),
            "table_count": len(grid),
        }
    return found | {"sensors": [_sensor(calibration, s, terms, grid) for s in sensors]}


def _sensor(
    calibration: Calibration, sensor: Sensor, terms: ThermalTerms | None, grid: Array
) -> dict[str, Any]:
    """The numbers of one sensor."""
    M = calibration.sensitivity(sensor)[:, list(sensor.axis_indices)]
    if not re.fullmatch(r"[A-Za-z0-9_]+", sensor.name):
        raise TiltcalError(
            f"sensor '{sensor.name}'",
            found="a name that C does not allow",
            need="letters, digits and _",
            do="rename it in the scenario and calibrate again",
        )
    found: dict[str, Any] = {
        "name": sensor.name,
        "k": len(sensor.axes),
        "bias": _row(calibration.bias(sensor)),
        "inverse": [_row(row) for row in np.linalg.inv(M)],
    }
    if terms is None:
        return found
    name, axes = sensor.name, sensor.axes
    order = max(terms.order(name, "bias"), 1)
    level = Course(grid, grid, np.zeros_like(grid))
    slopes = [
        [
            [terms.coefficient(name, n, terms.axis_term(sensor, i, j)) for j in sensor.axis_indices]
            for i in range(len(axes))
        ]
        for n in range(1, terms.axes_order(name) + 1)
    ]
    return found | {
        "order": order,
        "powers": [
            _row([terms.coefficient(name, n, f"bias_{a}") for a in axes])
            for n in range(1, order + 1)
        ],
        "memory": _row([terms.values.get(f"{name}.tempmem_{a}", 0.0) for a in axes]),
        "table": [_row(row) for row in terms.bias(sensor, level)],
        "axes_order": len(slopes),
        "axes": [[_row(row) for row in matrix] for matrix in slopes],
    }


def _row(values: Array | list[float]) -> list[str]:
    return [repr(float(v)) for v in values]
