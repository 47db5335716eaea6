"""Bias, scale, axes and their temperature in floating point, for the template."""

from typing import Any

import numpy as np

from tiltcal.calibration.firmware.linear_terms import ROUNDS, LinearTerms, SensorTerms
from tiltcal.core.arrays import Array
from tiltcal.instrument.temperature import SHORTEST


def float_numbers(terms: LinearTerms) -> dict[str, Any]:
    """What the floating-point part of the template needs."""
    found: dict[str, Any] = {"thermal": terms.memory is not None, "rounds": ROUNDS}
    warm = np.zeros(0)
    if terms.memory is not None:
        grid = np.arange(terms.lowest, terms.highest + 1.0)
        warm = grid - terms.reference
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
    return found | {"sensors": [_sensor(s, warm) for s in terms.sensors]}


def _sensor(s: SensorTerms, warm: Array) -> dict[str, Any]:
    """The numbers of one sensor; ``warm``: the grid of its table less T0, degC, (m,)."""
    powers = s.bias if len(s.bias) else np.zeros((1, len(s.offset)))
    table = sum(np.outer(warm ** (n + 1), row) for n, row in enumerate(powers))
    return {
        "name": s.sensor.name,
        "k": len(s.offset),
        "unit": s.unit.written,
        "corrected_unit": s.unit.corrected,
        "bias": row_of(s.offset),
        "inverse": [row_of(row) for row in s.inverse],
        "force": [] if s.force is None else [row_of(row) for row in s.force.matrix],
        "force_name": "" if s.force is None else s.force.sensor.name,
        "force_unit": "" if s.force is None else s.force.unit.written,
        "order": len(powers),
        "powers": [row_of(row) for row in powers],
        "memory": row_of(s.memory),
        "table": [row_of(row) for row in np.reshape(table, (-1, len(s.offset)))],
        "axes_order": len(s.slope),
        "axes": [[row_of(row) for row in matrix] for matrix in s.slope],
    }


def row_of(values: Array) -> list[str]:
    """Numbers as C has them. values: (n,)."""
    return [repr(float(v)) for v in values]
