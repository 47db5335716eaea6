"""Axes of many rigs that follow demanded rates, as far as their accelerations allow."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.core.errors import TiltcalError, one_of
from tiltcal.core.units import DEG


@dataclass(frozen=True)
class AxisLimits:
    """What the axes of a rig can do.

    Args:
        rate, acceleration: largest, rad/s, rad/s2.
        low, high: of the angles, rad, (axes,).
    """

    rate: float
    acceleration: float
    low: Array
    high: Array

    @classmethod
    def stated(
        cls,
        names: tuple[str, ...],
        rate_deg_s: float,
        acceleration_deg_s2: float,
        limits_deg: Mapping[str, tuple[float, float]] | None,
    ) -> "AxisLimits":
        """From deg, deg/s and deg/s2; axes without limits turn without end.

        Raises:
            TiltcalError: an axis that there is not, or a limit that leaves no room about zero.
        """
        for word, value in (
            ("rate_deg_s", rate_deg_s),
            ("acceleration_deg_s2", acceleration_deg_s2),
        ):
            if not 0 < value < np.inf:
                raise _refused(word, f"{value:g}", "a positive number")
        low, high = np.full(len(names), -np.inf), np.full(len(names), np.inf)
        for name, (least, most) in (limits_deg or {}).items():
            k = names.index(one_of(name, names, "environment, limits_deg", "axis"))
            if not least <= 0 <= most or least == most:
                raise _refused(
                    f"limits_deg of {name}", f"{least:g} to {most:g}", "low <= 0 <= high"
                )
            low[k], high[k] = least * DEG, most * DEG
        return cls(rate_deg_s * DEG, acceleration_deg_s2 * DEG, low, high)


@dataclass
class AxisMotion:
    """Angles of many rigs with exact derivatives: accelerations are linear within a step.

    Args:
        limits: of the axes.
        step_s: of a demand.
        angle, rate, acceleration: now, rad, rad/s, rad/s2, (rigs, axes).
    """

    limits: AxisLimits
    step_s: float
    angle: Array
    rate: Array
    acceleration: Array

    @classmethod
    def at_rest(cls, limits: AxisLimits, step_s: float, count: int) -> "AxisMotion":
        """All axes at zero."""
        shape = (count, len(limits.low))
        return cls(limits, step_s, np.zeros(shape), np.zeros(shape), np.zeros(shape))

    def restart(self, rows: Mask) -> None:
        """These rigs rest at zero. rows: (rigs,)."""
        for part in (self.angle, self.rate, self.acceleration):
            part[rows] = 0.0

    def move(self, rate: Array, rows: Mask) -> None:
        """One step of these rigs towards demanded rates, rad/s, (rigs, axes).

        The rate is reached in two steps, or as fast as the acceleration allows; before a limit
        of its angle an axis brakes.
        """
        h, x, v, a = self.step_s, self.angle, self.rate, self.acceleration
        most = self.limits.acceleration
        demand = np.clip(rate, *self._safe())
        next_a = np.clip((demand - v) / h - a / 2, -most, most)
        live = rows[:, None]
        self.angle = np.where(live, x + h * (v + h * (2 * a + next_a) / 6), x)
        self.rate = np.where(live, v + h * (a + next_a) / 2, v)
        self.acceleration = np.where(live, next_a, a)

    def _safe(self) -> tuple[Array, Array]:
        """Lowest and highest rate from which each axis stops before its limits, rad/s: with half
        the acceleration, and two steps to begin.
        """
        limits = self.limits
        ahead = 2 * self.step_s * np.abs(self.rate) + 2 * limits.acceleration * self.step_s**2
        above = np.maximum(limits.high - self.angle - ahead, 0.0)
        below = np.maximum(self.angle - limits.low - ahead, 0.0)
        fastest = (np.sqrt(limits.acceleration * room) for room in (below, above))
        lowest, highest = (np.minimum(rate, limits.rate) for rate in fastest)
        return -lowest, highest


def _refused(word: str, found: str, need: str) -> TiltcalError:
    return TiltcalError(f"environment, {word}", found=found, need=need, do="correct it")
