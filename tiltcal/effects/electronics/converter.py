"""Amplifier and converter."""

from abc import abstractmethod
from typing import ClassVar

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import G0
from tiltcal.effects.base import SignalEffect, TermEffect
from tiltcal.effects.parameter import Parameter, Stage
from tiltcal.effects.sense import Sense
from tiltcal.effects.spans import CoordinateRanges
from tiltcal.effects.stepwise import Memoryless, StepEffect, Stepping
from tiltcal.effects.traits import Family

ANALOG = frozenset({"accelerometer", "inclinometer", "gyro", "fog"})


class PerChannel(SignalEffect):
    """A change of each channel by its own parameter."""

    row_wise = True
    stage = "electronics"
    kinds = ANALOG

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        for name, value in self.sizes.items():
            axis = name[-1]
            if value and (channel := TermEffect.channel_of(axis, sense)) >= 0:
                reading[:, channel] = self.change(reading[:, channel], value, sense)
        return reading

    @abstractmethod
    def change(self, u: Array, value: float, sense: Sense) -> Array:
        """The channel after the effect, (n,)."""


class AdcGainError(PerChannel):
    id = "adc_gain_error"
    order = 60
    title = "gain error"
    parameters = (Parameter("gain_{axis}", "ppm", (50, 500, 5000)),)
    physics = "The amplifier's or converter's gain is off."
    equation = "reading_i *= 1 + e_i"
    source = "IEEE 1241; Physics: Electronics"
    excited_by = "any input"
    look = "one with the scale factor until the gain is switched"
    linear = True
    same_form_as = "acc_scale"

    def change(self, u: Array, value: float, sense: Sense) -> Array:
        return u * (1 + value)


class AdcInl(PerChannel):
    id = "adc_inl"
    order = 68
    title = "integral non-linearity"
    parameters = (
        Parameter("inl_{axis}", "ug", (60, 300, 3000)),
        Parameter("odd", "unitless", (1, 1, 1), positive=True, shape=True),
    )
    physics = (
        "The converter's transfer curve bows; it follows the voltage, so it changes with the gain."
    )
    equation = (
        "reading_i += e_i (1 - v^2), v = reading / full scale (1.2 g unless stated); odd = 1: e_i"
        " 2.6 (v - v^3)"
    )
    source = "IEEE 1241; Physics: Electronics"
    excited_by = "the whole input range"
    look = "as K2, but tied to the voltage"
    distinguished_by = dict.fromkeys(
        ("acc_K2", "acc_K3"), "no pose: another gain of the converter, or a known voltage fed to it"
    )
    linear = True
    form = "any"
    family = Family(reading=("input",))
    superposes = True

    @classmethod
    def shapes(cls, span: CoordinateRanges) -> list[dict[str, float]]:
        return [{}, {"odd": 1.0}]

    def change(self, u: Array, value: float, sense: Sense) -> Array:
        v = u / (sense.full_scale or 1.2 * G0)
        return u + value * (2.6 * (v - v * v * v) if self.value("odd") else 1 - v * v)


class AdcQuantisation(SignalEffect):
    row_wise = True
    id = "adc_quantisation"
    needs = "any"
    stage: ClassVar[Stage] = "electronics"
    kinds = ANALOG
    order = 80
    title = "coarse quantisation"
    parameters = (Parameter("lsb", "si", (1e-5, 1e-4, 1e-2), positive=True),)
    physics = (
        "The converter rounds to one LSB; a median sticks to multiples of it, a mean does not."
    )
    equation = "reading = lsb round(reading / lsb)"
    source = "IEEE 1241; Widrow and Kollar 2008; Physics: Electronics"
    excited_by = "noise below one LSB"
    look = "a staircase"
    random = True  # a rounding error is noise: `--noise off` leaves it out
    repair = "samples"

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        lsb = self.value("lsb")
        if rng is None or lsb <= 0:
            return reading
        np.divide(reading, lsb, out=reading)
        np.rint(reading, out=reading)
        return np.multiply(reading, lsb, out=reading)

    def stepwise(self, stepping: Stepping) -> StepEffect:
        return Memoryless(self.apply, stepping.streams[0])


class GyrQuantisation(AdcQuantisation):
    id = "gyr_quantisation"
    needs = "any"
    stage = "sensor"
    kinds = frozenset({"gyro", "fog"})
    title = "coarse quantisation of the output"
    parameters = (Parameter("lsb", "deg_s", (1e-5, 0.004, 0.06), positive=True),)
    physics = "The gyro's digital output has few bits a degree per second."
    equation = "reading = lsb round(reading / lsb)"
    source = "IEEE 2700; Widrow and Kollar 2008; Physics: Gyroscopes and FOGs"


class AdcStuckBit(SignalEffect):
    row_wise = True
    id = "adc_stuck_bit"
    channel_wise = True
    needs = "any"
    stage = "electronics"
    kinds = ANALOG
    order = 82
    title = "missing output values, stuck bit"
    parameters = (Parameter("bit_value", "si", (1e-4, 1e-3, 1e-2), positive=True),)
    physics = "A line of the interface or a comparator is stuck: one bit always reads 0."
    equation = "reading -= bit where floor(reading / bit) is odd, on one axis where one is named"
    source = "IEEE 1241; Physics: Electronics"
    excited_by = "readings that use the bit"
    look = "half of all output values missing, jumps by one bit"
    threshold = True
    repair = "samples"

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        bit = self.value("bit_value")
        if bit > 0:
            reading = reading.copy()
            channels = (
                slice(None) if self.axis is None else [TermEffect.channel_of(self.axis, sense)]
            )
            reading[:, channels] -= bit * np.mod(np.floor(reading[:, channels] / bit), 2.0)
        return reading


class AdcCrosstalk(SignalEffect):
    row_wise = True
    id = "adc_crosstalk"
    stage = "electronics"
    kinds = ANALOG
    order = 66
    title = "previous channel leaks in"
    parameters = (Parameter("crosstalk", "ppm", (10, 100, 1000)),)
    physics = "The multiplexer has not settled when the next channel is converted."
    equation = "next channel += eps previous"
    source = "IEEE 1241; Physics: Electronics"
    excited_by = "different inputs on neighbouring channels"
    look = "one-sided cross-axis terms, in the order of conversion"
    linear = True

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        leaked = reading.copy()
        leaked[:, 1:] += self.value("crosstalk") * reading[:, :-1]
        return leaked
