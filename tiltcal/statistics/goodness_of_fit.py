"""Whether white noise, flicker, a random walk and quantisation of the integral are all the noise
that a record has.

One test of the spectrum, at level 0.001, from the likelihood that the model is fitted by:

- Half octaves of frequency. Twice the log likelihood ratio of a free level in each band and of the
  model is the sum of ``w (r - 1 - ln r)``, with r the power over that of the model and w the
  degrees of freedom. Each term is divided by its mean, ``w (ln(w/2) - psi(w/2))`` (Bartlett), and
  the sum is chi-square with as many degrees of freedom as there are bands beyond the coefficients
  that are not zero.
- Lines. The largest square of a single coefficient over its variance, against the largest of n
  chi-squares of one degree of freedom.

p is twice the smaller of both probabilities (Bonferroni), so that a record of the model fails in
about 0.1 % of cases; 14 of 9000 did. Two things a spectrum does not show are found in the samples
themselves: steps too coarse for the noise, and more equal neighbours than the noise has.

Source: Whittle likelihood, Whittle (1953); the correction, Bartlett (1937); steps, Widrow and
    Kollar, Quantization Noise (2008), 4.
"""

from dataclasses import dataclass
from math import pi, sqrt
from typing import Self

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.statistics.standstill_spectrum import BINS_PER_OCTAVE, PowerBins

LEVEL = 1e-3  # of a channel: six channels of an IMU at rest fail in 0.6 % of recordings
WEIGHT = 2.0  # degrees of freedom of a band, at least: Bartlett's mean is good to 1 % of p = 0.001
GRID_SAMPLES = 20_000  # samples from which the step is determined
# below half a step of noise rounding is not white noise beside it; with the rounding's own twelfth
# the readings then have sqrt(1/4 + 1/12) of a step (Widrow and Kollar, 4)
COARSE = sqrt(1 / 3)
# heavy tails have more equal neighbours than a normal distribution of their rms: Laplace's 1.25
# times as many, sqrt(pi / 2); noise that is half the time three times as large 1.5 times
TAILS = 2.0
# over the frequency that the Allan deviation of an averaging time sees most: the largest
# sin^4(x) / x^2, x = pi f tau, is at tan(x) = 2 x, x = 1.1656 (IEEE 952, annex C)
TAU = 0.371


@dataclass(frozen=True)
class Band:
    """Power in a band of frequency.

    Args:
        low_hz, high_hz: its ends.
        ratio: standard deviation in it, over that of the model.
        p: probability of such a ratio under the model, two-sided.
    """

    low_hz: float
    high_hz: float
    ratio: float
    p: float

    @property
    def text(self) -> str:
        """Its frequencies, averaging times and ratio, as a note has them."""
        tau = f"tau {TAU / self.high_hz:.2g} to {TAU / self.low_hz:.2g} s"
        side = "up" if self.ratio > 1 else "down"
        ends = f"{self.low_hz:.3g} to {self.high_hz:.3g} Hz"
        return f"{ends} ({tau}): {side} to {self.ratio:.3g} times the model"


@dataclass(frozen=True)
class Line:
    """The largest single coefficient.

    Args:
        frequency_hz: where it is.
        amplitude: of a sine of its power, at least, in the unit of the record.
        p: probability of one so large under the model.
    """

    frequency_hz: float
    amplitude: float
    p: float


