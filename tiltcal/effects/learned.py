"""Effects that no name fits: a curve over a coordinate, learned from a recording, acting where a
named effect would.

``harmonic`` curves are sums of cos(n u), sin(n u), n = 1, 2, ...; others are natural cubic splines
through (knot, value), held constant outside their knots: a drift is not extrapolated beyond the
recording it was seen in. A law of temperature goes on, a spline by its slope; through three knots
it is a parabola. With a period a spline begins anew after it: a saw. A ``power`` of the coordinate
is the form with one number.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.effects.base import AngleEffect, Effect, FrameEffect, SignalEffect
from tiltcal.effects.curve_coordinates import coordinate_of, late_jet, motion_jet
from tiltcal.effects.hysteresis_and_lag import first_order_lag
from tiltcal.effects.mechanisms import Context, Turn
from tiltcal.effects.parameter import Parameter, Stage
from tiltcal.effects.sense import Sense
from tiltcal.setup.tables import axis_of
from tiltcal.setup.trajectory import Drive, Jet
from tiltcal.statistics.cardinal_splines import cardinal_splines

CONTINUED = ("temperature",)
"""Coordinates beyond whose range a spline goes on: the next recording will not have the same
temperatures.
"""
PARABOLA = 3  # knots of a law that goes on as it is
ORDERS = 3  # of each angle in a product of two


@dataclass(frozen=True)
class Learned(Effect):
    """A learned curve.

    Args:
        coordinate: one of COORDINATES of ``curve_coordinates``, or a table angle; rad, SI, s from
            the first stamp, K from T0.
        knots: of a spline, increasing; empty for harmonics.
        period: of the first harmonic, 0 for a turn; of a spline that begins anew at its first knot,
            0 for none.
        beside: another table angle: products of the harmonics of both, up to the third of each.
        lag: time constant, s, by which the coordinate is felt late; of a readout or a frame that
            follows the table's motion the curve is late.
        play: width of a play, SI: the curve follows its state, in [-1, 1], as the coordinate moves
            it; 0 for none.
        power: c0 |u|^power instead of a spline or harmonics; 0 for none. odd: with the sign of u.
        per_input: whether it multiplies the channel's own input (a scale factor) and does not stand
            alone.
        per_degree: whether it multiplies the temperature from T0, K: a coefficient that depends on
            temperature.
        slot: of the frame that it tilts; turn: coordinate axis it tilts about.
        place: stage of the chain it is blamed on.
    """

    id: ClassVar[str] = "learned"
    linear: ClassVar[bool] = True
    title: ClassVar[str] = "learned curve"
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    coordinate: str = ""
    knots: tuple[float, ...] = ()
    period: float = 0.0
    beside: str = ""
    power: float = 0.0
    odd: bool = False
    per_input: bool = False
    per_degree: bool = False
    lag: float = 0.0
    play: float = 0.0
    slot: str = ""
    turn: str = ""
    place: str = "sensor"

    @property
    def count(self) -> int:
        """Number of coefficients."""
        if self.beside:
            return 4 * ORDERS**2
        return len(self.knots) or 1 + max((int(name[1:]) for name in self.values), default=0)

    @property
    def is_step(self) -> bool:
        """Whether it goes from one level to another."""
        return len(self.knots) == 2 and not self.period

    @property
    def is_saw(self) -> bool:
        """Whether it is a ramp that begins anew after its period."""
        return len(self.knots) == 2 and self.period > 0

    @property
    def coefficients(self) -> Array:
        """(p,): cos 1, sin 1, cos 2, ...; the values at the knots; cos cos, cos sin, sin cos, sin
        sin of each two orders; or c0.
        """
        return np.array([self.values.get(f"c{k}", 0.0) for k in range(self.count)])

    def basis(self, u: Array, order: int = 0) -> Array:
        """The curve of each coefficient alone at one, or its first or second derivative, (n, p)."""
        if self.power:
            return self._power(u, order)[:, None]
        if self.knots:
            return self._spline(u, order, np.eye(self.count))
        pace = 2 * np.pi / self.period if self.period else 1.0
        turn = np.exp(1j * pace * u)
        wave = np.ones_like(turn)
        columns = np.empty((len(u), self.count))
        for k in range(self.count):
            if k % 2 == 0:
                wave = wave * turn
            slope = (1j * (k // 2 + 1) * pace) ** order * (1 if k % 2 == 0 else -1j)
            columns[:, k] = (slope * wave).real
        return columns

    def _spline(self, u: Array, order: int, weights: Array) -> Array:
        """Sums of the splines of the coefficients with weights (p, m), or a derivative, (n, m)."""
        from scipy.interpolate import PPoly

        u = self.knots[0] + (u - self.knots[0]) % self.period if self.period else u
        parabola = self.coordinate in CONTINUED and len(self.knots) == PARABOLA
        each = cardinal_splines(self.knots, *(("not-a-knot",) if parabola else ()))
        spline = PPoly(each.c @ weights, each.x)
        if parabola:
            return np.asarray(spline(u, order))
        inside = np.clip(u, self.knots[0], self.knots[-1])
        beyond, found = (u - inside)[:, None], np.asarray(spline(inside, order))
        if not beyond.any():
            return found
        if self.coordinate in CONTINUED:
            return found + (spline(inside, 1) * beyond if order == 0 else 0.0)
        return np.where(beyond == 0, found, found if order == 0 else 0.0)

    def _power(self, u: Array, order: int) -> Array:
        """|u|^power, with the sign of u where it is odd, or its first or second derivative,
        (n,).
        """
        factor = float(np.prod(self.power - np.arange(order)))
        sign = np.sign(u) if self.odd != (order % 2 == 1) else 1.0
        # a root has no slope at nothing: it is left out
        away = np.where(u == 0, np.inf if self.power < order else 0.0, np.abs(u))
        return (
            np.asarray(factor * sign * away ** (self.power - order)) if factor else np.zeros_like(u)
        )

    def curve(self, u: Array, order: int = 0) -> Array:
        """The curve, or its first or second derivative, at some coordinates, (n,)."""
        if self.knots and not self.power:
            return self._spline(u, order, self.coefficients[:, None])[:, 0]
        return np.asarray(self.basis(u, order) @ self.coefficients)

    def each(self, u: Jet) -> Jet:
        """The curve of each coefficient along a moving coordinate with its time derivatives, (n,
        p).
        """
        x, v, a = (np.broadcast_to(part, np.shape(u.x)) for part in (u.x, u.v, u.a))
        slope = self.basis(x, 1)
        return Jet(
            self.basis(x),
            slope * v[:, None],
            slope * a[:, None] + self.basis(x, 2) * v[:, None] ** 2,
        )

    def jet(self, u: Jet) -> Jet:
        """The curve of a moving coordinate with its time derivatives, (n,)."""
        each, c = self.each(u), self.coefficients
        return Jet(each.x @ c, each.v @ c, each.a @ c)

    def along(self, drive: Drive) -> Jet:
        """The curve along a drive: of a table angle, of time or of temperature, (n,)."""
        each, c = self.each_along(drive), self.coefficients
        return Jet(each.x @ c, each.v @ c, each.a @ c)

    def each_along(self, drive: Drive) -> Jet:
        """The curve of each coefficient along a drive, (n, p)."""
        each = self._each_along(drive)
        return each.times(_temperature_from_reference(drive)) if self.per_degree else each

    def _each_along(self, drive: Drive) -> Jet:
        if self.beside:
            angles = (motion_jet(name, drive) for name in (self.coordinate, self.beside))
            return _products(*angles)
        if self.coordinate != "temperature":
            each = self.each(motion_jet(self.coordinate, drive, self.play))
            return late_jet(each, drive.time, self.lag) if self.lag else each
        warm = first_order_lag(
            drive.time, drive.temperature - drive.reference_temperature, self.lag
        )
        x = self.basis(warm)
        v = np.gradient(x, drive.time, axis=0) if len(x) > 2 else np.zeros_like(x)
        return Jet(x, v, np.gradient(v, drive.time, axis=0) if len(x) > 2 else v)


@dataclass(frozen=True)
class LearnedReading(Learned, SignalEffect):
    """reading_i += curve(coordinate), or curve(coordinate) x input_i; ``axis`` names the
    channel.
    """

    stage: ClassVar[Stage] = "sensor"
    order: ClassVar[int] = 21
    channel_wise: ClassVar[bool] = True

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        channel = self.channel(sense)
        if self.beside:
            reading[:, channel] += self.columns(sense) @ self.coefficients
        else:
            own = sense.true_input()[:, channel]
            added = self.curve(self.followed(sense, own))
            added = added * sense.temperature if self.per_degree else added
            reading[:, channel] += added * own if self.per_input else added
        return reading

    def followed(self, sense: Sense, own: Array) -> Array:
        """The coordinate as it is felt, (n,); ``own``: the channel's true input."""
        return coordinate_of(self.coordinate, sense, own, self.lag, self.play)

    def channel(self, sense: Sense) -> int:
        """Number of the channel it adds to."""
        return 0 if self.axis == "a" else sense.axes.index("xyz".index(str(self.axis)))

    def columns(self, sense: Sense) -> Array:
        """What one of each coefficient adds to that channel, (n, p)."""
        own = sense.true_input()[:, self.channel(sense)]
        if self.beside:
            axes = (axis_of(self.coordinate), axis_of(self.beside))
            return np.asarray(_products(*(Jet(sense.angles[str(axis)]) for axis in axes)).x)
        basis = self.basis(self.followed(sense, own))
        basis = basis * sense.temperature[:, None] if self.per_degree else basis
        return basis * own[:, None] if self.per_input else basis


