"""The Schedule that a sequence makes: smooth angles with exact rates and accelerations."""

from dataclasses import dataclass, field
from itertools import pairwise
from math import pi
from typing import Literal

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.core.frames import parse_mount
from tiltcal.setup.sequence import Climate
from tiltcal.setup.trajectory import Attitude, Drive, Jet, Rests

RAMP = 0.4  # s, the time a drive takes to reach its rate or to stop


@dataclass(frozen=True)
class Leg:
    """A stretch of the schedule: from angles ``q0``, along ``dq`` with a time law.

    Args:
        t0, t1: s.
        q0, dq: rad, (axes,); hand-held: rotation vector about a body axis from attitude ``R0``.
        law: ``rest``, ``ramp`` (smooth start, constant rate, smooth stop) or ``swing``.
        ramp: s, of the start and of the stop.
        frequency: Hz, of a swing.
    """

    t0: float
    t1: float
    q0: Array
    dq: Array
    law: Literal["rest", "ramp", "swing"] = "rest"
    ramp: float = RAMP
    frequency: float = 0.0
    R0: Array | None = None
    mount: str = "identity"
    label: str | None = None
    stop: int = -1

    def progress(self, time: Array) -> Jet:
        """Share of ``dq`` covered, with its derivatives. time: s, (n,)."""
        t = time - self.t0
        if self.law == "rest":
            zero = np.zeros_like(t)
            return Jet(zero, zero, zero)
        return (
            _swing(t, self.t1 - self.t0, self.frequency)
            if self.law == "swing"
            else _ramp(t, self.t1 - self.t0, self.ramp)
        )


def _ramp(t: Array, duration: float, ramp: float) -> Jet:
    """0 -> 1: the rate rises as u - sin(2 pi u)/(2 pi), stays, and falls alike: continuous
    acceleration.
    """
    w = 1.0 / (duration - ramp)
    late = t > duration / 2
    u = np.clip(np.where(late, duration - t, t) / ramp, 0.0, None)
    rising = u < 1
    r = np.minimum(u, 1.0)
    s = w * ramp * np.where(rising, r * r / 2 + (np.cos(2 * pi * r) - 1) / (4 * pi * pi), u - 0.5)
    v = w * np.where(rising, r - np.sin(2 * pi * r) / (2 * pi), 1.0)
    a = w / ramp * np.where(rising, 1 - np.cos(2 * pi * r), 0.0)
    return Jet(np.where(late, 1 - s, s), v, np.where(late, -a, a))


def _swing(t: Array, duration: float, frequency: float) -> Jet:
    """A sine under a sin^2 envelope that starts and ends at rest."""
    p, q = pi / duration, 2 * pi * frequency
    e, ev, ea = np.sin(p * t) ** 2, p * np.sin(2 * p * t), 2 * p * p * np.cos(2 * p * t)
    s, sv, sa = np.sin(q * t), q * np.cos(q * t), -q * q * np.sin(q * t)
    return Jet(e * s, ev * s + e * sv, ea * s + 2 * ev * sv + e * sa)


@dataclass(frozen=True)
class Schedule:
    """Angles, rates and accelerations of a whole sequence at any time: a Course.

    Args:
        legs: in order, without gaps.
        axes: names of the table's axes; empty when hand-held.
        climate: temperature against time.
    """

    legs: tuple[Leg, ...]
    axes: tuple[str, ...]
    climate: Climate = field(default_factory=Climate)

    @property
    def times(self) -> tuple[float, float]:
        """First and last instant, s."""
        return self.legs[0].t0, self.legs[-1].t1

    def leg_of(self, time: Array) -> Index:
        """Number of the leg at each time, (n,). time: s."""
        starts = np.array([leg.t0 for leg in self.legs])
        return np.clip(np.searchsorted(starts, time, side="right") - 1, 0, len(self.legs) - 1)

    def labels(self, time: Array) -> "np.ndarray[tuple[int], np.dtype[np.object_]]":
        """The operator's label at each time, (n,) of str or None."""
        words = np.array([leg.label for leg in self.legs], dtype=object)
        return words[self.leg_of(time)]

    def mountings(self, time: Array) -> tuple[tuple[int, str], ...]:
        """(first row, mount) of each mounting. time: s."""
        which = self.leg_of(time)
        texts = [self.legs[0].mount] + [leg.mount for leg in self.legs[1:]]
        found: list[tuple[int, str]] = []
        for row in [0, *(np.flatnonzero(np.diff(which)) + 1).tolist()]:
            text = texts[int(which[row])]
            if not found or found[-1][1] != text:
                found.append((int(row), text))
        return tuple(found)

    def rests(self) -> Rests:
        """When each rest begins and ends."""
        begin = {leg.stop: leg.t0 for leg in reversed(self.legs) if leg.stop >= 0}
        end = {leg.stop: leg.t1 for leg in self.legs if leg.stop >= 0}
        if self.legs[-1].stop >= 0:
            end[self.legs[-1].stop] = np.inf
        found = Rests(*(np.array([side[k] for k in sorted(begin)]) for side in (begin, end)))
        return found.led_in(self.legs[0].stop < 0)

    def drive(self, time: Array) -> Drive:
        """The drive at these times (before the first and after the last instant it rests). time: s,
        (n,).
        """
        which = self.leg_of(time)
        inside = np.clip(time, *self.times)
        edges = [*np.flatnonzero(np.diff(which, prepend=-1)).tolist(), len(time)]
        q, v, a = (np.empty((len(time), len(self.legs[0].q0))) for _ in range(3))
        R = np.empty((len(time), 3, 3)) if not self.axes else None
        for start, end in pairwise(edges):
            leg = self.legs[which[start]]
            part = leg.progress(inside[start:end])
            q[start:end] = leg.q0 + np.outer(part.x, leg.dq)
            v[start:end], a[start:end] = np.outer(part.v, leg.dq), np.outer(part.a, leg.dq)
            if R is not None and leg.R0 is not None:
                R[start:end] = leg.R0 @ rotations(np.outer(part.x, leg.dq))
        stop = np.array([leg.stop for leg in self.legs])[which]
        # a turn about a fixed body axis: rate = dq's rate
        attitude = None if R is None else Attitude(R, v, a)
        return Drive(
            time,
            {name: Jet(q[:, i], v[:, i], a[:, i]) for i, name in enumerate(self.axes)},
            self.times[0],
            self.climate.at(time - self.times[0]),
            self.climate.reference(self.times[1] - self.times[0]),
            stop,
            tuple((row, parse_mount(text)) for row, text in self.mountings(time)),
            attitude,
            np.ones(len(time), bool),
            rests=self.rests,
        )


def rotations(vectors: Array) -> Array:
    """Rotation matrices, (n, 3, 3), of rotation vectors, rad, (n, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(vectors).as_matrix())
