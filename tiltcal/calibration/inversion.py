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
    f = np.array(unbiased)
    for _ in range(ROUNDS if higher or len(sensor.axes) == 2 else 1):
        before = f
        f = _solve(M, sensor, unbiased - _higher_order(higher, sensor, f, g), f, g)
        if np.max(np.abs(f - before), initial=0.0) < 1e-13 * g:
            break
    return f


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


def _solve(M: Array, sensor: Sensor, y: Array, f: Array, g: float) -> Array:
    """f of ``y = M f``; the contribution of a missing axis is taken from the last f."""
    rows = list(sensor.axis_indices)
    if len(rows) == 2 and sensor.is_accelerometer:
        (missing,) = set(range(3)) - set(rows)
        y = y - np.outer(_all_axes(f, sensor, g)[:, missing], M[:, missing])
    return np.asarray(np.linalg.solve(M[:, rows], y.T).T)
