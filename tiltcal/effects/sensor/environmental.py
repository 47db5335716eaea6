"""Errors that follow temperature; memory of the force, and angular terms of an accelerometer."""

from abc import abstractmethod
from itertools import product
from typing import ClassVar

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import G0
from tiltcal.effects.base import SignalEffect, TermEffect
from tiltcal.effects.hysteresis_and_lag import play, rounded_play
from tiltcal.effects.parameter import Parameter, Stage
from tiltcal.effects.sense import ACCELEROMETERS, Sense
from tiltcal.effects.spans import CoordinateRanges
from tiltcal.effects.stepwise import Rows, StepEffect, Stepping
from tiltcal.effects.traits import Family

GYROS = frozenset({"gyro", "fog"})


class FollowsState(TermEffect):
    """A bias that follows one scalar state of the environment: reading_i += k_i state(t)."""

    stage: ClassVar[Stage] = "sensor"
    order = 20
    source = "IEEE 1293; Physics: Accelerometers and inclinometers"

    @abstractmethod
    def state(self, sense: Sense) -> Array:
        """The state, (n,)."""

    def term(self, name: str, sense: Sense) -> tuple[int, Array]:
        return self.channel_of(name[-1], sense), self.state(sense)


class FollowsTemperature(FollowsState):
    """A bias in proportion to T - T0."""

    row_wise = True

    def state(self, sense: Sense) -> Array:
        return sense.temperature


class FollowsWarming(FollowsState):
    """A bias in proportion to dT/dt, K/s."""

    def state(self, sense: Sense) -> Array:
        if len(sense.time) < 3:
            return np.zeros(len(sense.time))
        return np.gradient(sense.temperature, sense.time)


class AccTempBias(FollowsTemperature):
    id = "acc_temp_bias"
    needs = "temperature"
    kinds = ACCELEROMETERS
    title = "bias against temperature"
    parameters = (Parameter("temp_bias_{axis}", "ug_degC", (30, 150, 1000)),)
    physics = "Package stress and electronics drift with temperature."
    equation = "reading_i += k_i (T - T0)"
    excited_by = "a temperature change"
    look = "follows the temperature record, the same in every pose"
    ordinary = True
    family = Family(reading=("temperature",))
    lags_thermometer = True
    distinguished_by = {
        "acc_drift": "take the temperature up and down again",
        "acc_warmup": "restart at a settled temperature",
        "acc_bias_step": "take the temperature up and down again",
    }


class AccTempScale(TermEffect):
    row_wise = True
    id = "acc_temp_scale"
    needs = "temperature"
    stage = "sensor"
    kinds = ACCELEROMETERS
    order = 20
    title = "scale factor against temperature"
    parameters = (Parameter("temp_scale_{axis}", "ppm_degC", (180, 100, 300)),)
    physics = "Magnet or reference voltage change with temperature."
    equation = "reading_i += k_i (T - T0) f_i"
    source = "IEEE 1293; Physics: Accelerometers and inclinometers"
    excited_by = "a temperature change on a loaded axis"
    look = "temperature times its own force"
    ordinary = True
    family = Family(scale=("temperature",))
    lags_thermometer = True

    def term(self, name: str, sense: Sense) -> tuple[int, Array]:
        return (
            self.channel_of(name[-1], sense),
            sense.temperature * sense.force[:, "xyz".index(name[-1])],
        )


class AccThermalGradient(FollowsWarming):
    id = "acc_thermal_gradient"
    needs = "temperature"
    kinds = ACCELEROMETERS
    title = "bias proportional to dT/dt"
    parameters = (Parameter("temp_rate_{axis}", "ug_s_degC", (1e4, 1e5, 1e6)),)
    physics = "A gradient through the package while it warms."
    equation = "reading_i += k_i dT/dt"
    source = "Shupe 1980; Physics: Accelerometers and inclinometers"
    excited_by = "a temperature ramp"
    look = "changes sign between heating and cooling, gone when T settles"
    family = Family(reading=("warming", "temperature"))


class AccThermalHysteresis(FollowsState):
    id = "acc_thermal_hysteresis"
    needs = "temperature"
    kinds = ACCELEROMETERS
    title = "heating and cooling branches differ"
    parameters = (
        Parameter("thermal_hysteresis_{axis}", "ug", (100, 1000, 5000)),
        # a play that is wider than what moves it is in proportion to it
        Parameter("width", "degC", (5, 5, 5), positive=True, shape=True, bounded=True),
    )
    physics = "Adhesives and solder creep: the bias depends on where the temperature came from."
    equation = (
        "reading_i += h_i z(T), z the play state of the temperature; its width, where none is"
        " given, half of the span"
    )
    source = "Brokate and Sprekels 1996; Physics: Accelerometers and inclinometers"
    excited_by = "a temperature cycle"
    look = "a loop over temperature"
    family = Family(reading=("temperature", "warming"))

    @classmethod
    def shapes(cls, span: CoordinateRanges) -> list[dict[str, float]]:
        low, high = span.ranges.get("temperature", (0.0, 0.0))
        shares = (0.1, 0.2, 0.35, 0.5, 0.8) if high > low else ()
        return [{"width": share * (high - low)} for share in shares] or [{}]

    def state(self, sense: Sense) -> Array:
        return play(sense.temperature, self.value("width") or float(np.ptp(sense.temperature)) / 2)


