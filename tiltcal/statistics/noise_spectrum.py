"""Noise of a channel, estimated from the recording itself, and the filter that makes it white.

Noise whose variance depends on frequency only is nearly diagonal in the cosine basis (DCT-II). A
noise model gives the variance S of each coefficient k of n as a function of s = 2 sin(pi k / 2n),
and is fitted by restricted Whittle likelihood: the leverage of the mean model is taken off. C^-1/2
= DCT^-1 S^-1/2 DCT is a filter without phase, so it keeps time local.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.statistics.cosine_transform import cosines, inverse_cosines
from tiltcal.statistics.dwell_noise import ARITHMETIC
from tiltcal.statistics.projection import column_space

BINS = 160  # of the logarithmic frequency axis: S is smooth
LOW = 3000  # cosine coefficients in which slow noise may stand out of white noise
CHI2_MEDIAN = 0.4549  # of one degree of freedom
CONFIDENCE = 3.84  # of deviance: 95 % of chi-square with one degree of freedom


Expansion = tuple[float, Array, Array]
"""A cost, nats, its slope, (p,), and its curvature, (p, p)."""


@dataclass(frozen=True)
class SpectrumBins:
    """Powers of cosine coefficients in bins of frequency.

    Args:
        weight: degrees of freedom of each bin, (m,).
        power: sum of squares, over ``scale``, (m,).
        inverse: 1/s at the middle of the bin, (m,).
        scale: SI^2, of the powers.
    """

    weight: Array
    power: Array
    inverse: Array
    scale: float

    @classmethod
    def none(cls) -> "SpectrumBins":
        """No bins: nothing is known of the spectrum."""
        return cls(np.zeros(0), np.zeros(0), np.zeros(0), 1.0)


@dataclass(frozen=True)
class Amplitude:
    """The size of one kind of noise.

    Args:
        value: the most likely one; low, high: 95 % interval; None where it was not estimated.
    """

    value: float
    low: float | None = None
    high: float | None = None

    def scaled(self, factor: float) -> "Amplitude":
        """In another unit."""
        ends = (None if x is None else factor * x for x in (self.low, self.high))
        return Amplitude(factor * self.value, *ends)


class NoiseModel(ABC):
    """Noise of one channel: its spectrum, and how that is fitted. Subclasses are frozen."""

    white: float
    """Standard deviation of the uncorrelated part of a sample, SI."""

    @abstractmethod
    def density(self, s: Array) -> Array:
        """Variance of the cosine coefficients at s = 2 sin(pi k / 2n), SI^2, (n,)."""

    @abstractmethod
    def scaled(self, factor: float) -> Self:
        """The same noise, ``factor`` times as large."""

    @classmethod
    @abstractmethod
    def most_likely(cls, bins: SpectrumBins) -> Self:
        """The model of the largest Whittle likelihood."""

    def most_probable(self, bins: SpectrumBins, price: Callable[[Self], Expansion]) -> Self:
        """The model of the largest posterior probability near this most likely one.

        Without more knowledge of a model this one.

        Args:
            bins: of the spectrum.
            price: -log prior of a model, along the logarithms of the variances of white noise,
                flicker and random walk.
        """
        return self

    @abstractmethod
    def bounds(self, bins: SpectrumBins, drop: float) -> tuple["NoiseModel", "NoiseModel"]:
        """The noisiest models, in two ways, whose deviance is ``drop`` above that of this one."""

    def amplitudes(self, bins: SpectrumBins, drop: float) -> dict[str, Amplitude]:
        """Its kinds of noise by name, SI, each with the interval in which the deviance is less than
        ``drop`` above its least, all else as likely as can be (profile likelihood).

        Without more knowledge of a model: white noise alone, the shape of the spectrum held.
        """
        if not len(bins.weight):
            return {"white": Amplitude(self.white)}
        weight = float(bins.weight.sum())
        best = float((bins.power * bins.scale / self.density(1 / bins.inverse)).sum()) / weight
        low, high = (self.white * float(np.sqrt(best * x)) for x in _scales(drop / weight))
        return {"white": Amplitude(self.white, min(low, self.white), max(high, self.white))}

    def drift_density(self, s: Array) -> Array:
        """The part of the density that begins at nothing with each recording: a random walk. s:
        (n,).
        """
        return np.zeros_like(s)

    def slow_noise(self, rate_hz: float) -> Array:
        """Flicker, SI, and random walk, SI per square root of a second, (2,); 0 where the model has
        none.
        """
        return np.zeros(2)

    def with_excess(self, weights: Array, excess: float) -> "NoiseModel":
        """A model with more noise: ``weights @ spectrum`` grows by ``excess``, SI^2. weights:
        (n,).
        """
        expected = float(weights @ self.spectrum(len(weights)))
        return self.scaled(float(np.sqrt(1 + excess / expected)))

    def spectrum(self, n: int) -> Array:
        """Variance of each of n cosine coefficients, SI^2; the level has that of its neighbour.
        (n,).
        """
        return np.asarray(self.density(sines(n)))

    def drift_spectrum(self, n: int) -> Array:
        """That of the drift alone, SI^2, (n,)."""
        return np.asarray(self.drift_density(sines(n)))

    def whiten(self, column: Array) -> Array:
        """C^-1/2 times a column, in time, (n,)."""
        return inverse_cosines(cosines(column) / np.sqrt(self.spectrum(len(column))))


def _scales(rise: float) -> tuple[float, float]:
    """The least and the largest x with log x + 1/x - 1 = rise: factors on a variance by which the
    deviance per degree of freedom rises so much.
    """
    from scipy.special import lambertw

    # with y = 1/x: y exp(-y) = exp(-1 - rise)
    ends = (-1 / lambertw(-np.exp(-1 - rise), branch).real for branch in (-1, 0))
    low, high = (float(x) for x in ends)
    return low, high


def sines(n: int) -> Array:
    """s of each cosine coefficient, (n,); the level has that of its neighbour."""
    return np.asarray(2 * np.sin(np.pi * np.maximum(np.arange(n), 1) / (2 * n)))


@dataclass(frozen=True)
class NoiseFit:
    """A fitted noise model with its binned spectrum."""

    model: NoiseModel
    bins: SpectrumBins

    @classmethod
    def known(cls, model: NoiseModel) -> "NoiseFit":
        """A model that was not fitted."""
        return cls(model, SpectrumBins.none())

    @classmethod
    def of(cls, e: Array, dof: Array, law: type[NoiseModel]) -> "NoiseFit":
        """Largest Whittle likelihood for coefficients e with degrees of freedom dof each, (n,)."""
        n = len(e)
        edges = np.unique(np.concatenate([np.arange(1, 24), np.geomspace(24, n, BINS).astype(int)]))
        which = np.searchsorted(edges, np.arange(1, n), side="right") - 1
        return cls._binned(e[1:], dof[1:], sines(n)[1:], which, law)

    @classmethod
    def within(cls, parts: Sequence[Array], law: type[NoiseModel]) -> "NoiseFit":
        """Largest Whittle likelihood for the cosine coefficients of parts of a record, (n_k,) each,
        whose levels are free.
        """
        e = np.concatenate([part[1:] for part in parts])
        s = np.concatenate([sines(len(part))[1:] for part in parts])
        which = np.floor(BINS * np.log(s / 2.0) / np.log(s.min() / 2.0)).astype(int)
        _, which = np.unique(which, return_inverse=True)
        return cls._binned(e, np.ones(len(e)), s, which, law)

    @classmethod
    def _binned(
        cls, e: Array, dof: Array, s: Array, which: Index, law: type[NoiseModel]
    ) -> "NoiseFit":
        """Of coefficients at s, (n,), in bins of these numbers."""
        weight = np.asarray(np.bincount(which, dof), dtype=float)
        power = np.asarray(np.bincount(which, e**2), dtype=float)
        inverse = np.exp(-np.bincount(which, np.log(s)) / np.bincount(which))
        keep = weight > 1e-6
        if keep.sum() < 3:  # the mean model takes everything: only the rms is known
            return cls.known(white_noise(max(float(np.sqrt(np.mean(e**2))), ARITHMETIC)))
        scale = max(float(power[keep].sum() / weight[keep].sum()), ARITHMETIC**2)
        bins = SpectrumBins(weight[keep], power[keep] / scale, inverse[keep], scale)
        return cls(law.most_likely(bins), bins)

    @classmethod
    def alike(cls, fits: Sequence["NoiseFit"], law: type[NoiseModel]) -> "NoiseFit":
        """Largest likelihood for several channels whose noise is alike, in units of the white noise
        of each.

        One record of one channel hardly separates flicker from random walk. A channel without a
        spectrum of its own adds nothing; where none has one the noise is white.
        """
        scales = [f.bins.scale / f.model.white**2 for f in fits]
        power = np.concatenate([f.bins.power * k for f, k in zip(fits, scales, strict=True)])
        weight = np.concatenate([f.bins.weight for f in fits])
        inverse = np.concatenate([f.bins.inverse for f in fits])
        if not len(weight):
            return cls.known(white_noise(1.0))
        bins = SpectrumBins(weight, power, inverse, 1.0)
        return cls(law.most_likely(bins), bins)

    @cached_property
    def deviance(self) -> float:
        """-2 log likelihood of the model, up to a constant of the spectrum."""
        S = self.model.density(1 / self.bins.inverse) / self.bins.scale
        return float(self.bins.weight @ np.log(S) + (self.bins.power / S).sum())

    def bounds(self, drop: float = CONFIDENCE) -> tuple[NoiseModel, NoiseModel]:
        """The noisiest models that the record allows: the deviance rises by ``drop``."""
        if not len(self.bins.weight):
            return self.model, self.model
        return self.model.bounds(self.bins, drop)

    @cached_property
    def amplitudes(self) -> dict[str, Amplitude]:
        """The amplitudes of the model with the 95 % intervals that the record allows."""
        return self.model.amplitudes(self.bins, CONFIDENCE)


def white_noise(sigma: float) -> NoiseModel:
    """White noise of this standard deviation of a sample, SI."""
    from tiltcal.statistics.white_flicker_walk import WhiteFlickerWalk

    return WhiteFlickerWalk(sigma)


def estimate_noise(
    residual: Array, mean: Array, law: type[NoiseModel], rounds: int = 2
) -> NoiseFit:
    """The noise behind a residual whose mean model is ``mean``.

    Args:
        residual: cosine coefficients (DCT-II, orthonormal), SI, (n,).
        mean: those of the columns that may be in it with any size, (n, p).
        law: kind of noise model.
        rounds: of generalised least squares and fit.
    """
    n = len(residual)
    # beyond it all noise is white and the mean has hardly any part
    slow = min(n, max(LOW, 4 * mean.shape[1]))
    tail = residual[slow:]
    white = float(np.sqrt(np.median(residual[n // 2 :] ** 2) / CHI2_MEDIAN))
    fit = NoiseFit.known(white_noise(max(white, ARITHMETIC)))
    for _ in range(rounds):
        root = np.sqrt(fit.model.spectrum(n)[:slow])
        Q = column_space(mean[:slow] / root[:, None])
        left = residual[:slow] / root
        left = (left - Q @ (Q.T @ left)) * root
        dof = np.clip(1 - (Q * Q).sum(axis=1), 0.0, 1.0)
        whole = np.concatenate([dof, np.ones(n - slow)])
        fit = NoiseFit.of(np.concatenate([left, tail]), whole, law)
    return fit
