"""Terms over temperature: what a temperature column says of them, and readings less their share."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.effects.hysteresis_and_lag import recursion, rounded_play
from tiltcal.setup.sensor import Sensor

OWNER = "temperature"  # of the parameters that all sensors share
SHORTEST = 1e-12  # s, of a time constant
ROUNDS = 6  # each reduces the error by the size of the axes' terms over temperature


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


@dataclass(frozen=True)
class ThermalTerms:
    """The terms of a calibration over temperature.

    Args:
        reference: T0, degC; smoothing: s; memory: of the temperature.
        values: of the parameters, by name.
    """

    reference: float
    smoothing: float
    memory: Memory
    values: Mapping[str, float]

    @classmethod
    def among(cls, values: Mapping[str, float]) -> "ThermalTerms | None":
        """Those of a calibration's parameters; None where it has none."""
        if f"{OWNER}.T0" not in values:
            return None
        memory = Memory()
        for kind in ("lag", "hysteresis"):
            if f"{OWNER}.{kind}" in values:
                memory = Memory(kind, values[f"{OWNER}.{kind}"])
        return cls(values[f"{OWNER}.T0"], values[f"{OWNER}.smoothing"], memory, values)

    def order(self, sensor: str, term: str) -> int:
        """The highest power of temperature in a term of a sensor."""
        powers = (
            int(name.split(".temp")[1].split("_")[0])
            for name in self.values
            if name.startswith(f"{sensor}.temp") and f"_{term}_" in name and ".tempmem" not in name
        )
        return max(powers, default=0)

    def coefficient(self, sensor: str, power: int, term: str) -> float:
        """``<sensor>.temp<power>_<term>``; 0 where it was not estimated."""
        return self.values.get(f"{sensor}.temp{power}_{term}", 0.0)

    def bias(self, sensor: Sensor, course: TemperatureCourse) -> Array:
        """What temperature adds to the readings whatever acts, SI, (n, k)."""
        warm = course.level - self.reference
        found = np.zeros((len(warm), len(sensor.axes)))
        order = self.order(sensor.name, "bias")
        for i, axis in enumerate(sensor.axes):
            for power in range(order, 0, -1):
                found[:, i] = (
                    found[:, i] + self.coefficient(sensor.name, power, f"bias_{axis}")
                ) * warm
            found[:, i] += self.values.get(f"{sensor.name}.tempmem_{axis}", 0.0) * course.memory
        return found

    def axes_order(self, sensor: str) -> int:
        """The highest power of temperature in scale and cross-axis terms of a sensor."""
        return max(self.order(sensor, "scale"), self.order(sensor, "cross"))

    def axis_term(self, sensor: Sensor, i: int, j: int) -> str:
        """``scale_x`` or ``cross_xy``: the term of channel i by what acts along body axis j."""
        axis = sensor.axes[i]
        return f"scale_{axis}" if j == sensor.axis_indices[i] else f"cross_{axis}{'xyz'[j]}"

    def sensitivity(self, sensor: Sensor, course: TemperatureCourse) -> Array:
        """What temperature adds to the sensitivity matrix, (n, k, 3)."""
        warm = course.level - self.reference
        found = np.zeros((len(warm), len(sensor.axes), 3))
        for i in range(len(sensor.axes)):
            for j in range(3):
                term = self.axis_term(sensor, i, j)
                for power in range(self.axes_order(sensor.name), 0, -1):
                    slope = self.coefficient(sensor.name, power, term)
                    found[:, i, j] = (found[:, i, j] + slope) * warm
        return found

    def corrected(
        self,
        sensor: Sensor,
        readings: Array,
        course: TemperatureCourse,
        correct: Callable[[Array], Array],
    ) -> Array:
        """Readings corrected for temperature and all else, SI, (n, k).

        Args:
            sensor: which.
            readings: SI, in the sensing form, (n, k).
            course: of the temperature at the same rows.
            correct: the correction without temperature.
        """
        level = readings - self.bias(sensor, course)
        found = correct(level)
        if not self.axes_order(sensor.name) or len(sensor.axes) != 3:
            return found
        slope = self.sensitivity(sensor, course)
        for _ in range(ROUNDS):
            found = correct(level - np.einsum("nij,nj->ni", slope, found))
        return found


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
    """Thermal terms over the pieces of a recording: each goes on where the last one ended."""

    terms: ThermalTerms
    last: TemperatureCourse | None = None
    reading: float = np.nan

    def course(self, time: Array, temperature: Array) -> TemperatureCourse:
        """The course over the next piece; temperature: degC, NaN where it was not read, (n,)."""
        known = held(temperature, self.reading)
        found = TemperatureCourse.of(
            time, known, self.terms.smoothing, self.terms.memory, self.last
        )
        self.last, self.reading = found.last(), float(known[-1])
        return found


def at_rows(course: TemperatureCourse, rows: Index) -> TemperatureCourse:
    """The course at some rows. rows: (m,)."""
    return replace(
        course, time=course.time[rows], level=course.level[rows], memory=course.memory[rows]
    )
