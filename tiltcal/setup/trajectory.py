"""Motion as frozen records: a Jet (angle, rate, acceleration), a Drive (commanded or read), a
Motion (true).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np
import numpy.typing as npt

from tiltcal.core.arrays import Array, Index


@dataclass(frozen=True)
class Jet:
    """An angle (or length) with its first two time derivatives; arrays of shape (n,), or numbers
    when constant.
    """

    x: Array | float
    v: Array | float = 0.0
    a: Array | float = 0.0

    @cached_property
    def cos_sin(self) -> tuple[Array | float, Array | float]:
        """Cosine and sine of the angle, kept: one axis is turned about many times. (n,) each, or
        numbers.
        """
        return np.cos(self.x), np.sin(self.x)

    def __add__(self, other: "Jet") -> "Jet":
        return Jet(self.x + other.x, self.v + other.v, self.a + other.a)

    def __sub__(self, other: "Jet") -> "Jet":
        return Jet(self.x - other.x, self.v - other.v, self.a - other.a)

    def scaled(self, k: float) -> "Jet":
        """``k`` times the jet."""
        return Jet(k * self.x, k * self.v, k * self.a)

    def times(self, other: "Jet") -> "Jet":
        """The product of both with its derivatives."""
        return Jet(
            self.x * other.x,
            self.v * other.x + self.x * other.v,
            self.a * other.x + 2 * self.v * other.v + self.x * other.a,
        )

    def harmonic(self, n: float, c: float, s: float) -> "Jet":
        """``c cos(n x) + s sin(n x)`` with its derivatives by the chain rule."""
        cos, sin = np.cos(n * self.x), np.sin(n * self.x)
        value = c * cos + s * sin
        slope = n * (s * cos - c * sin)
        return Jet(value, slope * self.v, slope * self.a - n * n * value * self.v * self.v)

    @property
    def constant(self) -> bool:
        """Whether it is one number that never moves."""
        return (
            all(np.ndim(part) == 0 for part in (self.x, self.v, self.a))
            and self.v == 0
            and self.a == 0
        )


def sampled_jet(time: Array, x: Array) -> Jet:
    """A jet of a slowly varying quantity known at samples only, by finite differences.

    Args:
        time, x: (n,).
        time: s.
    """
    if len(time) < 3 or np.ptp(x) == 0:
        return Jet(x, np.zeros_like(x), np.zeros_like(x))
    v = np.gradient(x, time)
    return Jet(x, v, np.gradient(v, time))


@dataclass(frozen=True)
class Attitude:
    """Prescribed attitude of a hand-held body.

    Args:
        R_wb: body to world, (n, 3, 3).
        rate: angular rate in the body frame, rad/s, (n, 3).
        acceleration: its derivative, rad/s2, (n, 3).
    """

    R_wb: Array
    rate: Array
    acceleration: Array


@dataclass(frozen=True)
class Drive:
    """Demand to the table, or its readout, at given times.

    Args:
        time: s, (n,).
        axes: readout of each table axis as a jet of shape (n,), rad.
        start: the first stamp of the recording, s.
        temperature: degC, (n,).
        reference_temperature: T0, the mean of the temperature column, degC.
        stop: number of the stop of each row, (n,), -1 while moving.
        mounts: (first row, R_mount) of each mounting, in order.
        attitude: of a hand-held body; None on a table.
        known: rows where the readout is known, (n,) bool.
        structure: what a run by time steps found: deviation of an axis from its readout, and
            deflections of the structure's own joints, by name.
        following_error: of a run by time steps whose readout is the command: each motor less what
            it was asked for, the part of ``structure`` that an encoder reads too.
        realised: addresses of the effects that the readout or ``structure`` already includes: the
            algebra leaves them out.
        standstills: function that returns when each standstill began and ended; None: with the
            first and the last row of a stop.
        rows_apart: whether the rows are no course in time, as where many rigs are stepped together
            or the next row is not known yet: each has its own motion alone.
    """

    time: Array
    axes: Mapping[str, Jet]
    start: float
    temperature: Array
    reference_temperature: float
    stop: Index
    mounts: tuple[tuple[int, Array], ...] = ((0, np.eye(3)),)
    attitude: Attitude | None = None
    known: npt.NDArray[np.bool_] = field(default_factory=lambda: np.ones(0, bool))
    structure: Mapping[str, Jet] = field(default_factory=dict)
    following_error: Mapping[str, Jet] = field(default_factory=dict)
    realised: tuple[str, ...] = ()
    standstills: "Callable[[], Standstills] | None" = None
    rows_apart: bool = False

    @property
    def elapsed(self) -> Array:
        """Time since the first stamp, s, (n,)."""
        return self.time - self.start


@dataclass(frozen=True)
class Standstills:
    """When each standstill began and ended, s, (m,), in order; a recording that begins amid a move
    follows a standstill long ago.
    """

    begin: Array
    end: Array

    @classmethod
    def at(
        cls, standstills: "Callable[[], Standstills] | None", time: Array, stop: Index
    ) -> "Standstills":
        """What ``standstills`` returns, or else the rows of each stop.

        Args:
            standstills: see ``Drive``.
            time: s, (n,).
            stop: number of the stop of each row, -1 while moving, (n,).
        """
        return cls.of_rows(time, stop) if standstills is None else standstills()

    @classmethod
    def of_rows(cls, time: Array, stop: Index) -> "Standstills":
        """From the first row of each stop to its last.

        Args:
            time: s, (n,).
            stop: number of the stop of each row, -1 while moving, (n,).
        """
        first = np.flatnonzero((stop >= 0) & (np.concatenate([[-1], stop[:-1]]) != stop))
        last = np.flatnonzero((stop >= 0) & (np.concatenate([stop[1:], [-1]]) != stop))
        return cls(time[first], time[last]).led_in(bool(len(stop)) and bool(stop[0] < 0))

    def led_in(self, moving: bool) -> "Standstills":
        """With a standstill long ago where the recording begins amid a move."""
        return (
            Standstills(*(np.concatenate([[-np.inf], side]) for side in (self.begin, self.end)))
            if moving
            else self
        )

    def contains(self, time: Array) -> npt.NDArray[np.bool_]:
        """Whether the table stands still, (n,). time: s, (n,)."""
        at = np.searchsorted(self.begin, time, side="right") - 1
        return (
            (at >= 0) & (time <= self.end[np.maximum(at, 0)])
            if len(self.end)
            else np.zeros(len(time), bool)
        )

    def since(self, time: Array) -> Array:
        """Time since the last move ended, s, (n,); 0 while moving."""
        there = self.contains(time)
        at = np.searchsorted(self.begin, time[there], side="right") - 1
        found = np.zeros(len(time))
        found[there] = time[there] - self.begin[at]
        return found

    def since_start(self, time: Array) -> Array:
        """Time since the last move began, s, (n,); 0 before the first."""
        at = np.searchsorted(self.end, time) - 1
        began = self.end[np.maximum(at, 0)] if len(self.end) else np.zeros(len(time))
        return np.where((at >= 0) & np.isfinite(began), time - began, 0.0)

    def moves(self, time: Array) -> Array:
        """How many moves have begun, (n,). time: s."""
        return np.searchsorted(self.end, time).astype(float)


class Course(Protocol):
    """Whatever gives the table's motion at any time: a sequence, or a replayed readout."""

    @property
    def times(self) -> tuple[float, float]:
        """First and last instant, s."""

    def drive(self, time: Array) -> Drive:
        """The drive at these times, (n,). time: s."""


@dataclass(frozen=True)
class Motion:
    """The true motion of the instrument.

    Args:
        time: s, (n,).
        force: specific force at the sensors in the body frame, m/s2, (n, 3).
        rate: angular rate against inertial space in the body frame, rad/s, (n, 3).
        up, north: the world's up and table North in the body frame, (n, 3).
        angular_acceleration: rad/s2, (n, 3).
    """

    time: Array
    force: Array
    rate: Array
    up: Array
    north: Array
    angular_acceleration: Array
