"""The table time of a sequence of poses, and which poses are allowed."""

from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import DEG

Limits = tuple[tuple[float, float] | None, ...]
"""Least and largest angle of each axis, rad; None where it turns without end."""
SHORTEST, LONGEST = 5.0, 60.0  # s, of a dwell unless stated
SAME = 1 * DEG  # closer poses are one: what a place adds to a mean is the same in both
NUDGE = 1.05  # of that: a move that is certainly one
ROUNDING = 1e-13  # of the budget: sums of some hundred numbers are not known better


@dataclass(frozen=True)
class Clock:
    """Speed and limits of a table.

    All axes move at once, each at ``rate``; a move takes as long as its longest axis, then the pose
    settles, then it is read. The ramps of the drive are inside the settling.

    Args:
        budget: s of table time, from the first move to the last reading.
        rate: rad/s.
        settle: s after each move.
        shortest, longest: s of a dwell.
        limits: (least, largest) angle of each axis, rad; None where it turns without end.
        step: rad, angles are its multiples; 0: any angle.
        start: angle of each axis before the first move, rad; not given: zero, or the allowed angle
            nearest to it.
        returns: whether the budget has the way back to the start.
    """

    budget: float
    rate: float = 20 * DEG
    settle: float = 5.0
    shortest: float = SHORTEST
    longest: float = LONGEST
    limits: Limits = (None, None)
    step: float = 0.0
    start: tuple[float, ...] | None = None
    returns: bool = False

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

    @property
    def origin(self) -> Array:
        """Angles before the first move, rad, (axes,)."""
        if self.start is not None:
            return np.array(self.start)
        return np.array([0.0 if pair is None else np.clip(0.0, *pair) for pair in self.limits])

    @property
    def nudge(self) -> float:
        """The least move to another pose, with a margin for rounding, rad."""
        return max(self.step, NUDGE * SAME)

    def moves(self, angles: Array) -> Array:
        """Seconds of the move to each pose, (..., n). angles: rad, (..., n, axes)."""
        start = np.broadcast_to(self.origin, angles[..., :1, :].shape)
        return np.asarray(np.abs(np.diff(angles, axis=-2, prepend=start)).max(axis=-1) / self.rate)

    def way_back(self, angles: Array) -> Array:
        """Seconds from the last pose back to the start, where the budget has them, (...).

        Args:
            angles: rad, (..., n, axes).
        """
        if not self.returns or angles.shape[-2] == 0:
            return np.zeros(angles.shape[:-2])
        return np.asarray(np.abs(angles[..., -1, :] - self.origin).max(axis=-1) / self.rate)

    def middles(self, angles: Array, dwell: Array) -> Array:
        """Time of the middle of each dwell, s, (..., n)."""
        return np.asarray(np.cumsum(self.moves(angles) + self.settle + dwell, axis=-1) - dwell / 2)

    def total(self, angles: Array, dwell: Array) -> float:
        """Table time of a sequence, s.

        Args:
            angles: rad, (n, axes).
            dwell: s, (n,).
        """
        moving = float(self.moves(angles).sum() + self.way_back(angles))
        return moving + self.settle * len(angles) + float(dwell.sum())

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
        moving = self.moves(angles).sum(axis=-1) + self.way_back(angles)
        return np.asarray(self.budget - moving - angles.shape[-2] * (self.settle + self.shortest))

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


def unwound(angles: Array, limits: Limits, origin: Array | None = None) -> Array:
    """The same poses with each axis going the short way round from pose to pose, where it turns
    without end; (n, axes).

    Args:
        angles, limits: rad.
        origin: angles before the first move, rad, (axes,); zero if not given.
    """
    found = np.array(angles, dtype=float)
    start = np.zeros(len(limits)) if origin is None else origin
    for k, pair in enumerate(limits):
        if pair is None and len(found):
            found[:, k] = np.unwrap(np.concatenate([start[k : k + 1], found[:, k]]))[1:]
    return found
