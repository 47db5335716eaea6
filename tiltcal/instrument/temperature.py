"""Terms over temperature: what a sensor adds to its reading by temperature and by earlier
temperatures, and the course of the temperature as these terms follow it.
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.effects.base import RowWiseTerm
from tiltcal.effects.hysteresis_and_lag import recursion, rounded_play
from tiltcal.effects.parameter import Parameter, Stage
from tiltcal.effects.sense import ACCELEROMETERS, Sense
from tiltcal.effects.sensor.environmental import GYROS

SHORTEST = 1e-12  # s, of a time constant
BIAS_ORDERS = 6  # powers of temperature in the bias: below this
AXIS_ORDERS = 4  # in scale factor and cross-axis terms


@dataclass(frozen=True)
class Memory:
    """What remains of earlier temperatures.

    Args:
        kind: none; lag, ``T - T_lagged`` with a time constant in s; or hysteresis, a state in
            -1 ... 1 that a change of some degC turns over (Dahl 1968).
        size: the time constant, s, or the change, degC.
    """

    kind: str = "none"
    size: float = 0.0

    def words(self) -> str:
        """The kind with its size."""
        if self.kind == "none":
            return "no memory"
        unit = "s" if self.kind == "lag" else "degC"
        return f"{self.kind} of {self.size:.3g} {unit}"


@dataclass(frozen=True)
class TemperatureCourse:
    """A temperature column as the terms see it.

    Args:
        time: s; level: smoothed by a first-order low-pass, degC; memory: of it, (n,) each.
    """

    time: Array
    level: Array
    memory: Array

    @classmethod
    def of(
        cls,
        time: Array,
        temperature: Array,
        smoothing: float,
        memory: Memory,
        before: "TemperatureCourse | None" = None,
    ) -> "TemperatureCourse":
        """From readings; ``before`` is the course up to here, where a recording comes in pieces.

        Args:
            time: s.
            temperature: degC, (n,), no gaps.
            smoothing: time constant of the low-pass that takes noise and codes off, s.
            memory: that is followed.
            before: the pieces before this one.
        """
        past_time = time[0] if before is None else before.time[-1]
        start = temperature[0] if before is None else before.level[-1]
        step = np.diff(time, prepend=past_time)
        level = _low_pass(step, temperature, smoothing, float(start))
        if memory.kind == "lag":
            lagged = level[0] if before is None else before.level[-1] - before.memory[-1]
            state = level - _low_pass(step, level, memory.size, float(lagged))
        elif memory.kind == "hysteresis":
            past = (level[0], 0.0) if before is None else (before.level[-1], before.memory[-1])
            course = np.concatenate([[past[0]], level])
            state = rounded_play(course, memory.size, float(past[1]))[1:]
        else:
            state = np.zeros_like(level)
        return cls(time, level, state)

    def last(self) -> "TemperatureCourse":
        """Its end, from which the next piece goes on."""
        return TemperatureCourse(self.time[-1:], self.level[-1:], self.memory[-1:])


def _low_pass(step: Array, values: Array, constant: float, start: float) -> Array:
    """First-order low-pass over unequal steps, from a start before the first value."""
    decay = np.exp(-np.maximum(step, 0.0) / max(constant, SHORTEST))
    return recursion(decay, np.concatenate([[start], (1 - decay) * values]))[1:]


def _term(name: str) -> Parameter:
    """A coefficient in SI of the channel per power of degC."""
    return Parameter(name, "si", (0, 0, 0))


class TemperatureTerms(RowWiseTerm):
    """Powers of temperature in bias, scale factor and cross-axis terms, and a memory of earlier
    temperatures in the bias.

    ``temp<n>_bias_<axis>``, ``temp<n>_scale_<axis>``, ``temp<n>_cross_<pair>`` multiply ``(T -
    T0)^n``; ``tempmem_<axis>`` multiplies the memory. ``lag`` (s) or ``hysteresis`` (degC) state
    what the memory is, ``smoothing`` (s) the low-pass of the thermometer.
    """

    id: ClassVar[str] = "temperature_terms"
    stage: ClassVar[Stage] = "sensor"
    kinds: ClassVar[frozenset[str]] = ACCELEROMETERS | GYROS
    order: ClassVar[int] = 20
    title: ClassVar[str] = "terms over temperature"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        *(_term(f"temp{n}_bias_{{axis}}") for n in range(1, BIAS_ORDERS)),
        *(_term(f"temp{n}_scale_{{axis}}") for n in range(1, AXIS_ORDERS)),
        *(_term(f"temp{n}_cross_{{pair}}") for n in range(1, AXIS_ORDERS)),
        _term("tempmem_{axis}"),
        Parameter("smoothing", "s", (0, 0, 0), positive=True, shape=True),
        Parameter("lag", "s", (0, 0, 0), positive=True, shape=True),
        Parameter("hysteresis", "degC", (0, 0, 0), positive=True, shape=True),
    )
    equation: ClassVar[str] = (
        "reading_i += sum_n (T - T0)^n (b_n,i + S_n,i f_i + sum_j C_n,ij f_j) + m_i h(T)"
    )

    @property
    def memory(self) -> Memory:
        """What remains of earlier temperatures."""
        for kind in ("lag", "hysteresis"):
            if self.value(kind):
                return Memory(kind, self.value(kind))
        return Memory()

    def course(
        self, time: Array, temperature: Array, before: "TemperatureCourse | None" = None
    ) -> "TemperatureCourse":
        """The temperature as these terms follow it.

        Args:
            time: s, (n,).
            temperature: degC, (n,).
            before: of an earlier piece of the recording.
        """
        return TemperatureCourse.of(time, temperature, self.value("smoothing"), self.memory, before)

    def term(self, name: str, sense: Sense) -> tuple[int, Array]:
        """Channel and column of a coefficient, SI per unit, (n,): see ``TermEffect``."""
        kind, _, which = name.partition("_")
        if kind == "tempmem":
            return self.channel_of(which, sense), self._memory_of(sense)
        term, _, axes = which.partition("_")
        channel = self.channel_of(axes[0], sense)
        column = sense.temperature ** int(kind.removeprefix("temp"))
        if term == "scale":
            column = column * sense.true_input()[:, max(channel, 0)]
        elif term == "cross":
            column = column * sense.vector_input()[:, "xyz".index(axes[1])]
        return channel, column

    def _memory_of(self, sense: Sense) -> Array:
        if sense.temperature_memory is not None:
            return sense.temperature_memory
        return self.course(sense.time, sense.temperature).memory


def held(values: Array, start: float = np.nan) -> Array:
    """Values with the last known one held where there is none; before the first, ``start`` or the
    first known, (n,). start: in the unit of the values.
    """
    known = np.flatnonzero(~np.isnan(values))
    if not len(known):
        return np.full(len(values), start)
    place = np.searchsorted(known, np.arange(len(values)), side="right") - 1
    first = values[known[0]] if np.isnan(start) else start
    return np.where(place >= 0, values[known[np.maximum(place, 0)]], first)


@dataclass
class ThermalStream:
    """Terms over temperature along the pieces of a recording: each continues the last one."""

    terms: TemperatureTerms
    last: TemperatureCourse | None = None
    reading: float = np.nan

    def course(self, time: Array, temperature: Array) -> TemperatureCourse:
        """The course over the next piece; temperature: degC, NaN where it was not read, (n,)."""
        known = held(temperature, self.reading)
        found = self.terms.course(time, known, self.last)
        self.last, self.reading = found.last(), float(known[-1])
        return found


def at_rows(course: TemperatureCourse, rows: Index) -> TemperatureCourse:
    """The course at some rows. rows: (m,)."""
    return replace(
        course, time=course.time[rows], level=course.level[rows], memory=course.memory[rows]
    )
