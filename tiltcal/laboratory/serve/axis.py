"""One axis of a served table: prescribed motion within limits of rate and acceleration."""

from dataclasses import dataclass, field
from math import inf, sqrt
from typing import Literal

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import DEG
from tiltcal.setup.trajectory import Jet

Mode = Literal["off", "position", "rate"]
RATE, ACCELERATION = 100 * DEG, 200 * DEG  # limits of a table that was just switched on


@dataclass(frozen=True)
class Piece:
    """A stretch of constant acceleration.

    Args:
        start: s; x, v: there, rad, rad/s; a: rad/s2.
    """

    start: float
    x: float
    v: float
    a: float


@dataclass
class AxisDrive:
    """What an axis is asked to do, and where it is.

    Args:
        mode: off holds still.
        rate, acceleration: largest, rad/s, rad/s2; low, high: limits of the angle, rad.
        stuck: it does not move; slip: true angle minus readout, rad.
        demand: angle or rate that was last asked for, rad, rad/s.
        pieces: of its motion, the last one goes on.
    """

    mode: Mode = "off"
    rate: float = RATE
    acceleration: float = ACCELERATION
    low: float = -inf
    high: float = inf
    stuck: bool = False
    slip: float = 0.0
    demand: float = 0.0
    pieces: list[Piece] = field(default_factory=lambda: [Piece(0.0, 0.0, 0.0, 0.0)])

    def jet(self, time: Array) -> Jet:
        """Angle, rate and acceleration at these times, none of them past, rad, (n,)."""
        starts = np.array([p.start for p in self.pieces])
        which = np.clip(np.searchsorted(starts, time, side="right") - 1, 0, None)
        x, v, a = (np.array([getattr(p, n) for p in self.pieces])[which] for n in ("x", "v", "a"))
        since = time - starts[which]
        return Jet(x + (v + a * since / 2) * since, v + a * since, a)

    def at(self, time: float) -> tuple[float, float, float]:
        """Angle, rate and acceleration now, rad."""
        jet = self.jet(np.array([time]))
        return tuple(float(np.asarray(part)[0]) for part in (jet.x, jet.v, jet.a))  # type: ignore[return-value]

    def moving(self, time: float) -> bool:
        """Whether it moves, or will without a further demand."""
        return self.pieces[-1].v != 0 or time < self.pieces[-1].start

    def stop(self, time: float) -> None:
        """Come to rest as fast as the limit allows."""
        self._follow(time, 0.0)

    def turn(self, time: float, rate: float) -> None:
        """Reach a rate and keep it, rad/s."""
        self.demand = rate
        if not self.stuck:
            self._follow(time, max(-self.rate, min(self.rate, rate)))

    def go(self, time: float, angle: float) -> None:
        """Go to an angle, rad, by a trapezoid of the rate, and rest there."""
        self.demand = angle
        if self.stuck:
            return
        self._follow(time, 0.0)
        last = self.pieces[-1]
        way = angle - last.x
        if way == 0:
            return
        sign, a = (1.0 if way > 0 else -1.0), self.acceleration
        peak = min(self.rate, sqrt(a * abs(way)))
        ramp, cruise = peak / a, abs(way) / peak - peak / a
        for length, push in ((ramp, sign * a), (cruise, 0.0), (ramp, -sign * a)):
            self._extend(length, push)
        self.pieces[-1] = Piece(self.pieces[-1].start, angle, 0.0, 0.0)

    def seize(self, time: float, stuck: bool) -> None:
        """Stick where it is, or come free."""
        if stuck:
            self.pieces = [Piece(time, self.at(time)[0], 0.0, 0.0)]
        self.stuck = stuck

    def _follow(self, time: float, rate: float) -> None:
        x, v, _ = self.at(time)
        self.pieces = [Piece(time, x, v, 0.0)]
        if v != rate:
            self._extend(abs(rate - v) / self.acceleration, np.sign(rate - v) * self.acceleration)
            last = self.pieces[-1]
            self.pieces[-1] = Piece(last.start, last.x, rate, 0.0)

    def _extend(self, length: float, a: float) -> None:
        """Accelerate for a while from where the last piece begins; then go on."""
        if length <= 0:
            return
        last = self.pieces[-1]
        self.pieces[-1] = Piece(last.start, last.x, last.v, a)
        x, v = last.x + (last.v + a * length / 2) * length, last.v + a * length
        self.pieces.append(Piece(last.start + length, x, v, 0.0))
