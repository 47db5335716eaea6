"""One recording's motion, worked out once, and how its readings change with each effect.

The response of force and rate in the body frame to a small turn at each stage of the chain is of
first order and exact in time.

At an instant the motion depends on a turn's angle, rate and acceleration at that instant only.
Three probes through the closed form, one for each, therefore give the response to any turn at that
stage.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import ClassVar, TypeVar

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.frames import tilt_of_force
from tiltcal.effects.base import AngleEffect, DelayEffect, Effect, FrameEffect, SignalEffect
from tiltcal.effects.learned import (
    Learned,
    LearnedDelay,
    LearnedReading,
    LearnedReadout,
    LearnedTilt,
)
from tiltcal.effects.loads import LoadEffect, masses_of
from tiltcal.effects.mechanisms import Context, Turn
from tiltcal.effects.parameter import Parameter, Stage
from tiltcal.effects.sense import ACCELEROMETERS
from tiltcal.forward.kinematics import closed_form, force_and_rate, true_angles
from tiltcal.forward.signal_chain import CONVERSION, make_sense
from tiltcal.setup.loads import Mass
from tiltcal.setup.setup import Setup
from tiltcal.setup.trajectory import Course, Drive, Jet

STEP = 1e-4  # rad, rad/s, rad/s2: central differences of sines leave its square


@dataclass(frozen=True)
class _TurnProbe(FrameEffect):
    """One turn at one slot."""

    stage: ClassVar[Stage] = "table"
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    slot: str = ""
    turn: Turn = field(default_factory=lambda: Turn("x", Jet(0.0)))

    def turns(self, slot: str, context: Context) -> Sequence[Turn]:
        return (self.turn,) if slot == self.slot else ()


@dataclass(frozen=True)
class _AngleProbe(AngleEffect):
    """A deviation of one axis."""

    stage: ClassVar[Stage] = "table"
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    jet: Jet = field(default_factory=lambda: Jet(0.0))

    def deviation(self, drive: Drive, axis: str, rng: np.random.Generator | None) -> Jet:
        return self.jet


TurnAxis = tuple[str, str]
"""(slot, coordinate axis) of a turn; ("axis", name) of a table axis."""


def moves_smoothly(effect: Effect) -> bool:
    """Whether all that an effect does is turn frames or axes by angles that do not ask for the
    force there.
    """
    return isinstance(effect, AngleEffect | LoadEffect) or (
        isinstance(effect, FrameEffect) and not effect.mechanised
    )


class Responses:
    """Answers of force and rate along a nominal drive, each axis of turning probed when it is first
    asked for.

    Args:
        setup: site, rig, sensors.
        drive: motion of the table.
    """

    def __init__(self, setup: Setup, drive: Drive) -> None:
        self.setup, self.drive = setup, drive
        self._kept: dict[TurnAxis, tuple[tuple[Array | None, Array | None], ...]] = {}
        self._contexts: dict[tuple[Mass, ...], Context] = {}
        self._loaded(())

    def turns(self, effect: Effect, others: Sequence[Effect] = ()) -> dict[TurnAxis, Jet]:
        """The small turns of an effect that ``moves_smoothly``, by their axes.

        Args:
            effect: effect that turns frames or axes.
            others: effects that act as well; of them loads and compliances matter.

        """
        rig = self.setup.rig
        if isinstance(effect, AngleEffect):
            return {
                ("axis", n): effect.slight(self.drive, n)
                for n in rig.axis_names
                if effect.acts_on(n, rig)
            }
        masses = masses_of(others, rig)
        if isinstance(effect, LoadEffect):
            bending = [e for e in others if isinstance(e, FrameEffect) and e.compliances(rig)]
            more = self._turned(bending, self._loaded((*masses, *effect.masses(rig))))
            less = self._turned(bending, self._loaded(masses))
            return {about: jet - less[about] for about, jet in more.items()}
        assert isinstance(effect, FrameEffect)
        return self._turned([effect], self._loaded(masses))

    def _turned(self, effects: Sequence[FrameEffect], context: Context) -> dict[TurnAxis, Jet]:
        found: dict[TurnAxis, Jet] = {}
        for slot in self.setup.rig.kind.slots:
            for turn in (t for e in effects for t in e.turns(slot, context)):
                about = (slot, turn.axis)
                found[about] = found[about] + turn.angle if about in found else turn.angle
        return found

    def _loaded(self, masses: tuple[Mass, ...]) -> Context:
        """The nominal motion with masses on its links."""
        if masses not in self._contexts:
            kept = dict(list(self._contexts.items())[:1])  # without any; the others change in a fit
            axes, gravity = true_angles(self.setup, self.drive, ()), self.setup.site.gravity
            context = Context.along(self.drive, axes, self.setup.rig, gravity, masses)
            self._contexts = {**kept, masses: context}
        return self._contexts[masses]

    @property
    def nominal(self) -> Context:
        """The nominal motion."""
        return self._loaded(())

    def to(self, turns: Mapping[TurnAxis, Jet]) -> tuple[Array, Array]:
        """Change of force and rate by small turns, (n, 3) each."""
        n = len(self.drive.time)
        force, rate = np.zeros((n, 3)), np.zeros((n, 3))
        for about, jet in turns.items():
            for part, (df, dw) in zip((jet.x, jet.v, jet.a), self.of(about), strict=True):
                if np.any(part):
                    by = np.broadcast_to(np.asarray(part), n)[:, None]
                    force = force if df is None else force + df * by
                    rate = rate if dw is None else rate + dw * by
        return force, rate

    def of(self, about: TurnAxis) -> tuple[tuple[Array | None, Array | None], ...]:
        """Per unit of angle, rate and acceleration: change of force and of rate, (n, 3) each; None
        where there is none.
        """
        if about not in self._kept:
            self._kept[about] = tuple(self._probed(about, k) for k in range(3))
        return self._kept[about]

    def _probed(self, about: TurnAxis, which: int) -> tuple[Array | None, Array | None]:
        up, down = (
            force_and_rate(
                self.setup,
                self.drive,
                [_probe(about, [sign * STEP * (k == which) for k in range(3)])],
            )
            for sign in (1, -1)
        )
        force, rate = ((one - other) / (2 * STEP) for one, other in zip(up, down, strict=True))
        return (force if force.any() else None), (rate if rate.any() else None)


def _probe(about: TurnAxis, jet: Sequence[float]) -> Effect:
    small = Jet(*jet)
    if about[0] == "axis":
        return replace(_AngleProbe(axis=about[1]), jet=small)
    return replace(_TurnProbe(), slot=about[0], turn=Turn(about[1], small))


Some = TypeVar("Some", bound=Effect)
Channels = dict[tuple[str, int], "np.ndarray[tuple[int], np.dtype[np.float32]]"]
Answers = dict[str, tuple[Array | None, ...]]
"""By sensor: change of its reading by one of a curve's value, rate and acceleration, SI, (n, k)
each; None where there is none.
"""


class NominalMotion:
    """The nominal motion at some rows, and what an effect changes against it.

    Args:
        setup: site, rig, sensors.
        course: what the table does.
        time: of the rows, s, (n,).
        matrices: of each sensor by name, (k, 3): reading per unit of force or rate in the body
            frame; the nominal one unless given. A FOG's is (1, 1).
    """

    def __init__(
        self, setup: Setup, course: Course, time: Array, matrices: Mapping[str, Array] | None = None
    ) -> None:
        self.setup, self.course, self.time = setup, course, time
        self.matrices = matrices or {}
        self.drive = course.drive(time)
        motion = closed_form(setup, self.drive)
        self.sense = {s.name: make_sense(s, setup, motion, self.drive) for s in setup.sensor}
        self.ideal = {name: sense.true_input() for name, sense in self.sense.items()}
        self.responses = Responses(setup, self.drive)
        self._slopes: tuple[Array, Array] | None = None
        # of the last request: the next is often the same, at another stage
        self._curve: tuple[tuple[object, ...], Jet] | None = None

    @classmethod
    def of(cls, setup: Setup, course: Course, time: Array) -> "NominalMotion":
        """The nominal motion, of each sensor where it sits. time: s, (n,)."""
        positions = dict.fromkeys(s.place for s in setup.sensor)
        if len(positions) < 2 and None in positions:
            return cls(setup, course, time)
        parts = []
        for position in positions:
            own = tuple(s for s in setup.sensor if s.place == position)
            parts.append(
                cls(setup.seen_by(own[0]).model_copy(update={"sensor": own}), course, time)
            )
        return parts[0] if len(parts) == 1 else SeveralPositions(setup, parts)

    def through(self, matrices: Mapping[str, Array]) -> "NominalMotion":
        """The same motion through other sensor matrices. matrices: by sensor, (axes, 3)."""
        other = copy(self)
        other.matrices = matrices
        return other

    def changes(self, effect: Effect, others: Sequence[Effect] = ()) -> dict[str, Array]:
        """Change of the readings of each sensor that changes, SI, (n, k).

        Args:
            effect: effect that acts.
            others: see ``Responses.turns``.

        """
        if isinstance(effect, DelayEffect):
            return self._delayed(effect)
        if isinstance(effect, SignalEffect):
            changes = {str(effect.sensor): self._signal(effect)}
        else:
            changes = self._moved(effect, others)
        return {name: self._converted(name, change, effect) for name, change in changes.items()}

    def by_motion(self, axis: str, change: Jet) -> dict[str, Array]:
        """Change of the readings of each sensor by a small one of the motion of an axis, SI, (n,
        k).

        Args:
            axis: axis that moves.
            change: (n,).
        """
        force, rate = self.responses.to({("axis", axis): change})
        return {name: self._to_reading(name, c) for name, c in self._read(force, rate).items()}

    def _encoded(self, turns: Mapping[TurnAxis, Jet]) -> dict[str, Array]:
        """What the encoders read of small turns that they see, SI, (n, 1)."""
        n = len(self.time)
        return {
            s.name: np.array(np.broadcast_to(turns["axis", s.of].x, n))[:, None]
            for s in self.setup.sensor
            if s.of is not None and ("axis", s.of) in turns
        }

    def curve(self, effect: Learned) -> Jet:
        """The curve of each coefficient of a learned effect at one, (n, p), without the input that
        it multiplies.
        """
        if self._curve is None or self._curve[0] != effect.curve_id:
            if isinstance(effect, LearnedReading) and not effect.beside:
                name = str(effect.sensor)
                own = self.ideal[name][:, effect.channel(self.sense[name])]
                curve = Jet(effect.curves(self.sense[name], own))
            else:
                curve = effect.each_along(self.drive, self.responses.nominal.gravity_in_body)
            self._curve = effect.curve_id, curve
        return self._curve[1]

    def answers(self, effect: Learned) -> Answers:
        """What the readings of each sensor answer to one of the curve of a learned effect."""
        if isinstance(effect, LearnedReading):
            name = str(effect.sensor)
            own, channel = np.zeros_like(self.ideal[name]), effect.channel(self.sense[name])
            own[:, channel] = self.ideal[name][:, channel] if effect.per_input else 1.0
            return {name: (self._converted(name, own, effect), None, None)}
        if isinstance(effect, LearnedDelay):
            return {n: (-slope, None, None) for n, slope in self.slopes(effect.sensor).items()}
        assert isinstance(effect, LearnedReadout | LearnedTilt)
        tilt = isinstance(effect, LearnedTilt)
        position = (effect.slot, effect.turn) if tilt else ("axis", str(effect.axis))
        parts = [self._answered(force, rate, effect) for force, rate in self.responses.of(position)]
        return {name: tuple(part.get(name) for part in parts) for name in self.sense}

    def _answered(
        self, force: Array | None, rate: Array | None, effect: Effect
    ) -> dict[str, Array]:
        """What a change of force and rate, (n, 3), does to the sensors that it changes."""
        none = np.zeros((len(self.time), 3))
        read = self._read(none if force is None else force, none if rate is None else rate)
        return {n: self._converted(n, part, effect) for n, part in read.items() if part.any()}

    def _converted(self, name: str, change: Array, effect: Effect) -> Array:
        """The change of the output of an inclinometer, where the effect acts on the force it
        senses.
        """
        return (
            change if getattr(effect, "order", 0) >= CONVERSION else self._to_reading(name, change)
        )

    def _to_reading(self, name: str, change: Array) -> Array:
        """What a sensor states of a change of what it senses: of an inclinometer d asin(f/g) = df /
        (g cos).
        """
        if self.setup.named(name).kind != "inclinometer":
            return change
        g = self.setup.site.gravity
        return change / np.sqrt(np.maximum(g * g - self.ideal[name] ** 2, (1e-3 * g) ** 2))

    def _signal(self, effect: SignalEffect) -> Array:
        """Change of a reading by an effect of the sensor or its electronics."""
        sensor = self.setup.named(str(effect.sensor))
        start = self.ideal[sensor.name]
        if effect.order >= CONVERSION and sensor.kind == "inclinometer":
            start = tilt_of_force(start, self.setup.site.gravity)
        sense = self.sense[sensor.name]
        small = replace(
            effect,
            values={**effect.values, **{n: effect.straight * v for n, v in effect.sizes.items()}},
        )
        # the last samples of a loss have none
        up = np.nan_to_num(small.apply(start.copy(), sense, None) - start) / effect.straight
        if one_sided(effect):
            return up
        return (
            up - (effect_down(small).apply(start.copy(), sense, None) - start) / effect.straight
        ) / 2

    def _moved(self, effect: Effect, others: Sequence[Effect]) -> dict[str, Array]:
        """Change of every sensor's reading by what moves differently."""
        if moves_smoothly(effect):
            turns = self.responses.turns(effect, others)
            if not one_sided(effect):
                down = self.responses.turns(effect_down(effect), others)
                turns = {
                    position: (jet - down[position]).scaled(0.5) for position, jet in turns.items()
                }
            seen = self._encoded(turns) if effect.of_drive else {}
            return self._read(*self.responses.to(turns)) | seen
        up = force_and_rate(self.setup, self.drive, [effect])
        if one_sided(effect):
            base = next(iter(self.sense.values()))
            return self._read(up[0] - base.force, up[1] - base.rate)
        low = force_and_rate(self.setup, self.drive, [effect_down(effect)])
        return self._read((up[0] - low[0]) / 2, (up[1] - low[1]) / 2)

    def _read(self, force: Array, rate: Array) -> dict[str, Array]:
        """What a change of force and rate in the body frame, (n, 3) each, does to each sensor."""
        found = {}
        for name, sense in self.sense.items():
            if sense.encoded is not None:
                found[name] = np.zeros((len(force), 1))
                continue
            source = force if sense.kind in ACCELEROMETERS else rate
            if sense.kind == "fog":
                matrix = sense.input_vector[None, :]
            else:
                matrix = self.matrices.get(name, np.eye(3)[list(sense.axes)])
            found[name] = source @ matrix.T
        return found

    def slopes(self, sensor: str | None) -> dict[str, Array]:
        """Time derivatives of the readings of a sensor, or of all, by a millisecond's step, SI per
        s, (n, k).
        """
        if self._slopes is None:
            step = 5e-4
            ahead, behind = (
                force_and_rate(self.setup, self.course.drive(self.time + sign * step))
                for sign in (1, -1)
            )
            self._slopes = (ahead[0] - behind[0]) / (2 * step), (ahead[1] - behind[1]) / (2 * step)
        read = self._read(*self._slopes) | self._encoded(
            {("axis", n): Jet(jet.v) for n, jet in self.drive.axes.items()}
        )
        return {n: self._to_reading(n, slope) for n, slope in read.items() if sensor in (None, n)}

    def _delayed(self, effect: DelayEffect) -> dict[str, Array]:
        """Change of a sensor's reading by a delay: minus the delay times its time derivative. One
        that names no sensor is the recorder's own: all sensors alike.
        """
        return {
            name: np.column_stack(
                [
                    -effect.delay(self.drive.elapsed, k, None) * column
                    for k, column in enumerate(slopes.T)
                ]
            )
            for name, slopes in self.slopes(effect.sensor).items()
        }


