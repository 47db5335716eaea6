"""What an effect is. One class holds one physical effect, written once: injected, fitted, named,
printed and tested from it. What else is known of it, such as the shapes that a scan tries, is in
``traits``.

The places where an effect may act, each an abstract class that asks one question:

====================  ===========================================================
==========================
WorldEffect           how does the world differ?                                   gravity, Earth,
lever arm
AngleEffect           where does the axis truly stand, given the readout?          encoder, sag,
backlash
FrameEffect           which small turns does a frame gain?                         levelling,
wobble, mount
DelayEffect           how much earlier was the signal taken than its stamp says?   latency, jitter
SignalEffect          what does the reading become?                                sensor,
electronics, data
====================  ===========================================================
==========================
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import ClassVar, Literal

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import PARAMETER_UNITS
from tiltcal.effects.mechanisms import Context, Mechanism, Turn, World
from tiltcal.effects.traits import Traits
from tiltcal.setup.setup import Rig, Sensor
from tiltcal.setup.tables import Table, tables
from tiltcal.setup.trajectory import Drive, Jet, Rests

Stage = Literal["environment", "table", "mount", "sensor", "electronics", "timing", "data"]
STAGES: tuple[Stage, ...] = (
    "environment",
    "table",
    "mount",
    "sensor",
    "electronics",
    "timing",
    "data",
)
GRADES = ("precision", "mid_mems", "consumer")
"""Grades of instruments, for which plausible sizes are stated."""
Need = Literal["pose", "motion", "direction", "temperature", "vibration", "time", "remount", "any"]
"""What a recording has to hold for an effect to show: several poses, motion, both directions of
approach, ...
"""
ACCELEROMETERS = frozenset({"accelerometer", "inclinometer"})


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect.

    Args:
        name: without unit; ``{axis}`` stands for each axis of the sensor, ``{pair}`` for each
            ordered pair of different axes, ``{matrix}`` for each axis with each direction x, y, z.
        unit: as its suffix in files; empty for a plain count.
        plausible: largest typical size at the grades precision laboratory, mid MEMS, consumer, in
            ``unit``.
        positive: whether only values >= 0 make sense (a width, a time constant, a standard
            deviation).
        default: SI value when a scenario leaves it out.
        shape: whether it says when, how fast or how wide and not how much; so does everything with
            a default.
        whole: whether it counts what comes in ones.
        tables: names of the tables that have it; empty: any.
    """

    name: str
    unit: str
    plausible: tuple[float, float, float]
    positive: bool = False
    default: float = 0.0
    shape: bool = False
    whole: bool = False
    tables: frozenset[str] = frozenset()

    def stands_on(self, rig: Rig) -> bool:
        """Whether the table of a rig has it."""
        return not self.tables or rig.table in self.tables

    def expand(self, axes: Sequence[str]) -> list[str]:
        """Bare names for a sensor with these axes."""
        if "{axis}" in self.name:
            return [self.name.format(axis=a) for a in axes]
        if "{matrix}" in self.name:
            return [self.name.format(matrix=a + b) for a in axes for b in "xyz"]
        if "{pair}" in self.name:  # an inclinometer's two channels still see all three components
            return [self.name.format(pair=a + b) for a in axes for b in "xyz" if a != b]
        return [self.name]

    @property
    def is_shape(self) -> bool:
        """Whether the effect stays nothing when only this is given."""
        return self.shape or self.default != 0

    @property
    def suffix(self) -> str:
        """What its name ends in, in files."""
        return f"_{self.unit}" if self.unit else ""

    @property
    def factor(self) -> float:
        """SI value of one ``unit``."""
        return PARAMETER_UNITS[self.unit].factor


@dataclass(frozen=True)
class PerTable:
    """Parameters whose names follow from the axes of a table: those of all tables together.

    Args:
        names: bare names on one table.
        unit, plausible: as of a Parameter.
        order: names that come first, in this order.
    """

    names: Callable[[Table], Sequence[str]]
    unit: str
    plausible: tuple[float, float, float]
    order: Callable[[], Sequence[str]] = tuple

    def __get__(self, effect: "Effect | None", cls: type["Effect"]) -> tuple[Parameter, ...]:
        return _on_all_tables(self)


@cache
def _on_all_tables(each: PerTable) -> tuple[Parameter, ...]:
    found: dict[str, set[str]] = {name: set() for name in each.order()}
    for table in tables().values():
        for name in each.names(table):
            found.setdefault(name, set()).add(table.name)
    return tuple(
        Parameter(name, each.unit, each.plausible, tables=frozenset(of))
        for name, of in found.items()
    )


Streams = Callable[["Effect"], np.random.Generator | None]
"""A fresh random stream for an effect, the same each time it is asked; None when random effects are
switched off.
"""


def no_streams(effect: "Effect") -> None:
    """Random effects switched off."""


