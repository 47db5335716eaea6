"""Stamps that differ from the instant at which the signal was taken."""

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.effects.base import DelayEffect
from tiltcal.effects.electronics.converter import ANALOG
from tiltcal.effects.parameter import Parameter


class DataLatency(DelayEffect):
    row_wise = True
    id = "data_latency"
    needs = "motion"
    stage = "timing"
    kinds = ANALOG
    title = "constant delay"
    parameters = (Parameter("latency", "ms", (1, 20, 200)),)
    physics = "Conversion, filtering and transport take time before the stamp."
    equation = "reading(t) = signal(t - tau)"
    source = "Physics: Timing and data"
    excited_by = "moves"
    look = "a rotation proportional to the rate, odd in it, nothing at rest"
    distinguished_by = {"acc_bandwidth": "ramp"}

    def delay(self, elapsed: Array, channel: int, rng: np.random.Generator | None) -> Array | float:
        return self.value("latency")


class ChannelMuxSkew(DelayEffect):
    row_wise = True
    id = "channel_mux_skew"
    needs = "motion"
    stage = "electronics"
    kinds = ANALOG
    title = "channels converted one after the other"
    parameters = (Parameter("skew", "ms", (1, 15, 50)),)
    physics = "One modulator serves all channels in turn."
    equation = "channel i is read i x skew earlier"
    source = "Physics: Electronics"
    excited_by = "moves"
    look = "an apparent cross-axis rotation proportional to the rate"

    def delay(self, elapsed: Array, channel: int, rng: np.random.Generator | None) -> Array | float:
        return channel * self.value("skew")


class ClockSkew(DelayEffect):
    id = "clock_skew"
    needs = "motion"
    stage = "timing"
    kinds = ANALOG
    title = "clock runs fast or slow"
    parameters = (Parameter("skew", "ppm", (20, 100, 2000)),)
    physics = "The recorder's clock drifts against the table's."
    equation = "signal at t (1 - k) is stamped t"
    source = "Physics: Timing and data"
    excited_by = "moves near the end of a long recording"
    look = "a delay that grows"
    shows_against_table = True

    def delay(self, elapsed: Array, channel: int, rng: np.random.Generator | None) -> Array | float:
        return self.value("skew") * elapsed


class DataJitter(DelayEffect):
    id = "data_jitter"
    needs = "motion"
    stage = "timing"
    kinds = ANALOG
    title = "random time-stamp error"
    parameters = (Parameter("jitter", "ms", (0.1, 1, 10), positive=True),)
    physics = "Stamps are given by a busy computer."
    equation = "reading(t_k) = signal(t_k - N(0, s))"
    source = "Physics: Timing and data"
    excited_by = "moves"
    look = "noise proportional to the rate"
    random = True
    scatters = True

    def delay(self, elapsed: Array, channel: int, rng: np.random.Generator | None) -> Array | float:
        return 0.0 if rng is None else rng.normal(0.0, self.value("jitter"), len(elapsed))