class SeveralPositions(NominalMotion):
    """The nominal motion of sensors at several positions of one model.

    Args:
        setup: with all sensors.
        parts: one for each position.
    """

    def __init__(self, setup: Setup, parts: Sequence[NominalMotion]) -> None:
        self.setup, self.parts = setup, tuple(parts)
        self.course, self.time, self.drive = parts[0].course, parts[0].time, parts[0].drive
        self.sense = {name: sense for p in parts for name, sense in p.sense.items()}
        self.ideal = {name: values for p in parts for name, values in p.ideal.items()}

    def through(self, matrices: Mapping[str, Array]) -> NominalMotion:
        """The same motion through other sensor matrices, by sensor, (axes, 3)."""
        return SeveralPositions(self.setup, [part.through(matrices) for part in self.parts])

    def by_motion(self, axis: str, change: Jet) -> dict[str, Array]:
        """Change of the readings of each sensor by a small one of the motion of an axis, SI, (n,
        k).

        Args:
            axis: axis that moves.
            change: (n,).
        """
        return {n: read for p in self.parts for n, read in p.by_motion(axis, change).items()}

    def changes(self, effect: Effect, others: Sequence[Effect] = ()) -> dict[str, Array]:
        """Change of the readings of each sensor that changes, SI, (n, k).

        Args:
            effect: effect that acts.
            others: see ``Responses.turns``.

        """
        found: dict[str, Array] = {}
        for part in self._moved_by(effect):
            found |= part.changes(effect, others)
        return found

    def curve(self, effect: Learned) -> Jet:
        """The curve of each coefficient of a learned effect at one, (n, p)."""
        return self._moved_by(effect)[0].curve(effect)

    def answers(self, effect: Learned) -> Answers:
        """What the readings of each sensor answer to one of the curve of a learned effect."""
        found: Answers = {}
        for part in self._moved_by(effect):
            found |= part.answers(effect)
        return found

    def slopes(self, sensor: str | None) -> dict[str, Array]:
        """Time derivatives of the readings of a sensor, or of all, SI per s, (n, k)."""
        return {n: slope for part in self.parts for n, slope in part.slopes(sensor).items()}

    def _moved_by(self, effect: Effect) -> Sequence[NominalMotion]:
        """The positions that see an effect: all, or that of its sensor."""
        return [p for p in self.parts if effect.sensor is None or effect.sensor in p.sense]


def one_sided(effect: Effect) -> bool:
    """Whether one step up suffices: a linear effect, or a size that has no negative side."""
    return effect.linear or any(p.positive and not p.is_shape for p in effect.parameters)


def effect_down(effect: Some) -> Some:
    """The effect with the sign of its size turned, its shape kept."""
    return replace(effect, values={**effect.values, **{n: -v for n, v in effect.sizes.items()}})
