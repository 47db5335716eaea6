"""What a concealed effect is to the generator: names, plausible sizes, a textbook form and forms
that are not.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from blind.laboratory import Lab
from blind.rotations import ARCSEC, DEG, G0
from blind.world import Past, Physics, State

UG = 1e-6 * G0
DEG_H = DEG / 3600
Shape = dict[str, Any]


def one_shape(rng: np.random.Generator, lab: Lab) -> list[Shape]:
    """Nothing but its size to choose."""
    return [{}]


@dataclass(frozen=True)
class Spec:
    """One effect in one laboratory.

    Attributes:
        names: parameter names with unit suffix.
        unit: SI value of one unit of each.
        plausible: largest size that a metrologist would believe, in those units.
        physics: (values in SI, shape) -> Physics; linear or nearly so in the values.
        shapes: (rng, lab) -> textbook shapes: one is drawn, a grid of them stands for the effect as
            a rival.
        odd: (rng, lab) -> a non-textbook shape; None where there is none.
        together: all parameters are drawn; else one of them (one axis).
        later: what another recording sees of it: same, after, none.
        where: coordinates that locate it.
        sensors: whose readings it changes.
    """

    id: str
    stage: str
    names: tuple[str, ...]
    unit: float
    plausible: float
    physics: Callable[[np.ndarray, Shape], Physics]
    where: tuple[str, ...]
    sensors: tuple[str, ...] = ()
    shapes: Callable[[np.random.Generator, Lab], list[Shape]] = one_shape
    odd: Callable[[np.random.Generator, Lab], Shape] | None = None
    together: bool = False
    later: str = "same"
    drawn: bool = True  # else a rival only
    listed: bool = True
    extra: Callable[[Shape], dict[str, float]] = field(default=lambda shape: {})
    axes: tuple[str, ...] | None = None
    strength: tuple[float, float] = (1.7, 5.0)  # log10 of the non-centrality that is asked for


def per_axis(stem: str, axes: tuple[str, ...], suffix: str) -> tuple[str, ...]:
    """k2_x_ug_g2, k2_y_ug_g2, ..."""
    return tuple(f"{stem}_{axis}_{suffix}" for axis in axes)


def on_axes(p: np.ndarray, columns: Callable[[int], np.ndarray]) -> np.ndarray:
    """Additive term: each axis its own coefficient times its own column; columns of zero size are
    not computed.
    """
    n = len(columns(int(np.argmax(np.abs(p)))))
    return np.stack([p[i] * columns(i) if p[i] else np.zeros(n) for i in range(len(p))], 1)


Column = Callable[[Past, State, int, Shape], np.ndarray]


def added(sensor: str, column: Column) -> Callable[[np.ndarray, Shape], Physics]:
    """A term per axis: coefficient times column(past, state, axis, shape)."""

    def physics(p: np.ndarray, shape: Shape) -> Physics:
        return Physics(
            sense=lambda past, s: {sensor: on_axes(p, lambda i: column(past, s, i, shape))}
        )

    return physics


def unlisted_effect(
    id_: str,
    names: tuple[str, ...],
    unit: float,
    size: float,
    physics: Callable[[np.ndarray, Shape], Physics],
    where: tuple[str, ...],
    sensors: tuple[str, ...] = (),
    **more: Any,
) -> Spec:
    """Physics that no catalogue lists; of a sensor unless ``more`` says otherwise."""
    stage = more.pop("stage", "sensor")
    return Spec(id_, stage, names, unit, size, physics, where, sensors, listed=False, **more)


__all__ = [
    "ARCSEC",
    "DEG",
    "DEG_H",
    "G0",
    "UG",
    "Shape",
    "Spec",
    "added",
    "on_axes",
    "one_shape",
    "per_axis",
    "unlisted_effect",
]
