"""From a reading to the specific force: the inverse of ``reading = bias + M f + h(f)``."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import PARAMETER_UNITS
from tiltcal.setup.sensor import Sensor

if TYPE_CHECKING:
    from tiltcal.calibration.result import Estimate

LINEAR = ("bias_", "scale_", "cross_")
ROUNDS = 20  # each round reduces the error by about the size of the higher-order terms


def higher_order_terms(parameters: "Mapping[str, Estimate]", sensor: Sensor) -> dict[str, float]:
    """Terms of a sensor beyond bias, scale and cross-axis: effect parameter -> SI value."""
    from tiltcal.effects import CATALOGUE

    found = {}
    for name, estimate in parameters.items():
        owner, _, term = name.partition(".")
        if owner != sensor.name or term.startswith(LINEAR):
            continue
        if _effect_id(term) in CATALOGUE:
            found[term] = estimate.value * PARAMETER_UNITS[estimate.unit].factor
    return found


def force_of_reading(
    M: Array, unbiased: Array, higher: Mapping[str, float], sensor: Sensor, g: float
) -> Array:
    """f of ``unbiased = M f + h(f)``, (n, k), by fixed-point iteration from ``f = unbiased``.

    Args:
        M: sensitivity, (k, 3).
        unbiased: readings less the bias, SI, (n, k).
        higher: terms of h as ``higher_order_terms`` gives them.
        sensor: with two axes, the third component follows from |f| = g.
        g: m/s2.
    """
    inverse = np.asarray(np.linalg.inv(M[:, list(sensor.axis_indices)]), dtype=float)
    if not higher and len(sensor.axes) != 2:
        return product(inverse, unbiased)
    found = np.array(unbiased)
    rows = np.arange(len(found))
    for _ in range(ROUNDS):  # each reading for itself: the same whatever stands beside it
        before = found[rows]
        y = unbiased[rows] - _higher_order(higher, sensor, before, g)
        after = product(inverse, y - _by_missing_axis(M, sensor, before, g))
        found[rows] = after
        rows = rows[(np.abs(after - before) >= 1e-13 * g).any(axis=1)]
        if not len(rows):
            break
    return found


def product(A: Array, v: Array) -> Array:
    """A v for each row of v, (n, k) -> (n, m): summed in one order, so that a row's result does not
    depend on how many others stand beside it, as it may in a product of matrices.
    """
    found = np.empty((len(v), len(A)))
    for i, row in enumerate(A):
        total = row[0] * v[:, 0]
        for j in range(1, len(row)):
            total += row[j] * v[:, j]
        found[:, i] = total
    return found


def _effect_id(term: str) -> str:
    """Id of the effect behind a parameter such as ``K2_x``."""
    return f"acc_{term[:-2]}"


def _higher_order(higher: Mapping[str, float], sensor: Sensor, f: Array, g: float) -> Array | float:
    """h(f), (n, k)."""
    if not higher:
        return 0.0
    from tiltcal.effects import CATALOGUE
    from tiltcal.effects.base import TermEffect
    from tiltcal.effects.sense import Sense

    sense = Sense.at_rest(sensor, g, _all_axes(f, sensor, g))
    total = np.zeros_like(f)
    for term, value in higher.items():
        effect = CATALOGUE[_effect_id(term)]()
        if isinstance(effect, TermEffect):
            channel, column = effect.term(term[0].lower() + term[1:], sense)
            total[:, channel] += value * column
    return total


def _all_axes(f: Array, sensor: Sensor, g: float) -> Array:
    """Forces along all three body axes, (n, 3): a missing one follows from |f| = g, positive."""
    full = np.zeros((len(f), 3))
    full[:, list(sensor.axis_indices)] = f
    if f.shape[1] == 2:
        (missing,) = set(range(3)) - set(sensor.axis_indices)
        full[:, missing] = np.sqrt(np.maximum(g * g - (f * f).sum(axis=1), 0.0))
    return full


def _by_missing_axis(M: Array, sensor: Sensor, f: Array, g: float) -> Array | float:
    """What the force along a missing axis adds to the readings, (n, k); it is taken from the
    last f.
    """
    rows = list(sensor.axis_indices)
    if len(rows) != 2 or not sensor.is_accelerometer:
        return 0.0
    (missing,) = set(range(3)) - set(rows)
    return np.outer(_all_axes(f, sensor, g)[:, missing], M[:, missing])
