"""White noise, flicker and random walk sample by sample, for many environments at once."""

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.effects.sense import Sense
from tiltcal.effects.stepwise import Rows, Stepping

AHEAD = 256  # samples that are drawn at once


class SteppedNoise:
    """Noise that goes on sample by sample, for many environments at once.

    White noise has the numbers of ``draw_noise`` for the same stream. Flicker and walk, whose
    numbers follow there after those of the whole recording, have streams of their own: the same
    statistics. An environment that begins again goes on in its streams; flicker starts stationary.

    Args:
        stepping: sensor and streams.
        white, walk: as of ``draw_noise``.
        flicker: standard deviation of each of its first-order processes; taus: their time
            constants, s.
    """

    def __init__(
        self, stepping: Stepping, white: float, walk: float, flicker: float, taus: Array
    ) -> None:
        rate, shape = stepping.sensor.rate_hz, (stepping.rows, len(stepping.sensor.axes))
        channels = [s for rng in stepping.streams for s in rng.spawn(shape[1])]
        slow = [s.spawn(1)[0] for s in channels]
        self.white, self.walk = white * np.sqrt(rate), walk / np.sqrt(rate)
        self.decay = np.exp(-1 / (rate * taus))
        self.stationary = np.full(len(taus), flicker)
        self.drive = self.stationary * np.sqrt(1 - self.decay**2)
        self._whites = _Ahead(channels, (*shape, 1))
        self._slow = _Ahead(slow, (*shape, len(taus) + 1))
        self.level = np.zeros((*shape, len(taus)))
        self.walked = np.zeros(shape)
        self.fresh = np.ones(shape[0], bool)

    def restart(self, rows: Rows) -> None:
        """Flicker starts stationary, the walk at zero."""
        self.fresh[rows] = True
        self.walked[rows] = 0.0

    def __call__(self, reading: Array, sense: Sense, rows: Rows) -> Array:
        if self.white:
            reading = reading + self.white * self._whites(rows)[..., 0]
        if not (self.walk or self.stationary[0]):
            return reading
        drawn = self._slow(rows)
        fresh = self.fresh[rows][:, None, None]
        level = np.where(
            fresh,
            self.stationary * drawn[..., :-1],
            self.decay * self.level[rows] + self.drive * drawn[..., :-1],
        )
        self.level[rows], self.fresh[rows] = level, False
        self.walked[rows] += self.walk * drawn[..., -1]
        return np.asarray(reading + level.sum(axis=-1) + self.walked[rows])


class _Ahead:
    """Normal numbers drawn ahead from a stream for each channel, in the stream's own order.

    Args:
        streams: of each channel of each row; shape: of one draw, (rows, channels, numbers).
    """

    def __init__(self, streams: list[np.random.Generator], shape: tuple[int, int, int]) -> None:
        self.streams, self.shape = streams, shape
        self.numbers = np.empty((0, *shape))
        self.used = np.zeros(shape[0], np.intp)

    def __call__(self, rows: Rows) -> Array:
        """The next numbers of these rows, (n, channels, numbers)."""
        at = self.used[rows].copy()
        if len(at) and at.max() >= len(self.numbers):
            self._extend(int(self.used.min()))
            at = self.used[rows].copy()
        self.used[rows] += 1
        if isinstance(rows, slice) and (at == at[0]).all():
            return np.asarray(self.numbers[at[0]])
        return np.asarray(self.numbers[at, np.arange(self.shape[0])[rows]])

    def _extend(self, done: int) -> None:
        """Draw a block more; what every row has used is dropped."""
        drawn = np.empty((len(self.streams), AHEAD, self.shape[2]))
        for stream, block in zip(self.streams, drawn, strict=True):
            stream.standard_normal(out=block)
        more = drawn.reshape(*self.shape[:2], AHEAD, self.shape[2]).transpose(2, 0, 1, 3)
        self.numbers = np.concatenate([self.numbers[done:], more])
        self.used -= done
