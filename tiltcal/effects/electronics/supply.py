"""References and supplies: gain and offset that drift."""

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.effects.base import SignalEffect
from tiltcal.effects.electronics.converter import ANALOG
from tiltcal.effects.hysteresis_and_lag import LAGS, first_order_lag
from tiltcal.effects.parameter import Parameter
from tiltcal.effects.sense import Sense
from tiltcal.effects.sensor.environmental import FollowsTemperature
from tiltcal.effects.spans import CoordinateRanges
from tiltcal.effects.stepwise import Memoryless, StepEffect, Stepping
from tiltcal.effects.traits import Family


class ReferenceDrift(SignalEffect):
    id = "reference_drift"
    needs = "temperature"
    stage = "electronics"
    kinds = ANALOG
    order = 60
    title = "common gain drift of all channels"
    parameters = (
        Parameter("gain", "ppm_degC", (10, 50, 100)),
        Parameter("lag", "s", (30, 30, 30), positive=True, shape=True),
    )
    physics = (
        "The converter's voltage reference drifts with temperature, its own: it may come after the"
        " thermometer's."
    )
    equation = "all channels (1 + k (T_ref - T0)), lag dT_ref/dt = T - T_ref"
    source = "IEEE 1241; Physics: Electronics"
    excited_by = "a temperature change on loaded channels"
    look = "the same ppm on every channel"
    linear = True
    family = Family(scale=("temperature",))

    @classmethod
    def shapes(cls, span: CoordinateRanges) -> list[dict[str, float]]:
        return [{"lag": lag} for lag in LAGS]

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        own = first_order_lag(sense.time, sense.temperature, self.value("lag"))
        return reading * (1 + self.value("gain") * own)[:, None]

    def stepwise(self, stepping: Stepping) -> StepEffect | None:
        return Memoryless(self.apply) if self.value("lag") <= 0 else None


class SupplyRatiometric(SignalEffect):
    id = "supply_ratiometric"
    needs = "time"
    stage = "electronics"
    kinds = ANALOG
    order = 60
    title = "gain follows the supply"
    parameters = (Parameter("gain", "ppm", (20, 1000, 20000)),)
    physics = "A ratiometric sensor on a converter that is not: the supply sags over the recording."
    equation = "all channels (1 + e x(t)), x = 0..1 over the recording"
    source = "Physics: Electronics"
    excited_by = "time on loaded channels"
    look = "a gain that ramps, the same on every channel"
    linear = True
    same_form_as = "reference_drift"

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        return (
            reading
            * (1 + self.value("gain") * sense.elapsed / max(float(sense.elapsed[-1]), 1e-12))[
                :, None
            ]
        )


class AdcOffsetDrift(FollowsTemperature):
    id = "adc_offset_drift"
    needs = "temperature"
    stage = "electronics"
    kinds = ANALOG
    order = 61
    title = "offset drift"
    parameters = (Parameter("offset_{axis}", "ug_degC", (1, 10, 100)),)
    physics = "The amplifier's offset drifts with temperature; a shorted input shows it."
    equation = "reading_i += k_i (T - T0)"
    source = "IEEE 1241; Physics: Electronics"
    excited_by = "a temperature change"
    look = "one with the sensor's own bias drift until the input is shorted"
    same_form_as = "acc_temp_bias"
