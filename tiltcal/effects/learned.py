"""Effects that no name fits: a curve over a coordinate, learned from a recording, acting where a named effect would.

``harmonic`` curves are sums of cos(n u), sin(n u), n = 1, 2, ...; others are natural cubic splines through (knot, value),
held constant outside their knots: a drift is not extrapolated beyond the recording it was seen in.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from tiltcal.effects.base import STAGES, AngleEffect, Effect, FrameEffect, Parameter, Sense, SignalEffect, Stage
from tiltcal.effects.mechanisms import Context, Turn
from tiltcal.effects.memory import first_order_lag
from tiltcal.errors import TiltcalError, nearest
from tiltcal.frames import AXES, Array
from tiltcal.motion import Drive, Jet, sampled_jet
from tiltcal.setup import Setup

ANGLES = {f"table_{axis}": axis for axis in ("outer", "middle", "inner")}
INPUTS = {f"{quantity}_{axis}": (quantity, "xyz".index(axis)) for quantity in ("force", "rate") for axis in "xyz"}
COORDINATES = (*ANGLES, *INPUTS, "input", "transverse", "time", "temperature", "warming", "since_move")
"""What a curve may follow; ``input``: the channel's own; ``transverse``: rate across a FOG's axis; ``warming``: dT/dt."""


@dataclass(frozen=True)
class Learned(Effect):
    """A learned curve.

    Args:
        coordinate: one of COORDINATES; rad, SI, s from the first stamp, K from T0.
        knots: of a spline, increasing; empty for harmonics.
        lag: time constant, s, by which a temperature is felt late.
        per_input: whether it multiplies the channel's own input (a scale factor) and does not stand alone.
        slot: of the frame that it tilts; turn: coordinate axis it tilts about.
        place: stage of the chain it is blamed on.
    """

    id: ClassVar[str] = "learned"
    linear: ClassVar[bool] = True
    title: ClassVar[str] = "learned curve"
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    coordinate: str = ""
    knots: tuple[float, ...] = ()
    per_input: bool = False
    lag: float = 0.0
    slot: str = ""
    turn: str = ""
    place: str = "sensor"

    @property
    def coefficients(self) -> Array:
        """(p,): cos 1, sin 1, cos 2, ... or the values at the knots."""
        p = len(self.knots) or 1 + max((int(name[1:]) for name in self.values), default=0)
        return np.array([self.values.get(f"c{k}", 0.0) for k in range(p)])

    @cached_property
    def _spline(self) -> Any:
        from scipy.interpolate import CubicSpline

        return CubicSpline(self.knots, self.coefficients, bc_type="natural")

    def curve(self, u: Array, order: int = 0) -> Array:
        """The curve, or its first or second derivative, at some coordinates, (n,)."""
        if not self.knots:
            terms = [
                c * (1j * n) ** order * np.exp(1j * n * u) * (1 if k % 2 == 0 else -1j)
                for k, c in enumerate(self.coefficients)
                if c and (n := k // 2 + 1)
            ]
            return np.asarray(np.sum(terms, axis=0).real if terms else np.zeros_like(u))
        inside = np.clip(u, self.knots[0], self.knots[-1])
        held = self._spline(inside, order)
        return np.asarray(held if order == 0 else np.where(inside == u, held, 0.0))

    def jet(self, u: Jet) -> Jet:
        """The curve of a moving coordinate with its time derivatives, (n,)."""
        x = np.asarray(u.x)
        slope = self.curve(x, 1)
        return Jet(self.curve(x), slope * u.v, slope * u.a + self.curve(x, 2) * u.v**2)

    def along(self, drive: Drive) -> Jet:
        """The curve along a drive: of a table angle, of time or of temperature."""
        if self.coordinate in ANGLES:
            return self.jet(drive.axes[ANGLES[self.coordinate]])
        if self.coordinate == "time":
            one = np.ones_like(drive.elapsed)
            return self.jet(Jet(drive.elapsed, one, 0 * one))
        warm = first_order_lag(drive.time, drive.temperature - drive.reference_temperature, self.lag)
        return sampled_jet(drive.time, self.curve(warm))


@dataclass(frozen=True)
class LearnedReading(Learned, SignalEffect):
    """reading_i += curve(coordinate), or curve(coordinate) x input_i; ``axis`` names the channel."""

    stage: ClassVar[Stage] = "sensor"
    order: ClassVar[int] = 21
    channel_wise: ClassVar[bool] = True

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        channel = 0 if self.axis == "a" else sense.axes.index("xyz".index(str(self.axis)))
        own = sense.true_input()[:, channel]
        u = coordinate_of(self.coordinate, sense, own)
        added = self.curve(first_order_lag(sense.time, u, self.lag) if self.lag else u)
        reading[:, channel] += added * own if self.per_input else added
        return reading


@dataclass(frozen=True)
class LearnedReadout(Learned, AngleEffect):
    """true angle = readout + curve(coordinate), on one table axis."""

    stage: ClassVar[Stage] = "table"

    def deviation(self, drive: Drive, axis: str, rng: np.random.Generator | None) -> Jet:
        return self.along(drive)


@dataclass(frozen=True)
class LearnedTilt(Learned, FrameEffect):
    """A frame (``base``, ``<axis>_bearing``, ``mount``) turns about a coordinate axis by curve(coordinate)."""

    stage: ClassVar[Stage] = "table"

    def turns(self, slot: str, context: Context) -> Sequence[Turn]:
        return (Turn(self.turn, self.along(context.drive)),) if slot == self.slot else ()


def coordinate_of(name: str, sense: Sense, own: Array) -> Array:
    """A coordinate along what a sensor senses, (n,); ``own`` is the channel's true input."""
    if name in ANGLES:
        return sense.angles[ANGLES[name]]
    if name in INPUTS:
        quantity, axis = INPUTS[name]
        return np.asarray((sense.force if quantity == "force" else sense.rate)[:, axis])
    if name == "transverse":
        return np.asarray(np.linalg.norm(np.cross(sense.rate, sense.input_vector), axis=1))
    if name == "warming":
        return np.gradient(sense.temperature, sense.time)
    return {"input": own, "time": sense.elapsed, "temperature": sense.temperature, "since_move": sense.since_move}[name]


