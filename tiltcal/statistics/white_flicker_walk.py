"""White noise, flicker and a random walk: S(s) = sw^2 + sf^2 / s + sr^2 / s^2.

Exact in the cosine basis for white noise and for a random walk with a free level, whose precision
is D'D; nearly so for flicker.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.statistics.noise_spectrum import Amplitude, Expansion, NoiseModel, SpectrumBins

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
        """See ``NoiseModel``; s: (n,)."""
        return np.asarray(self.white**2 + self.flicker**2 / s + self.drift_density(s))

    def drift_density(self, s: Array) -> Array:
        """See ``NoiseModel``; s: (n,)."""
        return np.asarray(self.walk**2 / s**2)

    def slow_noise(self, rate_hz: float) -> Array:
        """See ``NoiseModel``, (2,)."""
        return np.array([self.flicker, self.walk * np.sqrt(rate_hz)])

    def scaled(self, factor: float) -> Self:
        """See ``NoiseModel``."""
        return type(self)(factor * self.white, factor * self.flicker, factor * self.walk)

    def with_excess(self, weights: Array, excess: float) -> NoiseModel:
        """See ``NoiseModel``; weights: (n,)."""
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
    """Half the deviance, its slope and its curvature along the logarithms of the variances. parts:
    what each of these adds to the spectrum of each bin, (m, 3).
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
    """Smallest deviance from a start, flicker or walk held, and where. start: variances without
    unit, (3,).

    By scoring: the expected curvature of the deviance is that of a weighted least-squares problem
    with non-negative variances.
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
