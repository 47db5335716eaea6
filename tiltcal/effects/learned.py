"""Effects that no name fits: a curve over a coordinate, learned from a recording, acting where a
named effect would.

``harmonic`` curves are sums of cos(n u), sin(n u), n = 1, 2, ...; others are natural cubic splines
through (knot, value), clamped outside their knots: a drift is not extrapolated beyond the recording
it was seen in. A curve over temperature is extrapolated, a spline by its mean slope; through three
knots it is a parabola. With a period a spline begins again after it: a saw. A ``power`` of the
coordinate is the form with one number. With ``instants`` it is a transient from each of them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.effects.base import AngleEffect, DelayEffect, Effect, FrameEffect, SignalEffect
from tiltcal.effects.curve_bases import harmonics_of, power_of, spline_of, transients_at
from tiltcal.effects.curve_coordinates import (
    INPUTS,
    coordinate_named,
    coordinate_of,
    coordinate_rate,
    force_jet,
    lagged_jet,
    motion_jet,
)
from tiltcal.effects.curve_products import ORDERS, multiplier, products
from tiltcal.effects.hysteresis_and_lag import first_order_lag
from tiltcal.effects.mechanisms import Context, Turn
from tiltcal.effects.parameter import Need, Parameter, Stage
from tiltcal.effects.sense import Sense
from tiltcal.setup.tables import axis_of
from tiltcal.setup.trajectory import Drive, Jet

Force = Callable[[], Array]
PARABOLA = 3  # knots of a coordinate that extrapolates, which make a parabola


@dataclass(frozen=True)
class Learned(Effect):
    """A learned curve.

    Args:
        coordinate: one of COORDINATES, or a table angle or its rate; rad, SI, s from the first
            stamp, K from T0.
        knots: of a spline, increasing; empty for harmonics.
        period: of the first harmonic, 0 for a turn; of a spline that begins again at its first
            knot, 0 for none.
        beside: another table angle: products of the harmonics of both, up to the third of each.
        lag: time constant, s, by which the coordinate is lagged; of a table angle, of a square or
            cube, and of a readout or a frame that follows the table's motion, the curve is lagged.
        relaxing: with such a lagged curve, whether only its remainder acts: the lagged curve less
            that of now.
        play: width of a play, SI, whose state, in [-1, 1], the curve follows; 0 for none.
        power: c0 |u|^power instead of a spline or harmonics; 0 for none.
        odd: with the sign of u.
        per_input: whether it multiplies the channel's own input (a scale factor) and does not stand
            alone.
        times: what the curve is multiplied by: ``temperature`` from T0, K, ``time``, s, ``speed``
            or the rate of an axis, rad/s, an angle, rad, ``way_<axis>``, or an input of a reading.
        instants: s from the first stamp, of transients over time: each rises evenly to its
            coefficient within ``rise``, s, before it, and falls with the time constant ``fall``, s.
        slot: of the frame that it tilts.
        turn: coordinate axis it tilts about.
        place: stage of the chain it is attributed to.
        holds: whether it is clamped to its last value beyond its knots, over temperature as well.
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
    times: str = ""
    lag: float = 0.0
    relaxing: bool = False
    play: float = 0.0
    instants: tuple[float, ...] = ()
    rise: float = 0.0
    fall: float = 0.0
    slot: str = ""
    turn: str = ""
    place: str = "sensor"
    holds: bool = False

    @cached_property
    def count(self) -> int:
        """Number of coefficients."""
        if self.beside:
            return 4 * ORDERS**2
        fixed = len(self.knots) or len(self.instants)
        return fixed or 1 + max((int(name[1:]) for name in self.values), default=0)

    @property
    def extrapolates(self) -> bool:
        """Whether it extrapolates beyond its knots."""
        return (
            bool(self.knots) and coordinate_named(self.coordinate).extrapolates and not self.holds
        )

    @property
    def is_step(self) -> bool:
        """Whether it goes from one level to another."""
        return len(self.knots) == 2 and not self.period

    @property
    def is_saw(self) -> bool:
        """Whether it is a ramp that begins again after its period."""
        return len(self.knots) == 2 and self.period > 0

    @property
    def answer_id(self) -> tuple[object, ...]:
        """Equal for two effects that act at the same place, whatever their curves are."""
        reading = self.sensor, self.axis, self.per_input
        return (type(self), *reading, self.slot, self.turn)

    @property
    def curve_id(self) -> tuple[object, ...]:
        """Equal for two effects whose curves are the same, wherever they act."""
        bends = self.count, self.knots, self.period, self.power, self.odd, self.holds
        past = self.lag, self.relaxing, self.play, self.instants, self.rise, self.fall
        return (self.coordinate, self.beside, self.times, *bends, *past)

    @property
    def coefficients(self) -> Array:
        """(p,): cos 1, sin 1, cos 2, ...; the values at the knots; cos cos, cos sin, sin cos, sin
        sin of each two orders; or c0.
        """
        return np.array([self.values.get(f"c{k}", 0.0) for k in range(self.count)])

    def basis(self, u: Array, order: int = 0) -> Array:
        """The curve of each coefficient alone at one, or its first or second derivative, (n, p)."""
        if self.power:
            return power_of(u, order, self.power, self.odd)[:, None]
        if self.knots:
            return self._spline(u, order, np.eye(self.count))
        if self.instants:
            return transients_at(u, order, self.instants, self.rise, self.fall)
        return harmonics_of(u, order, self.count, 2 * np.pi / self.period if self.period else 1.0)

    def curve(self, u: Array, order: int = 0) -> Array:
        """The curve, or its first or second derivative, at some coordinates, (n,)."""
        if self.knots and not self.power:
            return self._spline(u, order, self.coefficients[:, None])[:, 0]
        return np.asarray(self.basis(u, order) @ self.coefficients)

    def _spline(self, u: Array, order: int, weights: Array) -> Array:
        parabola = coordinate_named(self.coordinate).extrapolates and len(self.knots) == PARABOLA
        form = {"parabola": parabola, "holds": not self.extrapolates}
        return spline_of(u, order, self.knots, self.period, weights, **form)

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

    def along(self, drive: Drive, force: Force | None = None) -> Jet:
        """The curve along a drive: of a table angle, of time or of temperature, (n,); ``force``: as
        in ``each_along``.
        """
        each, c = self.each_along(drive, force), self.coefficients
        return Jet(each.x @ c, each.v @ c, each.a @ c)

    def each_along(self, drive: Drive, force: Force | None = None) -> Jet:
        """The curve of each coefficient along a drive, (n, p); ``force``: gives the force of
        gravity in the body, m/s2, (n, 3), where a mount follows it.
        """
        each = self._each_along(drive, force)
        return each.times(multiplier(self.times, drive)) if self.times else each

    def _each_along(self, drive: Drive, force: Force | None) -> Jet:
        if self.beside:
            angles = (motion_jet(name, drive) for name in (self.coordinate, self.beside))
            return products(*angles)
        if self.coordinate == "warming":
            slope = coordinate_rate(drive.time, drive.temperature, self.lag)
            return self.each(Jet(slope, np.zeros_like(slope), np.zeros_like(slope)))
        if self.coordinate != "temperature":
            if force is not None and self.coordinate in INPUTS:
                u = force_jet(self.coordinate, drive, force(), self.play)
            else:
                u = motion_jet(self.coordinate, drive, self.play)
            each = self.each(u)
            lagged = lagged_jet(each, drive.time, self.lag) if self.lag else each
            return lagged - each if self.relaxing else lagged
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
        if self.beside or self._lagged_curve:
            reading[:, channel] += self.columns(sense) @ self.coefficients
        else:
            own = sense.true_input()[:, channel]
            added = self.curve(self.followed(sense, own))
            added = added * coordinate_of(self.times, sense, own) if self.times else added
            reading[:, channel] += added * own if self.per_input else added
        return reading

    def followed(self, sense: Sense, own: Array) -> Array:
        """The coordinate as the sensor follows it, (n,); ``own``: the channel's true input."""
        lag = 0.0 if self._lagged_curve else self.lag
        return coordinate_of(self.coordinate, sense, own, lag, self.play)

    @property
    def _lagged_curve(self) -> bool:
        """Whether the curve is lagged and not what it follows: an angle passes on, power warms."""
        return self.lag > 0 and (axis_of(self.coordinate) is not None or self.power > 1)

    def channel(self, sense: Sense) -> int:
        """Number of the channel it adds to."""
        return 0 if self.axis == "a" else sense.axes.index("xyz".index(str(self.axis)))

    @property
    def curve_id(self) -> tuple[object, ...]:
        """As of any curve; one that follows the input of its channel is that channel's."""
        own = self.axis if "input" in (self.coordinate, self.times) else None
        return (self.sensor, own, *super().curve_id)

    def columns(self, sense: Sense) -> Array:
        """What one of each coefficient adds to that channel, (n, p)."""
        own = sense.true_input()[:, self.channel(sense)]
        basis = self.curves(sense, own)
        return basis * own[:, None] if self.per_input else basis

    def curves(self, sense: Sense, own: Array) -> Array:
        """The curve of each coefficient along what a sensor senses, (n, p); ``own``: the channel's
        true input, (n,).
        """
        if self.beside:
            axes = (axis_of(self.coordinate), axis_of(self.beside))
            return np.asarray(products(*(Jet(sense.angles[str(axis)]) for axis in axes)).x)
        basis = self.basis(self.followed(sense, own))
        if self._lagged_curve:
            lagged = [first_order_lag(sense.elapsed, each, self.lag) for each in basis.T]
            basis = np.column_stack(lagged)
        if self.times:
            basis = basis * coordinate_of(self.times, sense, own)[:, None]
        return basis


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
        if slot != self.slot:
            return ()
        return (Turn(self.turn, self.along(context.drive, context.gravity_in_body)),)


@dataclass(frozen=True)
class LearnedDelay(Learned, DelayEffect):
    """The stamps of a sensor, or of all of them, are later than their signal by curve(time), s."""

    stage: ClassVar[Stage] = "timing"
    needs: ClassVar[Need] = "motion"

    def delay(self, elapsed: Array, channel: int, rng: np.random.Generator | None) -> Array:
        return self.curve(elapsed)
