"""Effects. One class is one physical effect: injected, fitted, named, printed and
tested from it. Further properties, such as the shapes that a scan tries: ``traits``.

The stages at which an effect may act, each an abstract class that answers one question:

==============  =============================================  ===========================
WorldEffect     how does the world differ?                     gravity, Earth, lever arm
AngleEffect     where does the axis truly stand?               encoder, sag, backlash
FrameEffect     which small turns does a frame gain?           levelling, wobble, mount
DelayEffect     how much before its stamp was it taken?        latency, jitter
SignalEffect    what does the reading become?                  sensor, electronics, data
==============  =============================================  ===========================
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.effects.mechanisms import Compliance, Context, Mechanism, Turn, World
from tiltcal.effects.parameter import Need, Parameter, Stage
from tiltcal.effects.sense import ACCELEROMETERS, Sense
from tiltcal.effects.stepwise import Memoryless, StepEffect, Stepping
from tiltcal.effects.traits import Traits
from tiltcal.setup.setup import Rig
from tiltcal.setup.trajectory import Drive, Jet


@dataclass(frozen=True)
class Effect(Traits, ABC):
    """One physical effect at some size. All parameters zero: nothing happens.

    Args:
        values: SI value of each parameter name; names left out have their default.
        sensor: name of the sensor it acts on, for sensor, electronics, timing and data effects.
        axis: table axis it acts on, for effects of one axis.
        role: "calibration" or "found" in an amended scenario.
        sigmas: standard uncertainty of some values, SI.
        fit: whether a diagnosis may re-fit it.
        seen_in: fingerprint of the recording that an event happened in; others come after it.
        earlier: fingerprints of recordings that were made before the event.
        lasts: whether what happened in one recording stays in those after it.
    """

    values: Mapping[str, float] = field(default_factory=dict)
    sensor: str | None = None
    axis: str | None = None
    role: str | None = None
    sigmas: Mapping[str, float] = field(default_factory=dict)
    fit: bool = False
    seen_in: str | None = None
    earlier: tuple[str, ...] = ()
    lasts: bool = True

    id: ClassVar[str] = ""
    stage: ClassVar[Stage]
    title: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]
    physics: ClassVar[str]
    equation: ClassVar[str]
    source: ClassVar[str]
    excited_by: ClassVar[str]
    needs: ClassVar[Need] = "pose"
    look: ClassVar[str]
    linear: ClassVar[bool] = False
    random: ClassVar[bool] = False
    axis_wise: ClassVar[bool] = False
    channel_wise: ClassVar[bool] = False
    sharp: ClassVar[bool] = False  # jumps: a mean over samples is not its value at their middle
    kinds: ClassVar[frozenset[str]] = frozenset()
    on_table: ClassVar[bool] = False

    @classmethod
    def has_column(cls) -> bool:
        """Whether the readings change in proportion to its sizes."""
        return not (cls.random or cls.threshold or cls.stage == "data")

    @classmethod
    def shows_on(cls, rig: Rig) -> bool:
        """Whether it shows on a rig at all: it may need a table, or be part of its readout."""
        if (cls.stage == "table" or cls.on_table) and not rig.axes:
            return False
        if cls.of_model and rig.kind.chain is None:
            return False
        return not cls.seen_by_encoder or rig.readout == "command"

    @classmethod
    def axes_on(cls, rig: Rig) -> tuple[str | None, ...]:
        """The axes of a rig that it may act on, one at a time; None alone: it acts on the whole."""
        if not cls.axis_wise:
            return (None,)
        return rig.axis_names if cls.on_slides else rig.kind.turning

    @classmethod
    def senses(cls, kind: str) -> bool:
        """Whether it acts on a kind of sensor, in the unit of its sizes."""
        accelerations = any(p.unit.split("_")[0] == "ug" for p in cls.parameters)
        return kind in cls.kinds and (kind in ACCELEROMETERS or not accelerations)

    @classmethod
    def sizes_on(cls, channels: Sequence[str], rig: Rig) -> dict[str, Parameter]:
        """The sizes by their parameter names, for a sensor with these channels on a rig."""
        sizes = [p for p in cls.parameters if p.fits_on(rig)]
        return {n: p for p in sizes for n in p.expand(channels)}

    def value(self, name: str) -> float:
        """SI value by parameter name."""
        if name in self.values:
            return self.values[name]
        return next((p.default for p in self.parameters if p.name == name), 0.0)

    @property
    def is_identity(self) -> bool:
        """Whether it does nothing."""
        return not any(self.sizes.values())

    @cached_property
    def sizes(self) -> Mapping[str, float]:
        """The values that say how much, SI; without those that give the shape."""
        shapes = {p.name for p in self.parameters if p.is_shape}
        return {name: value for name, value in self.values.items() if name not in shapes}

    @property
    def address(self) -> str:
        """``acc_K2[accel]``, ``table_backlash[outer]``: what it is and where."""
        where = self.sensor or self.axis
        return f"{self.id}[{where}]" if where else self.id


class WorldEffect(Effect):
    """How does the world differ?"""

    @abstractmethod
    def world(self, world: World) -> World:
        """The world with this effect in it."""


class AngleEffect(Effect):
    """Where does a table axis truly stand, given its readout?"""

    axis_wise: ClassVar[bool] = True
    mechanised: ClassVar[bool] = False

    @abstractmethod
    def deviation(self, drive: Drive, axis: str, rng: np.random.Generator | None) -> Jet:
        """True angle of an axis minus its readout ``drive.axes[axis]``, as a jet of shape (n,),
        rad.
        """

    def slight(self, drive: Drive, axis: str) -> Jet:
        """The deviation while it is small: to first order in its sizes."""
        return self.deviation(drive, axis, None)

    def acts_on(self, axis: str, rig: Rig) -> bool:
        """Whether it acts on that table axis (the outermost when none is named)."""
        return axis == (self.axis or rig.axis_names[0])

    def mechanisms(self, rig: Rig, gravity: float) -> tuple[Mechanism, ...]:
        """Its face in MuJoCo (gravity in m/s2), where ``mechanised``."""
        raise NotImplementedError(
            f"{self.id} is readout algebra, no mechanism: {rig.table}, {gravity}"
        )

    def dynamics(self, rig: Rig, gravity: float) -> tuple[Mechanism, ...]:
        """Its face in a run by time steps; none: the algebra adds it afterwards. gravity: m/s2."""
        return self.mechanisms(rig, gravity) if self.mechanised else ()


class FrameEffect(Effect):
    """Which small turns does a frame gain? Slots: ``base``, ``<axis>_bearing`` (stator side),
    ``mount``.
    """

    mechanised: ClassVar[bool] = False

    @abstractmethod
    def turns(self, slot: str, context: Context) -> Sequence[Turn]:
        """The turns it adds at a slot, in order; none at other slots. ``context.rng`` is its own
        stream.
        """

    def mechanisms(self, rig: Rig, gravity: float) -> tuple[Mechanism, ...]:
        """Its face in MuJoCo (gravity in m/s2), where ``mechanised``; the others are installed from
        ``turns``.
        """
        raise NotImplementedError(f"{self.id} is installed from its turns: {rig.table}, {gravity}")

    def compliances(self, rig: Rig) -> Sequence[Compliance]:
        """The springs that its turns are the equilibrium of; none: the turns are prescribed."""
        return ()

    def dynamics(self, rig: Rig, gravity: float) -> tuple[Mechanism, ...]:
        """As of an ``AngleEffect``; none: the reader turns the frame afterwards. gravity: m/s2."""
        return self.mechanisms(rig, gravity) if self.mechanised else ()


class LinkEffect(Effect):
    """How far is the frame behind a bearing displaced?"""

    @abstractmethod
    def offset(self, slot: str, rig: Rig) -> Array:
        """Displacement at a slot ``<axis>_bearing``, in the frame before it, m, (3,)."""


class WritingEffect(Effect):
    """What stands in the file instead of the table's readout, or of the time stamps?"""

    @classmethod
    def has_column(cls) -> bool:
        return False

    def written(self, axis: str, drive: Drive) -> Array | None:
        """The readout of an axis as written, rad, (n,); None where it is left alone."""
        return None

    def restored(self, axis: str, time: Array, written: Array) -> Array:
        """The readout behind a written one, as far as it can be determined, rad, (n,)."""
        return written

    def undetermined(self, axis: str, time: Array, written: Array) -> Mask | None:
        """Rows, (n,), whose motion the written readout does not determine; None: none. time: s."""
        return None

    def stamps(self, time: Array) -> Array:
        """The stamps as written, s, (n,)."""
        return time


