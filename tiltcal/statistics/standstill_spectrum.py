"""Powers of the cosine coefficients of a record at standstill, in narrow bins of frequency.

Stationary noise is nearly uncorrelated in the cosine basis (DCT-II), see ``noise_spectrum``. The
record's level is free, and so is a straight line in time, whose size the fit finds.
``RunningSpectrum`` takes a record that comes piece by piece, in memory that does not grow with it.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.statistics.cosine_transform import cosines, quick_length
from tiltcal.statistics.noise_spectrum import sines

BINS_PER_OCTAVE = 12  # S ~ s^-2 varies by 12 % within one: its mean stands for it
LEAST_FREEDOM = 1e-6  # of a coefficient; the line takes all of one that has less
POWERS = (2.0, 0.0, -1.0, -2.0)  # of s: spectra of Q, N, B and K


@dataclass(frozen=True)
class PowerBins:
    """Squares of cosine coefficients in bins, 12 an octave, of s = 2 sin(pi f / rate).

    Args:
        number: of each bin, from the highest frequency on, (m,).
        weight: degrees of freedom, (m,).
        power: sum of squares, in the square of the unit of the record, (m,).
        peak: the largest square of one coefficient, (m,).
        peak_s: s of that coefficient, (m,).
        length: samples that were transformed at once, (m,).
        shapes: mean of s^2, 1, 1/s and 1/s^2, (m, 4).
    """

    number: Array
    weight: Array
    power: Array
    peak: Array
    peak_s: Array
    length: Array
    shapes: Array

    @classmethod
    def of(
        cls, squares: Array, freedom: Array, s: Array, samples: float, peaks: Array | None = None
    ) -> Self:
        """Bins of coefficients.

        Args:
            squares: of each, or the sum of several, (n,).
            freedom: degrees of freedom of each, (n,).
            s: of each, (n,).
            samples: that were transformed at once.
            peaks: the largest square of each sum, (n,); ``squares`` unless given.
        """
        peaks = squares if peaks is None else peaks
        known = freedom > LEAST_FREEDOM
        squares, freedom, s, peaks = squares[known], freedom[known], s[known], peaks[known]
        octaves = np.log2(s / 2.0)
        numbers, which = np.unique(np.floor(-BINS_PER_OCTAVE * octaves), return_inverse=True)
        counts = np.bincount(which)
        last = np.lexsort((peaks, which))[np.cumsum(counts) - 1]
        shapes = np.column_stack([np.bincount(which, s**p) / counts for p in POWERS])
        weight = np.bincount(which, freedom).astype(float)
        power = np.bincount(which, squares).astype(float)
        length = np.full(len(numbers), float(samples))
        return cls(numbers, weight, power, peaks[last], s[last], length, shapes)

    def joined(self, other: Self) -> Self:
        """These bins, and others of other coefficients."""
        parts = zip(vars(self).values(), vars(other).values(), strict=True)
        return type(self)(*(np.concatenate(pair) for pair in parts))


@dataclass(frozen=True)
class StandstillSpectrum:
    """Cosine coefficients of a record, without its level.

    Args:
        coefficients: of the record, in its unit, (n,).
        line: those of a straight line of unit slope per second, s, (n,).
        s: 2 sin(pi f / rate) of each, (n,).
        samples: that were transformed.
        rate_hz: of the samples.
        fast: bins of what was transformed in pieces; None where all are above.
    """

    coefficients: Array
    line: Array
    s: Array
    samples: int
    rate_hz: float
    fast: PowerBins | None = None

    @classmethod
    def of(cls, values: Array, rate_hz: float) -> Self:
        """That of samples, (n,); up to 1 % of them are left off for the transform's sake."""
        n = quick_length(len(values))
        line = cosines(np.arange(n) / rate_hz)
        return cls(cosines(values[:n])[1:], line[1:], sines(n)[1:], n, rate_hz)

    def bins(self, slope: float, information: Array) -> PowerBins:
        """Powers without a line of this slope, whose information of each coefficient, (n,), takes
        one degree of freedom of all.
        """
        squares = (self.coefficients - slope * self.line) ** 2
        found = PowerBins.of(squares, 1.0 - information / information.sum(), self.s, self.samples)
        return found if self.fast is None else found.joined(self.fast)


LONGEST = 1 << 17  # coefficients that ``RunningSpectrum`` holds of a channel: 1 MB
BLOCK = 1 << 16  # samples that are transformed at once where a record is longer
# times 2 / D is s where means of D samples take over from blocks: a mean lowers the power there by
# (pi f D / rate)^2 / 3 = 0.5 %, and a block of 2^16 samples has its 5000 / D-th coefficient
TAKEOVER = 1 / 8


class RunningSpectrum:
    """``StandstillSpectrum`` of a record that comes piece by piece.

    Where the record is long, low frequencies are those of means over D samples, and high ones the
    sum over blocks of 2^16 samples. What a last mean or block lacks is left off.

    Args:
        samples: that are expected.
        rate_hz: of the samples.
    """

    def __init__(self, samples: int, rate_hz: float) -> None:
        self._rate = rate_hz
        self._width = 1 << max(int(np.ceil(np.log2(max(samples, 1) / LONGEST))), 0)
        self._means: list[Array] = []
        self._offset: float | None = None
        self._pending_mean, self._pending_block = np.zeros(0), np.zeros(0)
        self._squares, self._peaks, self._blocks = np.zeros(BLOCK), np.zeros(BLOCK), 0

    def add(self, values: Array) -> None:
        """Go on with further values, (n,)."""
        if not len(values):
            return
        if self._offset is None:
            self._offset = float(values.mean())
        values = values - self._offset
        held = np.concatenate([self._pending_mean, values])
        whole = len(held) // self._width * self._width
        self._means.append(held[:whole].reshape(-1, self._width).mean(axis=1))
        self._pending_mean = held[whole:]
        if self._width > 1:
            self._add_blocks(values)

    def _add_blocks(self, values: Array) -> None:
        held = np.concatenate([self._pending_block, values])
        whole = len(held) // BLOCK * BLOCK
        for block in held[:whole].reshape(-1, BLOCK):
            squares = cosines(block) ** 2
            self._squares += squares
            self._peaks = np.maximum(self._peaks, squares)
            self._blocks += 1
        self._pending_block = held[whole:]

    def spectrum(self) -> StandstillSpectrum:
        """That of all values so far."""
        means = np.concatenate(self._means)
        whole = StandstillSpectrum.of(means, self._rate / self._width)
        if not self._blocks:
            return whole
        takeover = 2.0 / self._width * TAKEOVER
        s = sines(BLOCK)[1:]
        high = s >= takeover
        freedom = np.full(int(high.sum()), float(self._blocks))
        fast = PowerBins.of(self._squares[1:][high], freedom, s[high], BLOCK, self._peaks[1:][high])
        # the sine of half the angle, s / 2, at a sample instead of at a mean
        s = 2.0 * np.sin(np.arcsin(whole.s / 2.0) / self._width)
        low, size = s < takeover, np.sqrt(self._width)
        e, line = whole.coefficients[low] * size, whole.line[low] * size
        n = whole.samples * self._width
        return StandstillSpectrum(e, line, s[low], n, self._rate, fast)
