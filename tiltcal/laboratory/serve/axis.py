"""One axis of a served table: prescribed motion within limits of rate and acceleration."""

from dataclasses import dataclass, field
from math import inf, pi, sqrt
from typing import Literal

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import DEG
from tiltcal.setup.trajectory import Jet

Mode = Literal["off", "position", "rate"]
RATE, ACCELERATION = 100 * DEG, 100 * DEG  # limits of a table that was just switched on


@dataclass(frozen=True)
class Piece:
    """A stretch in which the rate changes smoothly, or stays: it follows u - sin(2 pi u)/(2 pi), so
    that the acceleration begins and ends at zero.

    Args:
        start: s; x, v: there, rad, rad/s; change: of the rate, rad/s; length: s.
    """

    start: float
    x: float
    v: float
    change: float = 0.0
    length: float = 1.0


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
    pieces: list[Piece] = field(default_factory=lambda: [Piece(0.0, 0.0, 0.0)])

    def jet(self, time: Array) -> Jet:
        """Angle, rate and acceleration at these times, none of them past, rad, (n,)."""
        starts = np.array([p.start for p in self.pieces])
        which = np.clip(np.searchsorted(starts, time, side="right") - 1, 0, None)
        names = ("x", "v", "change", "length")
        x, v, change, length = (
            np.array([getattr(p, n) for p in self.pieces])[which] for n in names
        )
        since = time - starts[which]
        u, turn = since / length, 2 * pi * since / length
        return Jet(
            x + v * since + change * length * (u * u / 2 + (np.cos(turn) - 1) / (4 * pi * pi)),
            v + change * (u - np.sin(turn) / (2 * pi)),
            change / length * (1 - np.cos(turn)),
        )

    def at(self, time: float) -> tuple[float, float, float]:
        """Angle, rate and acceleration now, rad."""
        jet = self.jet(np.array([time]))
        return tuple(float(np.asarray(part)[0]) for part in (jet.x, jet.v, jet.a))  # type: ignore[return-value]

    def moving(self, time: float) -> bool:
        """Whether it moves, or will without a further demand. time: s."""
        return self.pieces[-1].v != 0 or time < self.pieces[-1].start

    def stop(self, time: float) -> None:
        """Come to rest as fast as the limit allows. time: s."""
        self._follow(time, 0.0)

    def turn(self, time: float, rate: float) -> None:
        """Reach a rate and keep it, rad/s."""
        self.demand = rate
        if not self.stuck:
            self._follow(time, max(-self.rate, min(self.rate, rate)))

    def go(self, time: float, angle: float) -> None:
        """Go to an angle, rad, by a smooth trapezoid of the rate, and rest there."""
        self.demand = angle
        if self.stuck:
            return
        self._follow(time, 0.0)
        last = self.pieces[-1]
        way = angle - last.x
        if way == 0:
            return
        sign, mean = (1.0 if way > 0 else -1.0), self.acceleration / 2
        peak = min(self.rate, sqrt(mean * abs(way)))
        ramp = peak / mean
        self._extend(ramp, sign * peak)
        self._extend(abs(way) / peak - ramp, 0.0)
        self._extend(ramp, -sign * peak)
        self.pieces[-1] = Piece(self.pieces[-1].start, angle, 0.0)

    def seize(self, time: float, stuck: bool) -> None:
        """Stick where it is, or come free. time: s."""
        if stuck:
            self.hold(time, self.at(time)[0])
        self.stuck = stuck

    def hold(self, time: float, angle: float) -> None:
        """Rest at an angle, rad, from an instant on, s."""
        self.pieces = [Piece(time, angle, 0.0)]

    def _follow(self, time: float, rate: float) -> None:
        x, v, _ = self.at(time)
        self.pieces = [Piece(time, x, v)]
        if v != rate:
            self._extend(2 * abs(rate - v) / self.acceleration, rate - v)
            last = self.pieces[-1]
            self.pieces[-1] = Piece(last.start, last.x, rate)

    def _extend(self, length: float, change: float) -> None:
        """Change the rate from where the last piece begins; then keep it."""
        if length <= 0:
            return
        last = self.pieces[-1]
        self.pieces[-1] = Piece(last.start, last.x, last.v, change, length)
        x = last.x + (last.v + change / 2) * length
        self.pieces.append(Piece(last.start + length, x, last.v + change))
