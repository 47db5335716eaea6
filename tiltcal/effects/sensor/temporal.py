"""Errors that follow time: warm-up, steps, drift, another bias at each power-on."""

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.effects.base import SignalEffect, TermEffect
from tiltcal.effects.hysteresis_and_lag import onset
from tiltcal.effects.parameter import Parameter
from tiltcal.effects.sense import ACCELEROMETERS, Sense
from tiltcal.effects.sensor.environmental import GYROS, FollowsState
from tiltcal.effects.spans import CoordinateRanges
from tiltcal.effects.stepwise import Rows, StepEffect, Stepping
from tiltcal.effects.traits import Family


class Warmup(TermEffect):
    """reading_i += A_i exp(-t / tau), t from the first stamp."""

    row_wise = True
    stage = "sensor"
    order = 20
    linear = False
    equation = "reading_i += A_i exp(-t/tau)"
    physics = "Self-heating after power-on relaxes exponentially, in every pose alike."
    source = "PHYSICS 3.4"
    excited_by = "time since power-on"
    look = "an exponential from the first stamp on"
    family = Family(reading=("time",))
    superposes = True

    @classmethod
    def shapes(cls, span: CoordinateRanges) -> list[dict[str, float]]:
        return [{"tau": span.duration * x} for x in (0.03, 0.1, 0.2, 0.5, 1.5)]

    def term(self, name: str, sense: Sense) -> tuple[int, Array]:
        return self.channel_of(name[-1], sense), np.exp(-sense.elapsed / self.value("tau"))


class AccWarmup(Warmup):
    id = "acc_warmup"
    needs = "time"
    kinds = ACCELEROMETERS
    title = "exponential after power-on"
    parameters = (
        Parameter("warmup_{axis}", "ug", (100, 3000, 10000)),
        Parameter("tau", "s", (1800, 600, 300), positive=True, default=300.0),
    )


class GyrWarmup(Warmup):
    id = "gyr_warmup"
    needs = "time"
    kinds = GYROS
    title = "exponential after power-on"
    parameters = (
        Parameter("warmup_{axis}", "deg_s", (1e-4, 0.05, 0.5)),
        Parameter("tau", "s", (1800, 600, 300), positive=True, default=300.0),
    )


class BiasStep(TermEffect):
    """reading_i += A_i from time_s on, or creeping there with the time constant creep_s."""

    row_wise = True
    stage = "sensor"
    order = 20
    linear = False
    equation = "reading_i += A_i from time_s on"
    physics = "Trapped charge or a shifted suspension steps one axis at an instant."
    source = "PHYSICS 3.4"
    excited_by = "time"
    look = "a step on one axis only, its neighbours unchanged"
    family = Family(reading=("time",))
    acts_from_an_instant = True

    def term(self, name: str, sense: Sense) -> tuple[int, Array]:
        return self.channel_of(name[-1], sense), onset(
            sense.elapsed, self.value("time"), self.value("creep")
        )


class AccBiasStep(BiasStep):
    id = "acc_bias_step"
    needs = "time"
    kinds = ACCELEROMETERS
    title = "step or popcorn of one axis"
    parameters = (
        Parameter("bias_step_{axis}", "ug", (50, 2000, 5000)),
        Parameter("time", "s", (1e5, 1e5, 1e5), positive=True, shape=True),
        Parameter("creep", "s", (30, 30, 30), positive=True, shape=True),
    )


class GyrBiasStep(BiasStep):
    id = "gyr_bias_step"
    needs = "time"
    kinds = GYROS
    title = "step of the bias"
    parameters = (
        Parameter("bias_step_{axis}", "deg_s", (1e-4, 0.05, 0.5)),
        Parameter("time", "s", (1e5, 1e5, 1e5), positive=True, shape=True),
        Parameter("creep", "s", (30, 30, 30), positive=True, shape=True),
    )


class AccDrift(FollowsState):
    id = "acc_drift"
    needs = "time"
    kinds = ACCELEROMETERS
    title = "linear bias ramp"
    parameters = (Parameter("drift_{axis}", "ug", (50, 1000, 5000)),)
    physics = "Slow relaxation that looks linear over one recording."
    equation = "reading_i += d_i x(t), x = 0..1 over the recording"
    excited_by = "time"
    look = "a ramp in every pose"
    family = Family(reading=("time",))

    def state(self, sense: Sense) -> Array:
        return sense.elapsed / max(float(sense.elapsed[-1]), 1e-12)


class AccTurnOn(SignalEffect):
    row_wise = True
    id = "acc_turn_on"
    needs = "any"
    stage = "sensor"
    kinds = ACCELEROMETERS
    order = 22
    title = "run-to-run bias"
    parameters = (Parameter("sigma", "ug", (160, 3500, 10000), positive=True),)
    physics = "Each power-on finds another equilibrium of charge and stress."
    equation = "reading_i += N(0, sigma), drawn once a recording"
    source = "PHYSICS 3.4"
    excited_by = "several recordings with power cycles between"
    look = "a constant in one recording, another in the next"
    random = True
    like_event = "acc_bias_step"
    distinguished_by = {"acc_bias_step": "record twice more, with the power switched off between"}

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        return (
            reading
            if rng is None
            else reading + rng.normal(0.0, self.value("sigma"), reading.shape[1])
        )

    def stepwise(self, stepping: Stepping) -> StepEffect:
        return _SteppedTurnOn(self.value("sigma"), stepping)


class _SteppedTurnOn:
    """A bias redrawn whenever an environment begins again."""

    def __init__(self, sigma: float, stepping: Stepping) -> None:
        self.sigma, self.streams = sigma, stepping.streams
        self.bias = np.zeros((stepping.rows, len(stepping.sensor.axes)))

    def restart(self, rows: Rows) -> None:
        """The power is switched on."""
        for row in np.arange(len(self.bias))[rows]:
            self.bias[row] = self.streams[row].normal(0.0, self.sigma, self.bias.shape[1])

    def __call__(self, reading: Array, sense: Sense, rows: Rows) -> Array:
        return np.asarray(reading + self.bias[rows])
