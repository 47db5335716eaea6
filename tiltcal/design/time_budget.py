"""The table time of a sequence of poses, and which poses are allowed."""

from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import DEG

SHORTEST, LONGEST = 5.0, 60.0  # s, of a dwell unless stated
ROUNDING = 1e-13  # of the budget: sums of some hundred numbers are not known better


@dataclass(frozen=True)
class Clock:
    """Speed and limits of a table.

    All axes move at once, each at ``rate``; a move takes as long as its longest axis, then the pose
    settles, then it is read. The ramps of the drive are inside the settling. The first move starts
    from all axes at zero.

    Args:
        budget: s of table time, from the first move to the last reading.
        rate: rad/s.
        settle: s after each move.
        shortest, longest: s of a dwell.
        limits: (least, largest) angle of each axis, rad; None where it turns without end.
        step: rad, angles are its multiples; 0: any angle.
    """

    budget: float
    rate: float = 20 * DEG
    settle: float = 5.0
    shortest: float = SHORTEST
    longest: float = LONGEST
    limits: tuple[tuple[float, float] | None, ...] = (None, None)
    step: float = 0.0

    def __post_init__(self) -> None:
        for name, value, low in (
            ("rate", self.rate, 0.0),
            ("shortest dwell", self.shortest, 0.0),
            ("budget", self.budget, 0.0),
        ):
            if not (np.isfinite(value) and value > low):
                raise TiltcalError(
                    f"design, {name}", found=f"{value:g}", need="a positive number", do="correct it"
                )
        if not (np.isfinite(self.settle) and self.settle >= 0):
            raise TiltcalError(
                "design, settling", found=f"{self.settle:g} s", need="0 or more", do="correct it"
            )
        if self.longest < self.shortest:
            raise TiltcalError(
                "design, dwell",
                found=f"longest {self.longest:g} s, shortest {self.shortest:g} s",
                need="longest >= shortest",
                do="exchange them",
            )
        for pair in self.limits:
            if pair is not None and not pair[0] <= 0 <= pair[1]:
                low, high = (p / DEG for p in pair)
                raise TiltcalError(
                    "design, allowed angles",
                    found=f"{low:g} to {high:g} deg",
                    need="a range that includes 0, where the table starts",
                    do="count the angles from the start",
                )

    def moves(self, angles: Array) -> Array:
        """Seconds of the move to each pose, (..., n). angles: rad, (..., n, axes)."""
        start = np.zeros_like(angles[..., :1, :])
        return np.asarray(np.abs(np.diff(angles, axis=-2, prepend=start)).max(axis=-1) / self.rate)

    def middles(self, angles: Array, dwell: Array) -> Array:
        """Time of the middle of each dwell, s, (..., n)."""
        return np.asarray(np.cumsum(self.moves(angles) + self.settle + dwell, axis=-1) - dwell / 2)

    def total(self, angles: Array, dwell: Array) -> float:
        """Table time of a sequence, s.

        Args:
            angles: rad, (n, axes).
            dwell: s, (n,).
        """
        return float(self.moves(angles).sum() + self.settle * len(angles) + dwell.sum())

    def shortened(self, angles: Array, dwell: Array) -> Array:
        """Dwells of a sequence that fills the budget, s, the longest of them so much shorter that
        rounding exceeds it nowhere, (n,).

        Args:
            angles: rad, (n, axes).
            dwell: s, (n,).
        """
        found, excess = np.array(dwell, dtype=float), self.total(angles, dwell) - self.budget
        if len(found) and 0 < excess < ROUNDING * self.budget:
            found[np.argmax(found)] -= excess + ROUNDING * self.budget
        return found

    def spare(self, angles: Array) -> Array:
        """Time left for reading when every dwell has its shortest length, s, (...).

        Args:
            angles: rad, (n, axes).
        """
        n = angles.shape[-2]
        return np.asarray(
            self.budget - self.moves(angles).sum(axis=-1) - n * (self.settle + self.shortest)
        )

    def inside(self, angles: Array) -> Array:
        """Angles brought within the limits and onto the steps, (n, axes). angles: rad."""
        found = np.array(angles, dtype=float)
        if self.step > 0:
            found = np.round(found / self.step) * self.step
        for k, pair in enumerate(self.limits):
            if pair is not None:
                grid = self.step if self.step > 0 else 1e-12
                found[:, k] = np.clip(
                    found[:, k],
                    np.ceil(pair[0] / grid - 1e-9) * grid,
                    np.floor(pair[1] / grid + 1e-9) * grid,
                )
        return found


def unwound(angles: Array, limits: tuple[tuple[float, float] | None, ...]) -> Array:
    """The same poses with each axis going the short way round from pose to pose, where it turns
    without end; (n, axes).

    Args:
        angles, limits: rad.
    """
    found = np.array(angles, dtype=float)
    for k, pair in enumerate(limits):
        if pair is None and len(found):
            found[:, k] = np.unwrap(np.concatenate([[0.0], found[:, k]]))[1:]
    return found
