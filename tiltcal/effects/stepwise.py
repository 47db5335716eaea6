"""Effects of a sensor's signal step by step, as a control loop meets them: no row is known before
it is there. A row is one of many environments that are stepped together.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.effects.sense import Sense
from tiltcal.setup.sensor import Sensor

Rows = slice | Index
"""Which environments: all, or their numbers."""


@dataclass(frozen=True)
class Stepping:
    """What an effect needs to know before the first step.

    Args:
        sensor: it acts on.
        rows: environments.
        streams: a random stream for each environment, the laboratory's for that seed; none when
            random effects are switched off.
    """

    sensor: Sensor
    rows: int
    streams: Sequence[np.random.Generator]


class StepEffect(Protocol):
    """An effect that goes on from step to step."""

    def restart(self, rows: Rows) -> None:
        """These environments begin a new recording."""

    def __call__(self, reading: Array, sense: Sense, rows: Rows) -> Array:
        """The reading of these environments after the effect, (n, k), SI."""


Law = Callable[[Array, Sense, np.random.Generator | None], Array]


@dataclass(frozen=True)
class Memoryless:
    """An effect that acts on each row by itself.

    Args:
        law: ``SignalEffect.apply``.
        stream: handed to the law; None for an effect that is not random.
    """

    law: Law
    stream: np.random.Generator | None = None

    def restart(self, rows: Rows) -> None:
        """Nothing is remembered."""

    def __call__(self, reading: Array, sense: Sense, rows: Rows) -> Array:
        return self.law(reading, sense, self.stream)


class SteppedLag:
    """1/(1 + tau s), starting settled; exact for an input that is a cubic through the last four
    samples.

    Args:
        tau, step: s; shape: of the reading, (environments, channels).
    """

    def __init__(self, tau: float, step: float, shape: tuple[int, int]) -> None:
        self.decay = float(np.exp(-step / tau)) if tau > 0 else 0.0
        self.weights = lag_weights(tau, step)
        self.past = np.zeros((3, *shape))
        self.output = np.zeros(shape)
        self.fresh = np.ones(shape[0], bool)

    def restart(self, rows: Rows) -> None:
        """They settle at their first input."""
        self.fresh[rows] = True

    def __call__(self, reading: Array, sense: Sense, rows: Rows) -> Array:
        first = self.fresh[rows].copy()
        past, output = self.past[:, rows], self.output[rows]
        if first.any():
            past[:, first], output[first] = reading[first], reading[first]
            self.fresh[rows] = False
        found = self.decay * output + self.weights[3] * reading
        for weight, earlier in zip(self.weights[:3], past, strict=True):
            found = found + weight * earlier
        found = np.where(first[:, None], reading, found) if first.any() else found
        self.past[:, rows] = np.concatenate([past[1:], reading[None]])
        self.output[rows] = found
        return found


def lag_weights(tau: float, step: float) -> Array:
    """Weights of the last four samples, the oldest first, (4,), in y_k = decay y_(k-1) + sum: see
    ``hysteresis_and_lag.smooth_lag``, whose cubic spline would need the samples to come. tau, step:
    s.
    """
    if tau <= 0:
        return np.array([0.0, 0.0, 0.0, 1.0])
    h = step
    # column j: the cubic's coefficients per unit of sample j, from the start of the interval
    value, slope, second, third = np.linalg.inv(
        np.vander(np.array([-2 * h, -h, 0.0, h]), 4, increasing=True)
    )
    end = np.array([0.0, 0.0, 0.0, 1.0]) - tau * (slope + (2 * second + 3 * third * h) * h)
    end = end + tau**2 * (2 * second + 6 * third * h) - 6 * tau**3 * third
    start = value - tau * slope + 2 * tau**2 * second - 6 * tau**3 * third
    return np.asarray(end - np.exp(-h / tau) * start)


class SteppedHold:
    """Repeats the sample before, where ``repeats`` says so.

    Args:
        repeats: (sense, rows) -> which rows repeat, (n,); channels: that it acts on.
    """

    def __init__(
        self,
        repeats: Callable[[Sense, Rows], Mask],
        shape: tuple[int, int],
        channels: slice | list[int],
    ) -> None:
        self.repeats, self.channels = repeats, channels
        self.last = np.zeros(shape)
        self.fresh = np.ones(shape[0], bool)

    def restart(self, rows: Rows) -> None:
        """The first sample repeats none."""
        self.fresh[rows] = True

    def __call__(self, reading: Array, sense: Sense, rows: Rows) -> Array:
        again = np.asarray(self.repeats(sense, rows), bool) & ~self.fresh[rows]
        self.fresh[rows] = False
        if again.any():
            last = self.last[rows]
            held = reading[again]
            held[:, self.channels] = last[again][:, self.channels]
            reading[again] = held
        self.last[rows] = reading
        return reading
