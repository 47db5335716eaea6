"""What the second author's files share: soft corners, shapes drawn from ranges, curves of the
history.
"""

from collections.abc import Callable

import numpy as np

from blind.laboratory import Lab, Sensor
from blind.memory import leaky
from blind.spec import UG, Column, Shape, Spec, added, per_axis, unlisted_effect
from blind.world import Past

ShapesOf = Callable[[np.random.Generator, Lab], list[Shape]]
PLACE = ("table_outer", "table_middle", "table_inner")
STRENGTH = (1.9, 3.8)  # log10 of the non-centrality: nothing that shouts


def wrapped(x: np.ndarray) -> np.ndarray:
    """An angle in (-pi, pi]. x: rad."""
    return np.angle(np.exp(1j * x))


def hinge(x: np.ndarray, soft: float) -> np.ndarray:
    """0 below zero, x above, with a corner as wide as ``soft``."""
    return soft * np.logaddexp(0.0, x / soft)


def drawn(**ranges: tuple[float, float]) -> ShapesOf:
    """Shapes with every number uniform in its range."""
    return lambda rng, lab: [{k: float(rng.uniform(*r)) for k, r in ranges.items()}]


def inside(rng: np.random.Generator, lab: Lab, k: int) -> float:
    """An angle (rad) in the middle of where an axis has been."""
    angles = lab.track.angles(np.linspace(0, lab.track.end_s, 400))[:, k]
    return float(np.quantile(angles, rng.uniform(0.2, 0.8)))


def per_axis_effect(
    sensor: Sensor,
    stem: str,
    size: float,
    column: Column,
    where: tuple[str, ...],
    shapes: ShapesOf = lambda rng, lab: [{}],
    suffix: str = "ug",
    unit: float = UG,
    later: str = "same",
) -> Spec:
    """An additive term of one axis of a sensor. size: the largest believable, in ``unit``."""
    return unlisted_effect(
        f"s_{stem}",
        per_axis(stem, sensor.axes, suffix),
        unit,
        size,
        added(sensor.name, column),
        where,
        (sensor.name,),
        shapes=shapes,
        later=later,
        strength=STRENGTH,
    )


# --------------------------------------------------------------------------------------------------
# the history on the grid of the Past: (m,) each


def rates(past: Past) -> np.ndarray:
    """Rate of every axis of the table, rad/s: (m, axes)."""
    return past.kept("rates", lambda: np.gradient(past.state.angles, past.STEP_S, axis=0))


def total_rate(past: Past) -> np.ndarray:
    """How fast the table turns, all axes together, rad/s."""
    return np.sqrt((rates(past) ** 2).sum(1))


def way(past: Past) -> np.ndarray:
    """Way of all axes since the start, both senses counted, rad."""
    return np.cumsum(np.abs(rates(past)).sum(1)) * past.STEP_S


def heat(past: Past, tau_s: float) -> np.ndarray:
    """Energy of friction that has not yet flown off, about 1 after steady turning at 1 rad/s."""
    return leaky(total_rate(past) ** 2, tau_s, past.STEP_S)


def by_dwell(past: Past, values: np.ndarray, soft_s: float = 0.3) -> np.ndarray:
    """A value for every dwell, taken up softly when the move to it begins. values: (dwells,)."""
    begun = past.lab.track.since_move(past.grid)[1]
    return leaky(values[np.clip(begun, 0, len(values) - 1)], soft_s, past.STEP_S)