@dataclass(frozen=True)
class Effect(Traits, ABC):
    """One physical effect at some size. All parameters zero: nothing happens.

    Args:
        values: SI value of each bare parameter name; names left out have their default.
        sensor: name of the sensor it acts on, for sensor, electronics, timing and data effects.
        axis: table axis it acts on, for effects of one axis.
        role: "calibration" or "found" in an amended scenario.
        sigmas: standard uncertainty of some values, SI.
        fit: whether a diagnosis may re-fit it.
        seen_in: fingerprint of the recording that an event happened in; other recordings come after
            it.
    """

    values: Mapping[str, float] = field(default_factory=dict)
    sensor: str | None = None
    axis: str | None = None
    role: str | None = None
    sigmas: Mapping[str, float] = field(default_factory=dict)
    fit: bool = False
    seen_in: str | None = None

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
    sharp: ClassVar[bool] = (
        # it jumps with what it acts on: a mean over samples is not what it does at their middle
        False
    )
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
        return not cls.seen_by_encoder or rig.readout == "command"

    @classmethod
    def senses(cls, kind: str) -> bool:
        """Whether it acts on a kind of sensor, in the unit of its sizes."""
        accelerations = any(p.unit.split("_")[0] == "ug" for p in cls.parameters)
        return kind in cls.kinds and (kind in ACCELEROMETERS or not accelerations)

    @classmethod
    def sizes_on(cls, channels: Sequence[str], rig: Rig) -> dict[str, Parameter]:
        """The sizes by their bare names, for a sensor with these channels on a rig."""
        sizes = [p for p in cls.parameters if not p.is_shape and p.stands_on(rig)]
        return {n: p for p in sizes for n in p.expand(channels)}

    def value(self, name: str) -> float:
        """SI value of a bare parameter name."""
        if name in self.values:
            return self.values[name]
        return next((p.default for p in self.parameters if p.name == name), 0.0)

    @property
    def is_identity(self) -> bool:
        """Whether it does nothing."""
        return not any(self.sizes.values())

    @property
    def sizes(self) -> dict[str, float]:
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
        """Its face in a run by time steps; none: the algebra adds it afterwards."""
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

    def dynamics(self, rig: Rig, gravity: float) -> tuple[Mechanism, ...]:
        """Its face in a run by time steps; none: the reader turns the frame afterwards."""
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
        """The readout behind a written one, as far as it can be told, rad, (n,)."""
        return written

    def stamps(self, time: Array) -> Array:
        """The stamps as written, s, (n,)."""
        return time


class DelayEffect(Effect):
    """How much earlier was the signal taken than its stamp says?"""

    @abstractmethod
    def delay(self, elapsed: Array, channel: int, rng: np.random.Generator | None) -> Array | float:
        """Stamp minus true instant for one channel, s, (n,) or a number. elapsed: s since the first
        stamp, (n,).
        """


@dataclass(frozen=True)
class Sense:
    """What a sensor senses, and what its channels are.

    Args:
        time: s, (n,); elapsed: since the first stamp.
        force: specific force, body frame, m/s2, (n, 3).
        rate: angular rate against inertial space, body frame, rad/s, (n, 3).
        up, north: the world's up and table North in the body frame, (n, 3).
        angular_acceleration: rad/s2, (n, 3).
        temperature: minus T0, K, (n,).
        axes: body axis of each channel, (k,).
        kind: of the sensor; input_vector: of a FOG, (3,).
        gravity: stated, m/s2; rate_hz: nominal sample rate; full_scale: SI, or None.
        angles: readout of each table axis, rad, (n,); stop: number of the stop of each row, -1
            while moving, (n,).
        rests: says when each rest began and ended; None: with the first and the last row of a stop.
    """

    time: Array
    elapsed: Array
    force: Array
    rate: Array
    up: Array
    north: Array
    angular_acceleration: Array
    temperature: Array
    axes: tuple[int, ...]
    kind: str
    input_vector: Array
    gravity: float
    rate_hz: float
    full_scale: float | None = None
    angles: Mapping[str, Array] = field(default_factory=dict)
    stop: "np.ndarray[tuple[int], np.dtype[np.intp]] | None" = None
    rests: Callable[[], Rests] | None = None

    @cached_property
    def since_move(self) -> Array:
        """Time since the last move ended, s, (n,); 0 while moving."""
        return self._rests.since(self.time)

    @cached_property
    def moves(self) -> Array:
        """How many moves have begun, (n,)."""
        return self._rests.moves(self.time)

    @property
    def _rests(self) -> Rests:
        return Rests.told(
            self.rests,
            self.time,
            np.zeros(len(self.time), np.intp) if self.stop is None else self.stop,
        )

    @classmethod
    def at_rest(cls, sensor: Sensor, gravity: float, force: Array) -> "Sense":
        """What a sensor senses at rest at T0 under given specific forces, (m, 3), one row a pose,
        ages apart.
        """
        still, zero = np.zeros(len(force)), np.zeros_like(force)
        ages = 1e9 * np.arange(len(force), dtype=float)
        return cls(
            ages,
            still,
            force,
            zero,
            force / gravity,
            zero,
            zero,
            still,
            sensor.axis_indices,
            sensor.kind,
            np.zeros(3),
            gravity,
            sensor.rate_hz,
            sensor.full_scale,
        )

    def true_input(self) -> Array:
        """The ideal reading, (n, k): force or rate along each channel, before any error."""
        if self.kind == "fog":
            return np.asarray(self.rate @ self.input_vector)[:, None]
        source = self.force if self.kind in ACCELEROMETERS else self.rate
        return np.array(source[:, list(self.axes)])


class SignalEffect(Effect):
    """What does the reading become? ``order`` sorts the effects inside the chain (CONTRACT: order
    of the chain).

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


class TermEffect(SignalEffect):
    """A sum of terms that are added to the reading, each linear in one parameter: exact and cheap
    columns.
    """

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