@dataclass(frozen=True)
class LearnedReadout(Learned, AngleEffect):
    """true angle = readout + curve(coordinate), on one table axis."""

    stage: ClassVar[Stage] = "table"

    def deviation(self, drive: Drive, axis: str, rng: np.random.Generator | None) -> Jet:
        return self.along(drive)


@dataclass(frozen=True)
class LearnedTilt(Learned, FrameEffect):
    """A frame (``base``, ``<axis>_bearing``, ``mount``) turns about a coordinate axis by
    curve(coordinate).
    """

    stage: ClassVar[Stage] = "table"

    def turns(self, slot: str, context: Context) -> Sequence[Turn]:
        return (Turn(self.turn, self.along(context.drive)),) if slot == self.slot else ()


def _temperature_from_reference(drive: Drive) -> Jet:
    """The temperature from T0 with its rate, K and K/s, (n, 1); what its rate changes by is left
    out.
    """
    warm = drive.temperature - drive.reference_temperature
    rate = np.gradient(warm, drive.time) if len(warm) > 1 else np.zeros_like(warm)
    return Jet(warm[:, None], rate[:, None], np.zeros((len(warm), 1)))


def _products(one: Jet, other: Jet) -> Jet:
    """Products of the harmonics of two angles, (n, 4 ORDERS^2): cos cos, cos sin, sin cos, sin sin
    of (1, 1), (1, 2), ...
    """
    waves = [
        [(u.harmonic(m, 1.0, 0.0), u.harmonic(m, 0.0, 1.0)) for m in range(1, ORDERS + 1)]
        for u in (one, other)
    ]
    each = [p.times(q) for first in waves[0] for second in waves[1] for p in first for q in second]
    x, v, a = (
        np.column_stack(
            [np.broadcast_to(part, np.shape(e.x)) for e, part in zip(each, parts, strict=True)]
        )
        for parts in ([e.x for e in each], [e.v for e in each], [e.a for e in each])
    )
    return Jet(x, v, a)
