"""Amplifier and converter."""

from abc import abstractmethod

import numpy as np

from tiltcal.effects.base import Parameter, Sense, SignalEffect, TermEffect
from tiltcal.frames import Array
from tiltcal.units import G0

ANALOG = frozenset({"accelerometer", "inclinometer", "gyro", "fog"})


class PerChannel(SignalEffect):
    """A change of each channel by its own parameter."""

    stage = "electronics"
    kinds = ANALOG

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        for name, value in self.values.items():
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
    source = "PHYSICS 3.6"
    excited_by = "any input"
    look = "one with the scale factor until the gain is switched"
    linear = True

    def change(self, u: Array, value: float, sense: Sense) -> Array:
        return u * (1 + value)


class AdcInl(PerChannel):
    id = "adc_inl"
    order = 68
    title = "integral non-linearity"
    parameters = (Parameter("inl_{axis}", "ug", (60, 300, 3000)),)
    physics = "The converter's transfer curve bows; it follows the voltage, so it changes with the gain."
    equation = "reading_i += e_i (1 - v^2), v = reading / full scale (1.2 g unless stated)"
    source = "PHYSICS 3.6; AD7705 (0.003 % of full scale)"
    excited_by = "the whole input range"
    look = "as K2, but tied to the voltage"
    linear = True

    def change(self, u: Array, value: float, sense: Sense) -> Array:
        v = u / (sense.full_scale or 1.2 * G0)
        return u + value * (1 - v * v)


class AdcQuantisation(SignalEffect):
    id = "adc_quantisation"
    stage = "electronics"
    kinds = ANALOG
    order = 80
    title = "coarse code"
    parameters = (Parameter("lsb", "si", (1e-5, 1e-4, 1e-2), positive=True),)
    physics = "The converter rounds to its code; a median sticks to codes, a mean does not."
    equation = "reading = lsb round(reading / lsb)"
    source = "PHYSICS 3.6"
    excited_by = "noise below one code"
    look = "a staircase"
    random = True  # a rounding error is noise: `--noise off` leaves it out

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        lsb = self.value("lsb")
        if rng is None or lsb <= 0:
            return reading
        np.divide(reading, lsb, out=reading)
        np.rint(reading, out=reading)
        return np.multiply(reading, lsb, out=reading)
