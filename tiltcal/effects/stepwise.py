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

AHEAD = 256  # samples whose random numbers are drawn at once


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
    """An effect that continues from step to step."""

    def restart(self, rows: Rows) -> None:
        """These environments begin a new recording."""

    def __call__(self, reading: Array, sense: Sense, rows: Rows) -> Array:
        """The reading of these environments after the effect, (n, k), SI."""


Apply = Callable[[Array, Sense, np.random.Generator | None], Array]


@dataclass(frozen=True)
class Memoryless:
    """An effect that acts on each row by itself.

    Args:
        apply: ``SignalEffect.apply``.
        stream: handed to it; None for an effect that is not random.
    """

    apply: Apply
    stream: np.random.Generator | None = None

    def restart(self, rows: Rows) -> None:
        """Nothing is remembered."""

    def __call__(self, reading: Array, sense: Sense, rows: Rows) -> Array:
        return self.apply(reading, sense, self.stream)


class DrawnAhead:
    """Random numbers drawn ahead from a stream for each channel, in the stream's own order.

    Args:
        streams: of each channel of each row.
        shape: of one draw, (rows, channels, numbers).
        draw: a method of the streams that takes ``out``.
    """

    def __init__(
        self,
        streams: Sequence[np.random.Generator],
        shape: tuple[int, int, int],
        draw: Callable[..., object],
    ) -> None:
        self.streams, self.shape, self.draw = streams, shape, draw
        self.numbers = np.empty((0, *shape))
        self._common: int | None = 0  # used by each row, as long as all have used as many
        self._used = np.zeros(shape[0], np.intp)  # from then on

    def __call__(self, rows: Rows) -> Array:
        """The next numbers of these rows, (n, channels, numbers)."""
        self.need(rows)
        return self.take(self.numbers, rows)

    def used(self, rows: Index) -> Index:
        """How many numbers each of these rows has used, of those that are held, (n,)."""
        return np.full(len(rows), self._common) if self._common is not None else self._used[rows]

    def need(self, rows: Rows) -> int | None:
        """Have numbers for these rows: how many that all have used were dropped; None: there were
        enough.
        """
        if self._common is not None:
            most = done = self._common
        else:
            most, done = int(self._used[rows].max(initial=-1)), int(self._used.min())
        if most < len(self.numbers):
            return None
        drawn = np.empty((len(self.streams), AHEAD, self.shape[2]))
        for stream, block in zip(self.streams, drawn, strict=True):
            self.draw(stream, out=block)
        more = drawn.reshape(*self.shape[:2], AHEAD, self.shape[2]).transpose(2, 0, 1, 3)
        self.numbers = np.concatenate([self.numbers[done:], more])
        self._used -= done
        self._common = None if self._common is None else 0
        return done

    def take(self, values: Array, rows: Rows) -> Array:
        """What stands for these rows' next numbers, (n, ...), which are then used. values: one for
        each draw and row, (draws, rows, ...).
        """
        if self._common is not None:
            found = values[self._common, rows]
        else:
            found = values[self._used[rows], np.arange(self.shape[0])[rows]]
        self.pass_over(rows)
        return found

    def pass_over(self, rows: Rows) -> None:
        """These rows have used their next numbers."""
        if self._common is not None and isinstance(rows, slice):
            self._common += 1
            return
        if self._common is not None:
            self._used[:], self._common = self._common, None
        self._used[rows] += 1


class SteppedLag:
    """1/(1 + tau s), starting settled; exact for an input that is a cubic through the last four
    samples.

    Args:
        tau, step: s.
        shape: of the reading, (environments, channels).
    """

    def __init__(self, tau: float, step: float, shape: tuple[int, int]) -> None:
        decay = float(np.exp(-step / tau)) if tau > 0 else 0.0
        self.weights = np.array([*lag_weights(tau, step), decay])
        self.states = np.zeros((5, *shape))  # the last four inputs, the oldest first; the output
        self.fresh = np.ones(shape[0], bool)
        self.settles = True

    def restart(self, rows: Rows) -> None:
        """They settle at their first input."""
        self.fresh[rows], self.settles = True, True

    def __call__(self, reading: Array, sense: Sense, rows: Rows) -> Array:
        states = self.states[:, rows]
        states[:3], states[3] = states[1:4], reading
        if self.settles:
            first = self.fresh[rows]
            states[:, first] = reading[first]
        states[4] = (self.weights @ states.reshape(5, -1)).reshape(states.shape[1:])
        if self.settles:
            states[4, first] = reading[first]
            self.fresh[rows] = False
            self.settles = bool(self.fresh.any())
        if not isinstance(rows, slice):
            self.states[:, rows] = states
        return states[4].copy()


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
    """Repeats the sample before, where ``repeats`` is set.

    Args:
        repeats: (sense, rows) -> which rows repeat, (n,).
        channels: that it acts on.
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
