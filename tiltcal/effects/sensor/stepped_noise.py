"""White noise, flicker and random walk sample by sample, for many environments at once."""

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.effects.sense import Sense
from tiltcal.effects.stepwise import DrawnAhead, Rows, Stepping


class SteppedNoise:
    """Noise that continues sample by sample, for many environments at once.

    White noise has the numbers of ``draw_noise`` for the same stream. Flicker and walk, whose
    numbers follow there after those of the whole recording, have streams of their own: the same
    statistics. An environment that begins again continues in its streams; flicker starts
    stationary.

    No reading has a part in it, so that it is computed a block of samples ahead.

    Args:
        stepping: sensor and streams.
        white, walk: as of ``draw_noise``.
        flicker: standard deviation of each of its first-order processes.
        taus: their time constants, s.
    """

    def __init__(
        self, stepping: Stepping, white: float, walk: float, flicker: float, taus: Array
    ) -> None:
        rate, self.shape = stepping.sensor.rate_hz, (stepping.rows, len(stepping.sensor.axes))
        channels = [s for rng in stepping.streams for s in rng.spawn(self.shape[1])]
        slow = [s.spawn(1)[0] for s in channels]
        self.white, self.walk = white * np.sqrt(rate), walk / np.sqrt(rate)
        self.decay = np.exp(-1 / (rate * taus))
        self.flicker = flicker
        self.drive = flicker * np.sqrt(1 - self.decay**2)
        self.is_slow = bool(self.walk or self.flicker)
        self._whites = DrawnAhead(channels, (*self.shape, 1), np.random.Generator.standard_normal)
        self._slow = DrawnAhead(
            slow, (*self.shape, len(taus) + 1), np.random.Generator.standard_normal
        )
        self.noise = np.empty((0, *self.shape))
        self.level = np.zeros((*self.shape, len(taus)))  # at the last sample of the block
        self.walked = np.zeros(self.shape)
        self.fresh = np.ones(self.shape[0], bool)
        self.begins = True

    def restart(self, rows: Rows) -> None:
        """Flicker starts stationary, the walk at zero."""
        self.fresh[rows], self.begins = True, True

    def __call__(self, reading: Array, sense: Sense, rows: Rows) -> Array:
        if self.is_slow:
            return np.asarray(reading + self._next(rows))
        if self.white:
            return np.asarray(reading + self.white * self._whites(rows)[..., 0])
        return reading

    def _next(self, rows: Rows) -> Array:
        """The next sample of these rows, (n, channels)."""
        slow, white = self._slow, self._whites
        dropped = slow.need(rows)
        if dropped is not None:
            white.need(rows)
            first = len(self.noise) - dropped
            block = np.empty((len(slow.numbers), *self.shape))
            block[:first], self.noise = self.noise[dropped:], block
            self._fill(np.arange(self.shape[0]), first, begins=False)
        if self.begins:
            begun = np.arange(self.shape[0])[rows][self.fresh[rows]]
            used = slow.used(begun)
            for first in np.unique(used):
                self._fill(begun[used == first], int(first), begins=True)
            self.fresh[begun] = False
            self.begins = bool(self.fresh.any())
        white.pass_over(rows)
        return slow.take(self.noise, rows)

    def _fill(self, rows: Index, first: int, begins: bool) -> None:
        """The noise of these rows from a sample of the block on."""
        from scipy.signal import lfilter

        slow = self._slow.numbers[first:, rows]
        total = self.white * self._whites.numbers[first:, rows][..., 0]
        for k, (decay, drive) in enumerate(zip(self.decay, self.drive, strict=True)):
            pushed = drive * slow[..., k]
            state = decay * self.level[rows, :, k]
            if begins:
                pushed[0], state = self.flicker * slow[0, ..., k], np.zeros_like(state)
            level, _ = lfilter([1.0], [1.0, -decay], pushed, axis=0, zi=state[None])
            self.level[rows, :, k] = level[-1]
            total += level
        steps = self.walk * slow[..., -1]
        if not begins:
            steps[0] += self.walked[rows]
        walked = np.cumsum(steps, axis=0)
        self.walked[rows] = walked[-1]
        self.noise[first:, rows] = total + walked
