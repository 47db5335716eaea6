"""One axis of a served table: prescribed motion within limits of rate and acceleration."""

from dataclasses import dataclass, field
from math import inf, pi, sqrt
from typing import Literal

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import DEG, MM
from tiltcal.setup.setup import Rig
from tiltcal.setup.trajectory import Jet

Mode = Literal["off", "position", "rate"]
# limits of a table that was just switched on
RATE, ACCELERATION = 100 * DEG, 100 * DEG
SLIDE_RATE, SLIDE_ACCELERATION = 200 * MM, 500 * MM


@dataclass(frozen=True)
class Piece:
    """A stretch in which the rate changes smoothly, or stays: it follows u - sin(2 pi u)/(2 pi), so
    that the acceleration begins and ends at zero.

    Args:
        start: s.
        x, v: there, rad, rad/s, or m, m/s of an axis that slides.
        change: of the rate.
        length: s.
    """

    start: float
    x: float
    v: float
    change: float = 0.0
    length: float = 1.0


@dataclass
class AxisDrive:
    """What an axis is asked to do, and where it is: in rad, or m of one that slides.

    Args:
        mode: off holds still.
        rate, acceleration: largest.
        low, high: limits of the readout.
        stuck: it does not move.
        slip: true position minus readout.
        demand: position or rate that was last asked for.
        pieces: of its motion, the last one continues.
        unit: of commands and frames: a deg or a mm.
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
    unit: float = DEG

    @classmethod
    def of(cls, rig: Rig, name: str) -> "AxisDrive":
        """An axis that was just switched on. One that slides is within the range of its joint."""
        unit = rig.kind.size(name)
        if name not in rig.kind.sliding:
            return cls(unit=unit)
        low, high = (end * unit for end in rig.ranges.get(name, (-inf, inf)))
        return cls(rate=SLIDE_RATE, acceleration=SLIDE_ACCELERATION, low=low, high=high, unit=unit)

    def jet(self, time: Array) -> Jet:
        """Position, rate and acceleration at these times, s, none of them past, rad or m, (n,)."""
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
        """Position, rate and acceleration now, rad or m; time: s."""
        jet = self.jet(np.array([time]))
        return tuple(float(np.asarray(part)[0]) for part in (jet.x, jet.v, jet.a))  # type: ignore[return-value]

    def moving(self, time: float) -> bool:
        """Whether it moves, or will without a further demand. time: s."""
        return self.pieces[-1].v != 0 or time < self.pieces[-1].start

    def stop(self, time: float) -> None:
        """Come to a standstill as fast as the limit allows. time: s."""
        self._follow(time, 0.0)

    def turn(self, time: float, rate: float) -> None:
        """Reach a rate, rad/s or m/s, and keep it; time: s."""
        self.demand = rate
        if not self.stuck:
            self._follow(time, max(-self.rate, min(self.rate, rate)))

    def go(self, time: float, position: float) -> None:
        """Go to a position, rad or m, by a smooth trapezoid of the rate and stop there; time: s."""
        self.demand = position
        if self.stuck:
            return
        self._follow(time, 0.0)
        last = self.pieces[-1]
        distance = position - last.x
        if distance == 0:
            return
        sign, mean = (1.0 if distance > 0 else -1.0), self.acceleration / 2
        peak = min(self.rate, sqrt(mean * abs(distance)))
        ramp = peak / mean
        self._extend(ramp, sign * peak)
        self._extend(abs(distance) / peak - ramp, 0.0)
        self._extend(ramp, -sign * peak)
        self.pieces[-1] = Piece(self.pieces[-1].start, position, 0.0)

    def seize(self, time: float, stuck: bool) -> None:
        """Stick where it is, or come free. time: s."""
        if stuck:
            self.hold(time, self.at(time)[0])
        self.stuck = stuck

    def hold(self, time: float, position: float) -> None:
        """Stand still at a position from an instant on, s."""
        self.pieces = [Piece(time, position, 0.0)]

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