KINDS: dict[str, type[Learned]] = {"reading": LearnedReading, "readout": LearnedReadout, "tilt": LearnedTilt}
_KEYS = {"coordinate", "knots", "coefficients", "on", "slot", "turn", "per_input", "lag_s", "place"}


def make_learned(
    table: Mapping[str, Any], setup: Setup, *, sensor: str | None, axis: str | None, role: str | None, subject: str
) -> Learned:
    """A learned effect from a file's table: ``on`` reading, readout or tilt; ``coordinate``, ``knots``, ``coefficients``.

    Raises:
        TiltcalError: a key or a word is wrong.
    """
    subject = f"{subject} learned"
    for key in table:
        if key not in _KEYS:
            raise TiltcalError(subject, found=f"unknown key '{key}'", need="a key of it", do=nearest(key, sorted(_KEYS)))
    on = _word(table, "on", "reading", KINDS, subject)
    coordinate = _word(table, "coordinate", "", COORDINATES, subject)
    place = _word(table, "place", "sensor", STAGES, subject)
    knots, numbers = (_numbers(table.get(key, ()), f"{subject}, key {key}") for key in ("knots", "coefficients"))
    if knots and (len(knots) != len(numbers) or len(knots) < 2 or np.any(np.diff(knots) <= 0)):
        raise TiltcalError(
            subject, found=f"{len(knots)} knots, {len(numbers)} coefficients",
            need="two or more increasing knots, one coefficient each", do="correct the lists",
        )  # fmt: skip
    slot, turn = _where(on, coordinate, table, setup, sensor, axis, subject)
    lag = table.get("lag_s", 0.0)
    if not isinstance(lag, int | float) or not lag >= 0:
        raise TiltcalError(f"{subject}, key lag_s", found=repr(lag), need="seconds, not negative", do="correct it")
    values = {f"c{k}": value for k, value in enumerate(numbers)}
    return KINDS[on](
        values, sensor, axis, role, coordinate=coordinate, knots=tuple(knots), per_input=bool(table.get("per_input", False)),
        lag=float(lag), slot=slot, turn=turn, place=place,
    )  # fmt: skip


def _where(
    on: str, coordinate: str, table: Mapping[str, Any], setup: Setup, sensor: str | None, axis: str | None, subject: str
) -> tuple[str, str]:  # fmt: skip
    """Slot and turn of a tilt, both empty for the others, once coordinate and axis are known to fit the place."""
    if on != "reading" and coordinate not in (*ANGLES, "time", "temperature"):
        raise TiltcalError(subject, found=f"coordinate '{coordinate}'", need="a table angle, time or temperature", do="correct it")
    if coordinate in ANGLES and ANGLES[coordinate] not in setup.rig.axis_names:
        raise TiltcalError(subject, found=f"coordinate '{coordinate}'", need="an axis of this table", do="correct it")
    axes = setup.named(str(sensor)).axes if on == "reading" else setup.rig.axis_names
    if on != "tilt" and axis not in axes:
        raise TiltcalError(subject, found=f"axis '{axis}'", need="one of " + ", ".join(axes), do="correct it")
    if on != "tilt":
        return "", ""
    slots = ("base", *(f"{name}_bearing" for name in setup.rig.axis_names), "mount")
    return _word(table, "slot", "", slots, subject), _word(table, "turn", "", AXES, subject)


def _word(table: Mapping[str, Any], key: str, default: str, valid: Iterable[str], subject: str) -> str:
    word = str(table.get(key, default))
    if word not in valid:
        raise TiltcalError(f"{subject}, key {key}", found=f"'{word}'", need="one of " + ", ".join(valid), do="correct it")
    return word


def _numbers(values: Any, subject: str) -> list[float]:
    if not isinstance(values, list | tuple) or not all(isinstance(v, int | float) and np.isfinite(v) for v in values):
        raise TiltcalError(subject, found=repr(values)[:60], need="a list of numbers", do="correct it")
    return [float(v) for v in values]


def learned_table(effect: Learned) -> dict[str, Any]:
    """A learned effect as the table of a scenario file: the inverse of ``make_learned``."""
    on = next(word for word, cls in KINDS.items() if isinstance(effect, cls))
    table: dict[str, Any] = {"id": "learned", "on": on, "coordinate": effect.coordinate, "place": effect.place}
    table |= {key: value for key in ("sensor", "axis", "role", "seen_in", "slot", "turn") if (value := getattr(effect, key))}
    if effect.knots:
        table["knots"] = list(effect.knots)
    if effect.per_input:
        table["per_input"] = True
    if effect.lag:
        table["lag_s"] = effect.lag
    return table | {"coefficients": [float(c) for c in effect.coefficients]}