class DelayEffect(Effect):
    """How much earlier than its stamp was the signal taken?"""

    @abstractmethod
    def delay(self, elapsed: Array, channel: int, rng: np.random.Generator | None) -> Array | float:
        """Stamp minus true instant for one channel, s, (n,) or a number. elapsed: s since the first
        stamp, (n,).
        """

    def constant(self, channel: int) -> float | None:
        """The delay of a channel, s, where it is the same at all times; None where it varies."""
        steady = self.row_wise and not self.random
        return float(np.mean(self.delay(np.zeros(1), channel, None))) if steady else None


class SignalEffect(Effect):
    """What does the reading become? ``order`` sorts the effects inside the chain
    (docs/interfaces.md, "Order of the chain").

    ``straight`` is the share of a plausible size up to which the change of the reading is in
    proportion to it.
    """

    order: ClassVar[int]
    straight: ClassVar[float] = 1.0

    @abstractmethod
    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        """The reading after the effect, (n, k), SI. ``rng`` is None when random effects are
        switched off.
        """

    def stepwise(self, stepping: Stepping) -> StepEffect | None:
        """The effect step by step; None: it needs later samples or the whole recording."""
        return Memoryless(self.apply) if self.row_wise and not self.random else None


class TermEffect(SignalEffect):
    """A sum of terms that are added to the reading, each linear in one parameter."""

    linear: ClassVar[bool] = True

    @abstractmethod
    def term(self, name: str, sense: Sense) -> tuple[int, Array]:
        """The channel a parameter adds to and its column, (n,): reading[:, channel] += value *
        column.
        """

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        for name, value in self.sizes.items():
            if value:
                channel, column = self.term(name, sense)
                if channel >= 0:
                    reading[:, channel] += value * column
        return reading

    @staticmethod
    def channel_of(axis: str, sense: Sense) -> int:
        """Channel that reads a body axis; -1 when the sensor has no such channel."""
        index = 0 if axis == "a" else "xyz".index(axis)
        return sense.axes.index(index) if index in sense.axes else -1


class RowWiseTerm(TermEffect):
    """Terms that follow what the sensor senses on their own row."""

    row_wise: ClassVar[bool] = True
