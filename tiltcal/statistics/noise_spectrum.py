"""Noise of a channel, estimated from the recording itself, and the filter that makes it white.

Noise whose variance depends on frequency only is nearly diagonal in the cosine basis (DCT-II). A
noise model gives the variance S of each coefficient k of n as a function of s = 2 sin(pi k / 2n),
and is fitted by restricted Whittle likelihood: the leverage of the mean model is taken off. C^-1/2
= DCT^-1 S^-1/2 DCT is a filter without phase, so it keeps time local.

The model in use is white noise, flicker and a random walk: S(s) = sw^2 + sf^2 / s + sr^2 / s^2. It
is exact in the cosine basis for white noise and for a random walk with a free level, whose
precision is D'D; nearly so for flicker.
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
from tiltcal.statistics.least_squares import space_with_prior

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
        value: the most likely one.
        low, high: 95 % interval; None where it was not estimated.
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
        """The part of the density that begins at nothing with each recording: a random walk.

        Args:
            s: (n,).
        """
        return np.zeros_like(s)

    def slow_noise(self, rate_hz: float) -> Array:
        """Flicker, SI, and random walk, SI per square root of a second, (2,); 0 where the model has
        none.
        """
        return np.zeros(2)

    def with_excess(self, weights: Array, excess: float) -> "NoiseModel":
        """A model with more noise: ``weights @ spectrum`` grows by ``excess``, SI^2.

        Args:
            weights: (n,).
            excess: size of the excess noise.
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
    def of(cls, e: Array, dof: Array, kind: type[NoiseModel]) -> "NoiseFit":
        """Largest Whittle likelihood for coefficients e with degrees of freedom dof each, (n,)."""
        n = len(e)
        edges = np.unique(np.concatenate([np.arange(1, 24), np.geomspace(24, n, BINS).astype(int)]))
        which = np.searchsorted(edges, np.arange(1, n), side="right") - 1
        return cls._binned(e[1:], dof[1:], sines(n)[1:], which, kind)

    @classmethod
    def within(cls, parts: Sequence[Array], kind: type[NoiseModel]) -> "NoiseFit":
        """Largest Whittle likelihood for the cosine coefficients of parts of a record, (n_k,) each,
        whose levels are free.
        """
        e = np.concatenate([part[1:] for part in parts])
        s = np.concatenate([sines(len(part))[1:] for part in parts])
        which = np.floor(BINS * np.log(s / 2.0) / np.log(s.min() / 2.0)).astype(int)
        _, which = np.unique(which, return_inverse=True)
        return cls._binned(e, np.ones(len(e)), s, which, kind)

    @classmethod
    def _binned(
        cls, e: Array, dof: Array, s: Array, which: Index, kind: type[NoiseModel]
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
        return cls(kind.most_likely(bins), bins)

    @classmethod
    def alike(cls, fits: Sequence["NoiseFit"], kind: type[NoiseModel]) -> "NoiseFit":
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
        return cls(kind.most_likely(bins), bins)

    @cached_property
    def deviance(self) -> float:
        """-2 log likelihood of the model, up to a constant of the spectrum."""
        S = self.model.density(1 / self.bins.inverse) / self.bins.scale
        return float(self.bins.weight @ np.log(S) + (self.bins.power / S).sum())

    @property
    def slow_gain(self) -> float:
        """By how much the model explains the spectrum better than white noise does, nats."""
        bins = self.bins
        if not len(bins.weight):
            return 0.0
        weight = float(bins.weight.sum())
        white = weight * (np.log(float(bins.power.sum()) / weight) + 1)
        return float(white - self.deviance) / 2

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
    return WhiteFlickerWalk(sigma)


def estimate_noise(
    residual: Array,
    mean: Array,
    kind: type[NoiseModel],
    rounds: int = 2,
    random: Array | None = None,
) -> NoiseFit:
    """The noise behind a residual whose mean model is ``mean``.

    Args:
        residual: cosine coefficients (DCT-II, orthonormal), SI, (n,).
        mean: those of the columns that may be in it with any size, (n, p).
        kind: class of the noise model.
        rounds: of generalised least squares and fit.
        random: those of columns that are in it with a normal size of unit variance, (n, q).
    """
    n = len(residual)
    random = mean[:, :0] if random is None else random
    # beyond it all noise is white and the mean has hardly any part
    slow = min(n, max(LOW, 4 * (mean.shape[1] + random.shape[1])))
    tail = residual[slow:]
    white = float(np.sqrt(np.median(residual[n // 2 :] ** 2) / CHI2_MEDIAN))
    fit = NoiseFit.known(white_noise(max(white, ARITHMETIC)))
    for _ in range(rounds):
        root = np.sqrt(fit.model.spectrum(n)[:slow])
        Q = space_with_prior(mean[:slow] / root[:, None], random[:slow] / root[:, None])
        left = residual[:slow] / root
        left = (left - Q @ (Q.T @ left)) * root
        dof = np.clip(1 - (Q * Q).sum(axis=1), 0.0, 1.0)
        whole = np.concatenate([dof, np.ones(n - slow)])
        fit = NoiseFit.of(np.concatenate([left, tail]), whole, kind)
    return fit


RISE = 10.8  # of deviance: 0.1 % of chi-square with one degree of freedom


def most_slow_variance(parts: Sequence[Array], counts: Array, length: int) -> Array:
    """Variance of means by flicker about the mean of the whole record, SI^2, (m,): by the most
    flicker which the spectrum of some parts allows at 0.1 %.

    Args:
        parts: stretches of a record less their means, (n_i,) each.
        counts: samples of each mean, (m,).
        length: samples of the record.
    """
    spectra = [cosines(part) for part in parts if len(part) > 3]
    if not spectra or not any(e[1:].any() for e in spectra):
        return np.zeros(len(counts))
    fit = NoiseFit.within(spectra, WhiteFlickerWalk)
    flicker = WhiteFlickerWalk(0.0, float(fit.bounds(RISE)[0].slow_noise(1.0)[0]))
    k = np.unique(np.geomspace(1, length - 1, LOW).astype(int))
    share = np.diff(np.concatenate([[0], k]))  # coefficients that each stands for
    # a mean over n samples passes sin(x)/x of a cosine, x = pi k n / 2 length
    passed = np.sinc(k * counts[:, None] / (2 * length)) ** 2
    density = flicker.density(2 * np.sin(np.pi * k / (2 * length)))
    return np.asarray(passed @ (share * density) / length)


SCORINGS = 60  # at most: convergence is quadratic in the end
CLOSE = 1e-7  # of the deviance, that a further step may bring
LEAST_WHITE = np.exp(-12.0)  # share of the mean power
NOTHING = -14.0  # log of a variance, over that which the slowest bin would have from it alone
NEWTON = 60  # steps at most
FAR = 2.0  # of the logarithm of a variance, that a step may reach
NEAR = 1e-3  # nats, that a further step may bring
FLAT = 1e-2  # nats: the curvature is taken as at least this
HALVED = 10  # times, until a step lowers the cost
LESS = np.array([[1.0, 1e-2, 1.0], [1.0, 1.0, 1e-2]])  # of the variances, at further starts


@dataclass(frozen=True)
class WhiteFlickerWalk(NoiseModel):
    """White noise, flicker and random walk.

    Args:
        white: standard deviation of a sample, SI.
        flicker: its density, SI: sf of the module's formula.
        walk: step of the random walk per sample, SI.
    """

    white: float
    flicker: float = 0.0
    walk: float = 0.0

    def density(self, s: Array) -> Array:
        """See ``NoiseModel``.

        Args:
            s: (n,).
        """
        return np.asarray(self.white**2 + self.flicker**2 / s + self.drift_density(s))

    def drift_density(self, s: Array) -> Array:
        """See ``NoiseModel``.

        Args:
            s: (n,).
        """
        return np.asarray(self.walk**2 / s**2)

    def slow_noise(self, rate_hz: float) -> Array:
        """See ``NoiseModel``, (2,)."""
        return np.array([self.flicker, self.walk * np.sqrt(rate_hz)])

    def scaled(self, factor: float) -> Self:
        """See ``NoiseModel``."""
        return type(self)(factor * self.white, factor * self.flicker, factor * self.walk)

    def with_excess(self, weights: Array, excess: float) -> NoiseModel:
        """See ``NoiseModel``.

        Args:
            weights: (n,).
            excess: size of the excess noise.
        """
        each = float(weights @ type(self)(0.0, 1.0).spectrum(len(weights)))
        flicker = float(np.sqrt(self.flicker**2 + excess / each))
        return type(self)(self.white, flicker, self.walk)

    @classmethod
    def most_likely(cls, bins: SpectrumBins) -> Self:
        """See ``NoiseModel``."""
        low = 1 / float(bins.inverse.max())
        starts = np.array([[1.0, 1e-2 * low, 1e-1 * low**2], [1.0, low, 1e-4 * low**2]])
        return cls._at(min((search(bins, s) for s in starts), key=lambda found: found[0])[1], bins)

    def most_probable(self, bins: SpectrumBins, price: Callable[[Self], Expansion]) -> Self:
        """The model of the largest posterior probability: Newton's method in the logarithms of the
        variances, from the largest likelihood with all or little of the slow noise, and with as
        much as white noise has where it is slowest. ``price``: see ``NoiseModel``.
        """
        shares = _shares(bins)

        def expanded(logs: Array) -> Expansion:
            v = np.exp(logs)
            return _sum(_expanded(bins, shares * v), price(self._at(v, bins)))

        best = np.array([self.white, self.flicker, self.walk]) ** 2 / bins.scale
        slowest = 1 / float(bins.inverse.max())
        nothing = np.exp(NOTHING) * slowest ** np.arange(3)
        starts = [best, *(best * less for less in LESS), best[0] * slowest ** np.arange(3)]
        logs = np.unique(np.log(np.maximum(starts, nothing)), axis=0)
        descended = [_descended(start, expanded) for start in logs]
        return self._at(np.exp(min(descended, key=lambda found: found[0])[1]), bins)

    def bounds(self, bins: SpectrumBins, drop: float) -> tuple[NoiseModel, NoiseModel]:
        """With as much flicker, and as much random walk, as the deviance allows."""
        found = np.array([self.white, self.flicker, self.walk]) ** 2 / bins.scale
        best = np.maximum(found, np.finfo(float).eps ** 1.5)
        return self._at(_bound(bins, best, 1, drop), bins), self._at(
            _bound(bins, best, 2, drop), bins
        )

    def amplitudes(self, bins: SpectrumBins, drop: float) -> dict[str, Amplitude]:
        """White noise, flicker and walk, each with its profile's interval."""
        sizes = {"white": self.white, "flicker": self.flicker, "walk": self.walk}
        if not len(bins.weight):
            return {name: Amplitude(size) for name, size in sizes.items()}
        best = np.array(list(sizes.values())) ** 2 / bins.scale
        found = {}
        for k, (name, size) in enumerate(sizes.items()):
            low, high = np.sqrt(np.array(_interval(bins, best, k, drop)) * bins.scale)
            found[name] = Amplitude(size, min(float(low), size), max(float(high), size))
        return found

    @classmethod
    def _at(cls, v: Array, bins: SpectrumBins) -> Self:
        return cls(*np.sqrt(v * bins.scale).tolist())


def deviance(bins: SpectrumBins, v: Array) -> float:
    """-2 log likelihood at the variances v = (sw^2, sf^2, sr^2) / scale. v: (3,)."""
    return _deviance(bins, _shares(bins) @ v)


def _deviance(bins: SpectrumBins, S: Array) -> float:
    return float(bins.weight @ np.log(S) + (bins.power / S).sum())


def _shares(bins: SpectrumBins) -> Array:
    """What each of the three variances, at 1, adds to the spectrum of each bin, (m, 3)."""
    return np.column_stack([np.ones_like(bins.inverse), bins.inverse, bins.inverse**2])


def _expanded(bins: SpectrumBins, parts: Array) -> Expansion:
    """Half the deviance, its slope and its curvature along the logarithms of the variances.

    Args:
        parts: what each of these adds to the spectrum of each bin, (m, 3).
    """
    S = parts.sum(axis=1)
    share, ratio = parts / S[:, None], bins.power / S
    slope = 0.5 * (bins.weight - ratio) @ share
    curvature = 0.5 * share.T @ ((2 * ratio - bins.weight)[:, None] * share)
    curvature[np.diag_indices(3)] += slope
    return 0.5 * _deviance(bins, S), slope, curvature


def _sum(one: Expansion, other: Expansion) -> Expansion:
    return one[0] + other[0], one[1] + other[1], one[2] + other[2]


def _descended(logs: Array, expanded: Callable[[Array], Expansion]) -> tuple[float, Array]:
    """The smallest cost near a start, and where, (3,).

    By Newton's method with the curvature taken as positive along each of its axes, steps halved
    until they lower the cost (Nocedal and Wright, Numerical Optimization, 2006, 3.4).
    """
    least = np.array([np.log(LEAST_WHITE), -np.inf, -np.inf])
    logs = np.maximum(logs, least)
    cost, slope, curvature = expanded(logs)
    for _ in range(NEWTON):
        bends, axes = np.linalg.eigh(curvature)
        step = -axes @ (axes.T @ slope / np.maximum(np.abs(bends), FLAT))
        step *= min(1.0, FAR / max(float(np.abs(step).max()), NEAR))
        if -float(slope @ step) < NEAR:
            break
        for share in 0.5 ** np.arange(HALVED):
            there = np.maximum(logs + share * step, least)
            found = expanded(there)
            if found[0] < cost:
                break
        else:
            break
        logs, (cost, slope, curvature) = there, found
    return cost, logs


def search(bins: SpectrumBins, start: Array, fixed: int | None = None) -> tuple[float, Array]:
    """Smallest deviance from a start, flicker or walk held, and where.

    By scoring: the expected curvature of the deviance is that of a weighted least-squares problem
    with non-negative variances.

    Args:
        bins: bins of the spectrum.
        start: variances without unit, (3,).
        fixed: values that are not searched.
    """
    from scipy.optimize import nnls

    shares = _shares(bins)
    v, free = np.array(start), [k for k in range(3) if k != fixed]
    held = 0.0 if fixed is None else shares[:, fixed] * v[fixed]
    cost = _deviance(bins, shares @ v)
    for _ in range(SCORINGS):
        root = np.sqrt(bins.weight) / (shares @ v)
        columns = shares[:, free] * root[:, None]
        size = np.sqrt((columns**2).sum(axis=0))
        step = np.zeros(3)
        target = (bins.power / bins.weight - held) * root
        step[free] = nnls(columns / size, target)[0] / size - v[free]
        step[0] = max(step[0], LEAST_WHITE - v[0])
        before, share = cost, 1.0
        while (cost := _deviance(bins, shares @ (v + share * step))) > before and share > CLOSE:
            share /= 2
        if cost > before:
            return before, v
        v = v + share * step
        if before - cost < CLOSE:
            break
    return cost, v


def _bound(bins: SpectrumBins, best: Array, which: int, drop: float) -> Array:
    """The variances where one of them is as large as the deviance allows."""
    from scipy.optimize import brentq

    floor = deviance(bins, best)
    low = 1 / float(bins.inverse.max())
    inside = max(float(np.log(best[which])), (2 * which - 2) * np.log(low) - 14.0)
    found = best

    def above(size: float) -> float:
        nonlocal found
        start = found.copy()
        start[which] = np.exp(size)
        cost, v = search(bins, start, which)
        if cost - floor <= drop:
            found = v
        return cost - floor - drop

    if above(inside) < 0 < above(6.0):
        brentq(above, inside, 6.0, xtol=0.01)
    return found


def _interval(bins: SpectrumBins, best: Array, which: int, drop: float) -> tuple[float, float]:
    """The least and the largest that one variance can be with the deviance less than ``drop`` above
    the best; 0 where even none of it is as likely.
    """
    from scipy.optimize import brentq

    floor = deviance(bins, best)
    slowest = 1 / float(bins.inverse.max())
    # where one variance alone is all there is of the slowest bin, and where it is next to nothing
    scale = which * np.log(slowest)
    middle = max(float(np.log(max(best[which], 1e-300))), scale - 28.0)

    def above(size: float) -> float:
        start = best.copy()
        start[which] = np.exp(size)
        return search(bins, start, which)[0] - floor - drop

    least, most = middle - 28.0, max(scale, middle) + 28.0
    low, high = 0.0, float(np.exp(middle))
    if above(middle) < 0 < above(least):
        low = float(np.exp(brentq(above, least, middle, xtol=0.005)))
    if above(middle) < 0 < above(most):
        high = float(np.exp(brentq(above, middle, most, xtol=0.005)))
    return low, high
