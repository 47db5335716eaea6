"""Axes of many rigs that follow demanded rates, as far as their accelerations allow."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.core.errors import TiltcalError, one_of
from tiltcal.setup.tables import Table

Ranges = Mapping[str, tuple[float, float]]
"""Lowest and highest readout by axis."""


@dataclass(frozen=True)
class AxisLimits:
    """What the axes of a rig can do, in rad, or m of those that slide.

    Args:
        rate, acceleration: largest, 1/s, 1/s2, (axes,).
        low, high: of the readout, (axes,).
    """

    rate: Array
    acceleration: Array
    low: Array
    high: Array

    @classmethod
    def stated(
        cls,
        table: Table,
        rate: Mapping[str, float],
        acceleration: Mapping[str, float],
        limits: Mapping[str, Ranges | None],
    ) -> "AxisLimits":
        """In the unit of the readout, deg or mm. Axes that turn go on without end where they have
        no limits.

        Args:
            table: whose axes.
            rate, acceleration: by unit, 1/s and 1/s2. limits: by unit and axis.

        Raises:
            TiltcalError: an axis that there is not, one that slides without limits, or a limit that
                leaves no room about zero.
        """
        for unit in ("deg", "mm"):
            _require_positive(f"rate_{unit}_s", rate[unit])
            _require_positive(f"acceleration_{unit}_s2", acceleration[unit])
        stated = dict(pair for unit in limits for pair in _stated(table, unit, limits[unit]))
        for name in sorted(table.sliding - stated.keys()):
            need = "its lowest and highest place"
            raise _refused("limits_mm", f"no axis {name}, which slides", need)
        units = [table.unit(name) for name in table.axis_names]
        sizes = np.array([table.size(name) for name in table.axis_names])
        ends = np.array([stated.get(name, (-np.inf, np.inf)) for name in table.axis_names])
        fastest, hardest = (np.array([of[u] for u in units]) for of in (rate, acceleration))
        return cls(fastest * sizes, hardest * sizes, *(ends * sizes[:, None]).T)


def _require_positive(word: str, value: float) -> None:
    if not 0 < value < np.inf:
        raise _refused(word, f"{value:g}", "a positive number")


def _stated(
    table: Table, unit: str, ranges: Ranges | None
) -> Iterator[tuple[str, tuple[float, float]]]:
    """Axes with their limits, where these leave room about zero."""
    names = [name for name in table.axis_names if table.unit(name) == unit]
    for axis, (least, most) in (ranges or {}).items():
        name = one_of(axis, names, f"environment, limits_{unit}", "axis")
        if not least <= 0 <= most or least == most:
            words = f"{least:g} to {most:g}"
            raise _refused(f"limits_{unit} of {name}", words, "low <= 0 <= high")
        yield name, (least, most)


@dataclass
class AxisMotion:
    """Where the axes of many rigs are, with exact derivatives: accelerations are linear within a
    step.

    Args:
        limits: of the axes.
        step_s: of a demand.
        place, rate, acceleration: now, rad, rad/s and rad/s2, m, m/s and m/s2 of axes that slide,
            (rigs, axes).
    """

    limits: AxisLimits
    step_s: float
    place: Array
    rate: Array
    acceleration: Array

    @classmethod
    def at_rest(cls, limits: AxisLimits, step_s: float, count: int) -> "AxisMotion":
        """All axes at zero."""
        shape = (count, len(limits.low))
        return cls(limits, step_s, np.zeros(shape), np.zeros(shape), np.zeros(shape))

    def restart(self, rows: Mask) -> None:
        """These rigs rest at zero. rows: (rigs,)."""
        for part in (self.place, self.rate, self.acceleration):
            part[rows] = 0.0

    def move(self, rate: Array, rows: Mask) -> None:
        """One step of these rigs towards demanded rates, rad/s or m/s, (rigs, axes).

        The rate is reached in two steps, or as fast as the acceleration allows; before a limit
        an axis brakes.
        """
        h, x, v, a = self.step_s, self.place, self.rate, self.acceleration
        most = self.limits.acceleration
        demand = np.clip(rate, *self._safe())
        next_a = np.clip((demand - v) / h - a / 2, -most, most)
        live = rows[:, None]
        self.place = np.where(live, x + h * (v + h * (2 * a + next_a) / 6), x)
        self.rate = np.where(live, v + h * (a + next_a) / 2, v)
        self.acceleration = np.where(live, next_a, a)

    def _safe(self) -> tuple[Array, Array]:
        """Lowest and highest rate from which each axis stops before its limits, rad/s or m/s:
        with half the acceleration, and two steps to begin.
        """
        limits = self.limits
        ahead = 2 * self.step_s * np.abs(self.rate) + 2 * limits.acceleration * self.step_s**2
        above = np.maximum(limits.high - self.place - ahead, 0.0)
        below = np.maximum(self.place - limits.low - ahead, 0.0)
        fastest = (np.sqrt(limits.acceleration * room) for room in (below, above))
        lowest, highest = (np.minimum(rate, limits.rate) for rate in fastest)
        return -lowest, highest


def _refused(word: str, found: str, need: str) -> TiltcalError:
    return TiltcalError(f"environment, {word}", found=found, need=need, do="correct it")
