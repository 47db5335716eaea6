"""What happens to samples on their way into the file."""

from typing import ClassVar

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.effects.base import SignalEffect, TermEffect
from tiltcal.effects.electronics.converter import ANALOG
from tiltcal.effects.parameter import Parameter, Stage
from tiltcal.effects.sense import Sense
from tiltcal.effects.stepwise import DrawnAhead, Rows, StepEffect, SteppedHold, Stepping


class DataOutlier(SignalEffect):
    id = "data_outlier"
    needs = "any"
    stage: ClassVar[Stage] = "data"
    kinds = ANALOG
    order = 90
    title = "gross errors"
    parameters = (
        Parameter("share", "unitless", (1e-4, 1e-3, 1e-2), positive=True),
        Parameter("size", "sigma", (20, 20, 50), positive=True, default=20.0),
    )
    physics = "Transmission errors and shocks throw single samples far off."
    equation = (
        "with probability p a channel's sample gains +- size sigma (of its sample-to-sample noise)"
    )
    source = "Huber 1964; Physics: Timing and data"
    excited_by = "any recording"
    look = "isolated values beyond 8 sigma"
    random = True
    repair = "samples"

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        if rng is None or len(reading) < 3:
            return reading
        noise = np.median(np.abs(np.diff(reading, axis=0)), axis=0) / (0.6745 * np.sqrt(2))
        hit = rng.random(reading.shape) < self.value("share")
        return reading + hit * rng.choice([-1.0, 1.0], reading.shape) * self.value("size") * noise


class DataDrop(SignalEffect):
    id = "data_drop"
    needs = "motion"
    stage = "data"
    kinds = ANALOG
    order = 92
    title = "samples lost"
    parameters = (
        Parameter("samples", "", (100, 100, 100), positive=True, whole=True),
        Parameter("time", "s", (1e5, 1e5, 1e5), shape=True),
    )
    physics = "A buffer overran: samples are missing and the following ones moved up."
    equation = "from time_s on, reading_k = reading_(k + samples)"
    source = "Physics: Timing and data"
    excited_by = "moves after the loss"
    look = "moves come early from an instant on"
    acts_from_an_instant = True
    shows_against_table = True
    leaves_nothing = True

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        lost = round(self.value("samples"))
        start = int(np.searchsorted(sense.elapsed, self.value("time")))
        if lost <= 0 or start >= len(reading):
            return reading
        moved = np.full_like(reading[start:], np.nan)
        kept = reading[start + lost :]
        moved[: len(kept)] = kept
        return np.concatenate([reading[:start], moved])


class DataDuplicate(SignalEffect):
    id = "data_duplicate"
    needs = "any"
    stage = "data"
    kinds = ANALOG
    order = 91
    title = "samples repeated"
    parameters = (Parameter("share", "unitless", (1e-3, 1e-2, 1e-1), positive=True),)
    physics = "A reader faster than the sensor reads the same value twice."
    equation = "with probability p the previous sample is repeated"
    source = "Physics: Timing and data"
    excited_by = "any recording"
    look = "exact repeats of all channels at once"
    random = True
    repair = "samples"

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        if rng is None:
            return reading
        again = rng.random(len(reading)) < self.value("share")
        again[0] = False
        source = np.maximum.accumulate(np.where(again, 0, np.arange(len(reading))))
        return reading[source]

    def stepwise(self, stepping: Stepping) -> StepEffect:
        share = self.value("share")
        drawn = DrawnAhead(stepping.streams, (stepping.rows, 1, 1), np.random.Generator.random)

        def repeats(_: Sense, rows: Rows) -> Mask:
            return np.asarray(drawn(rows)[:, 0, 0] < share)

        return SteppedHold(repeats, (stepping.rows, len(stepping.sensor.axes)), slice(None))


class DataStuck(SignalEffect):
    id = "data_stuck"
    channel_wise = True
    needs = "any"
    stage = "data"
    kinds = ANALOG
    order = 93
    title = "channel frozen for a while"
    parameters = (
        Parameter("start", "s", (1e5, 1e5, 1e5), shape=True),
        Parameter("length", "s", (100, 100, 100), positive=True),
    )
    physics = "An interface hangs and repeats its last value."
    equation = (
        "reading(t) = reading(start) for start <= t < start + length, on one axis where one is"
        " named"
    )
    source = "Physics: Timing and data"
    excited_by = "any recording"
    look = "a flat stretch without noise"
    leaves_nothing = True
    repair = "samples"

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        start, length = self.value("start"), self.value("length")
        frozen = (sense.elapsed >= start) & (sense.elapsed < start + length)
        if frozen.any():
            channels = (
                slice(None) if self.axis is None else [TermEffect.channel_of(self.axis, sense)]
            )
            reading[frozen, channels] = reading[int(np.argmax(frozen)), channels]
        return reading

    def stepwise(self, stepping: Stepping) -> StepEffect:
        start, end = self.value("start"), self.value("start") + self.value("length")
        step = 1 / stepping.sensor.rate_hz
        names = stepping.sensor.axes

        def repeats(sense: Sense, _: Rows) -> Mask:
            # the first sample of the stretch is new
            return (sense.elapsed - step * (1 - 1e-6) >= start) & (sense.elapsed < end)

        channels = slice(None) if self.axis is None else [names.index(self.axis)]
        return SteppedHold(repeats, (stepping.rows, len(names)), channels)


class EmiSpike(DataOutlier):
    id = "emi_spike"
    needs = "any"
    stage = "electronics"
    order = 84
    title = "spikes"
    parameters = (
        Parameter("share", "unitless", (1e-4, 1e-3, 1e-2), positive=True),
        Parameter("size", "sigma", (30, 30, 100), positive=True, default=30.0),
    )
    physics = "Switching loads couple pulses into the cable."
    equation = "with probability p a channel's sample gains +- size sigma"
    source = "Physics: Electronics"


class DataGap(SignalEffect):
    row_wise = True
    id = "data_gap"
    needs = "any"
    stage = "data"
    kinds = ANALOG
    order = 94
    title = "stretch missing"
    parameters = (
        Parameter("start", "s", (1e5, 1e5, 1e5), shape=True),
        Parameter("length", "s", (100, 100, 100), positive=True),
    )
    physics = "The link was down: cells are empty, the stamps go on."
    equation = "no reading for start <= t < start + length"
    source = "Physics: Timing and data"
    excited_by = "any recording"
    look = "empty cells"
    leaves_nothing = True

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        start = self.value("start")
        missing = (sense.elapsed >= start) & (sense.elapsed < start + self.value("length"))
        return np.where(missing[:, None], np.nan, reading)