class AccTempMisalign(TermEffect):
    row_wise = True
    id = "acc_temp_misalign"
    needs = "temperature"
    stage = "sensor"
    kinds = ACCELEROMETERS
    order = 20
    title = "axis direction against temperature"
    parameters = (Parameter("temp_cross_{pair}", "ppm_degC", (2, 20, 50)),)
    physics = "The suspension leans as it expands: the sensitive axis turns with temperature."
    equation = "reading_i += k_ij (T - T0) f_j"
    source = "IEEE 1293; Physics: Accelerometers and inclinometers"
    excited_by = "a temperature change while the other axis is loaded"
    look = "temperature times the force of another axis"
    family = Family(across=("temperature",))
    lags_thermometer = True

    def term(self, name: str, sense: Sense) -> tuple[int, Array]:
        return (
            self.channel_of(name[-2], sense),
            sense.temperature * sense.force[:, "xyz".index(name[-1])],
        )


class AccAngularTerms(TermEffect):
    row_wise = True
    id = "acc_angular_terms"
    needs = "motion"
    stage = "sensor"
    kinds = ACCELEROMETERS
    order = 12
    title = "angular rate and acceleration terms"
    parameters = (Parameter("kang_{axis}", "ug_s2_rad", (10, 100, 1000)),)
    physics = (
        "A pendulum that is not balanced about its hinge feels angular acceleration about the"
        " output axis."
    )
    equation = "reading_i += k_i dw_o/dt, o the output axis"
    source = "IEEE 1293; Physics: Accelerometers and inclinometers"
    excited_by = "starting and stopping a turn about the output axis"
    look = "pulses at the ends of moves, unlike a lever arm without a w^2 part"
    linear = True

    def term(self, name: str, sense: Sense) -> tuple[int, Array]:
        return (
            self.channel_of(name[-1], sense),
            sense.angular_acceleration[:, ("xyz".index(name[-1]) + 2) % 3],
        )


class AccHysteresis(SignalEffect):
    id = "acc_hysteresis"
    needs = "direction"
    stage = "sensor"
    kinds = ACCELEROMETERS
    order = 30
    title = "flexure or package memory"
    parameters = (
        Parameter("hysteresis_{axis}", "ug", (20, 300, 1000)),
        Parameter("width", "unitless", (0.2, 0.2, 0.2), positive=True, default=0.2),
        Parameter("rounded", "unitless", (1, 1, 1), positive=True, shape=True),
    )
    physics = (
        "The suspension remembers the force it came from; the norm changes, unlike a table's lost"
        " motion."
    )
    equation = (
        "reading_i += h_i z(f_i), z in [-1, 1] the play state (width in g, 0.2 unless given);"
        " rounded = 1: Dahl's"
    )
    source = "Brokate and Sprekels 1996; Dahl 1968; Physics: Accelerometers and inclinometers"
    excited_by = "approaching the same force from both sides"
    look = "a loop over the axis' own force"
    linear = True
    superposes = True
    erased_by_shaking = True
    follows = "tilt"

    @classmethod
    def shapes(cls, span: CoordinateRanges) -> list[dict[str, float]]:
        widths = (0.02, 0.045, 0.1, 0.2, 0.4, 0.8)
        return [{"width": w, "rounded": r} for w, r in product(widths, (0.0, 1.0))]

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        operator = rounded_play if self.value("rounded") else play
        for name, value in self.sizes.items():
            if value:
                channel = TermEffect.channel_of(name[-1], sense)
                if channel >= 0:
                    reading[:, channel] += value * operator(
                        sense.force[:, "xyz".index(name[-1])], self.value("width") * G0
                    )
        return reading

    def stepwise(self, stepping: Stepping) -> StepEffect | None:
        rounded = self.value("rounded") or self.value("width") <= 0
        return None if rounded else _SteppedPlay(self, stepping)


class _SteppedPlay:
    """The state of a play for each coefficient, followed from step to step."""

    def __init__(self, effect: AccHysteresis, stepping: Stepping) -> None:
        self.sizes = {n: v for n, v in effect.sizes.items() if v}
        self.half = effect.value("width") * G0 / 2
        self.output = {n: np.full(stepping.rows, np.nan) for n in self.sizes}

    def restart(self, rows: Rows) -> None:
        """The first input is in the middle of the play."""
        for output in self.output.values():
            output[rows] = np.nan

    def __call__(self, reading: Array, sense: Sense, rows: Rows) -> Array:
        for name, value in self.sizes.items():
            u, output = sense.force[:, "xyz".index(name[-1])], self.output[name][rows]
            output = np.where(np.isnan(output), u, output)
            self.output[name][rows] = output = np.clip(output, u - self.half, u + self.half)
            if (channel := TermEffect.channel_of(name[-1], sense)) >= 0:
                reading[:, channel] += value * ((u - output) / self.half)
        return reading