@dataclass(frozen=True)
class ModelTest:
    """Whether the noise model fits a record.

    Args:
        p: of the spectrum under the model.
        bands: half octaves, from the lowest on.
        line: the largest coefficient.
        notes: what the samples themselves show against it.
    """

    p: float
    bands: tuple[Band, ...]
    line: Line
    notes: tuple[str, ...] = ()

    @property
    def fits(self) -> bool:
        """Whether nothing speaks against the model."""
        return self.p >= LEVEL and not self.notes

    @property
    def wrong_bands(self) -> tuple[Band, ...]:
        """Those that differ from the model by themselves (Bonferroni), or the most unlikely where
        only all together do.
        """
        limit = LEVEL / (2 * len(self.bands))
        found = tuple(b for b in self.bands if b.p <= limit)
        if found or self.p >= LEVEL or 2 * self.line.p < LEVEL:
            return found
        return (min(self.bands, key=lambda b: b.p),)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why it does not fit: where, and by how much; empty where it does."""
        if self.fits:
            return ()
        found = [band.text for band in merged(self.wrong_bands)]
        if 2 * self.line.p < LEVEL:
            found.append(
                f"a line at {self.line.frequency_hz:.4g} Hz of amplitude"
                f" {self.line.amplitude:.3g} or more"
            )
        return (*found, *self.notes)


def merged(bands: tuple[Band, ...]) -> list[Band]:
    """Neighbours that lie on the same side of the model as one, with the ratio that is farthest
    from 1.
    """
    found: list[Band] = []
    for band in bands:
        last = found[-1] if found else None
        if last and last.high_hz == band.low_hz and (last.ratio > 1) == (band.ratio > 1):
            far = max(last, band, key=lambda b: abs(np.log(b.ratio)))
            found[-1] = Band(last.low_hz, band.high_hz, far.ratio, min(last.p, band.p))
        else:
            found.append(band)
    return found


def spectrum_test(bins: PowerBins, spectrum: Array, coefficients: int, rate_hz: float) -> ModelTest:
    """The test of the module.

    Args:
        bins: powers.
        spectrum: that of the fitted model in each, (m,).
        coefficients: of it that are not zero.
        rate_hz: of the samples.
    """
    from scipy.special import chdtr, chdtrc, digamma

    weight, power, edges = _bands(bins, spectrum)
    ratio = power / weight
    misfit = weight * (ratio - 1 - np.log(np.maximum(ratio, np.finfo(float).tiny)))
    mean = weight * (np.log(weight / 2) - digamma(weight / 2))
    freedom = max(len(weight) - coefficients, 1)
    p_bands = float(chdtrc(freedom, (misfit / mean).sum()))
    tails = 2 * np.minimum(chdtr(weight, power), chdtrc(weight, power))
    ends = np.arcsin(np.minimum(edges / 2, 1.0)) / pi * rate_hz
    columns = (ends[:-1], ends[1:], np.sqrt(ratio), np.minimum(tails, 1.0))
    bands = tuple(Band(*row) for row in np.column_stack(columns).tolist())
    line = _line(bins, spectrum, rate_hz)
    return ModelTest(min(2 * min(p_bands, line.p), 1.0), bands, line)


def _bands(bins: PowerBins, spectrum: Array) -> tuple[Array, Array, Array]:
    """Degrees of freedom and power over the model of each band, from the lowest on, (k,), and their
    ends in s, (k + 1,).
    """
    half = bins.number // (BINS_PER_OCTAVE // 2)
    numbers, which = np.unique(-half, return_inverse=True)
    w = np.bincount(which, bins.weight)
    x = np.bincount(which, bins.power / spectrum)
    # a band ends where it has enough degrees of freedom; what is left joins the last
    ends, total = [], 0.0
    for k, each in enumerate(w):
        total += each
        if total >= WEIGHT:
            ends.append(k + 1)
            total = 0.0
    starts = np.array([0, *ends[:-1]])
    top = 2.0 * 2.0 ** (np.append(numbers[0] - 1, numbers[np.append(starts[1:] - 1, -1)]) / 2)
    return np.add.reduceat(w, starts), np.add.reduceat(x, starts), top


def _line(bins: PowerBins, spectrum: Array, rate_hz: float) -> Line:
    """The largest coefficient over its variance."""
    from scipy.special import erfc

    excess = bins.peak / spectrum
    k = int(np.argmax(excess))
    one = float(erfc(np.sqrt(excess[k] / 2)))
    n = float(bins.weight.sum())
    p = float(-np.expm1(n * np.log1p(-min(one, 1 - 1e-16))))
    frequency = float(np.arcsin(bins.peak_s[k] / 2) / pi * rate_hz)
    return Line(frequency, float(np.sqrt(2 * bins.peak[k] / bins.length[k])), p)


@dataclass(frozen=True)
class NeighbourCounts:
    """Differences of neighbouring samples.

    Args:
        pairs: of neighbours.
        equal: pairs of equal samples.
        square_sum: of the differences, in the square of the unit of the record.
        step: median distance of distinct values; ``nan`` where there is one value.
    """

    pairs: int
    equal: int
    square_sum: float
    step: float

    @classmethod
    def none(cls) -> Self:
        """Those of no sample."""
        return cls(0, 0, 0.0, float("nan"))

    @classmethod
    def of(cls, values: Array) -> Self:
        """Those of samples, (n,)."""
        differences = np.diff(values)
        apart = np.diff(np.unique(values[:GRID_SAMPLES]))
        step = float(np.median(apart)) if len(apart) else float("nan")
        equal = len(differences) - int(np.count_nonzero(differences))
        return cls(len(differences), equal, float(differences @ differences), step)

    def __add__(self, other: "NeighbourCounts") -> "NeighbourCounts":
        """With those of a further piece."""
        return NeighbourCounts(
            self.pairs + other.pairs,
            self.equal + other.equal,
            self.square_sum + other.square_sum,
            float(np.fmin(self.step, other.step)),
        )

    @property
    def changes(self) -> int:
        """Pairs that differ."""
        return self.pairs - self.equal

    def notes(self) -> tuple[str, ...]:
        """What speaks against Gaussian noise that is rounded to steps."""
        from scipy.special import ndtri

        noise = sqrt(self.square_sum / (2 * self.pairs))  # of a sample
        if noise < COARSE * self.step:
            return (
                f"steps of {self.step:.3g} are {self.step / noise:.3g} times the noise of a sample,"
                " too coarse for rounding to be white noise",
            )
        expected = self._expected_equal(noise)
        # of each indicator with its two neighbours: at most three variances
        chance = -float(ndtri(LEVEL)) * sqrt(3 * self.pairs * TAILS * expected) + 1
        if self.equal <= TAILS * self.pairs * expected + chance:
            return ()
        return (
            f"{self.equal / self.pairs:.3g} of all samples equal the one before, where Gaussian"
            f" noise has {expected:.2g}: a dead zone, held or repeated samples",
        )

    def _expected_equal(self, noise: float) -> float:
        """Share of equal neighbours of white Gaussian noise with this rms after rounding: mean of
        max(0, 1 - |d| / step) over the difference d before it.
        """
        from scipy.special import ndtr

        x = self.step / sqrt(2 * (noise**2 - self.step**2 / 12))
        bump = sqrt(2 / pi) * -np.expm1(-(x**2) / 2) / x
        return float(2 * ndtr(x) - 1 - bump)
