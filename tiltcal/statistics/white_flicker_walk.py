"""White noise, flicker and a random walk: S(s) = sw^2 + sf^2 / s + sr^2 / s^2.

Exact in the cosine basis for white noise and for a random walk with a free level, whose precision
is D'D; nearly so for flicker.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.statistics.noise_spectrum import NoiseModel, SpectrumBins

SCORINGS = 60  # at most: convergence is quadratic in the end
CLOSE = 1e-7  # of the deviance, that a further step may bring
LEAST_WHITE = np.exp(-12.0)  # share of the mean power


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
        return np.asarray(self.white**2 + self.flicker**2 / s + self.drift_density(s))

    def drift_density(self, s: Array) -> Array:
        return np.asarray(self.walk**2 / s**2)

    def scaled(self, factor: float) -> Self:
        return type(self)(factor * self.white, factor * self.flicker, factor * self.walk)

    def with_excess(self, weights: Array, excess: float) -> NoiseModel:
        each = float(weights @ type(self)(0.0, 1.0).spectrum(len(weights)))
        flicker = float(np.sqrt(self.flicker**2 + excess / each))
        return type(self)(self.white, flicker, self.walk)

    @classmethod
    def most_likely(cls, bins: SpectrumBins) -> Self:
        low = 1 / float(bins.inverse.max())
        starts = np.array([[1.0, 1e-2 * low, 1e-1 * low**2], [1.0, low, 1e-4 * low**2]])
        return cls._at(min((search(bins, s) for s in starts), key=lambda found: found[0])[1], bins)

    def bounds(self, bins: SpectrumBins, drop: float) -> tuple[NoiseModel, NoiseModel]:
        """With as much flicker, and as much random walk, as the deviance allows."""
        found = np.array([self.white, self.flicker, self.walk]) ** 2 / bins.scale
        best = np.maximum(found, np.finfo(float).eps ** 1.5)
        return self._at(_bound(bins, best, 1, drop), bins), self._at(
            _bound(bins, best, 2, drop), bins
        )

    @classmethod
    def _at(cls, v: Array, bins: SpectrumBins) -> Self:
        return cls(*(float(x) for x in np.sqrt(v * bins.scale)))


def deviance(bins: SpectrumBins, v: Array) -> float:
    """-2 log likelihood at the variances v = (sw^2, sf^2, sr^2) / scale."""
    S = _shares(bins) @ v
    return float(bins.weight @ np.log(S) + (bins.power / S).sum())


def _shares(bins: SpectrumBins) -> Array:
    """What each of the three variances, at 1, adds to the spectrum of each bin, (m, 3)."""
    return np.column_stack([np.ones_like(bins.inverse), bins.inverse, bins.inverse**2])


def search(bins: SpectrumBins, start: Array, fixed: int | None = None) -> tuple[float, Array]:
    """Smallest deviance from a start, flicker or walk held, and where.

    By scoring: the expected curvature of the deviance is that of a weighted least-squares problem
    with non-negative variances.
    """
    from scipy.optimize import nnls

    shares = _shares(bins)
    v, free = np.array(start), [k for k in range(3) if k != fixed]
    held = 0.0 if fixed is None else shares[:, fixed] * v[fixed]
    cost = deviance(bins, v)
    for _ in range(SCORINGS):
        root = np.sqrt(bins.weight) / (shares @ v)
        columns = shares[:, free] * root[:, None]
        size = np.sqrt((columns**2).sum(axis=0))
        step = np.zeros(3)
        target = (bins.power / bins.weight - held) * root
        step[free] = nnls(columns / size, target)[0] / size - v[free]
        step[0] = max(step[0], LEAST_WHITE - v[0])
        before, share = cost, 1.0
        while (cost := deviance(bins, v + share * step)) > before and share > CLOSE:
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
