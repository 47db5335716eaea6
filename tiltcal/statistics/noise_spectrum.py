"""Noise of a channel from the recording itself, and the filter that makes it white.

White noise, flicker and a random walk on evenly numbered samples are diagonal in the cosine basis
(DCT-II): exactly so for
white noise and for a random walk with a free level, whose precision is D'D, nearly so for flicker.
Their variances there,
S(k) = sw^2 + sf^2 / s + sr^2 / s^2 with s = 2 sin(pi k / 2n), are estimated by restricted
likelihood (Whittle's, with the
leverage of the mean model taken off); C^-1/2 = DCT^-1 S^-1/2 DCT is a filter without phase, so it
keeps time local.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.statistics.dwell_noise import ARITHMETIC

BINS = 160  # of the logarithmic frequency axis: S is smooth
LOW = 3000  # cosine coefficients in which flicker and walk may stand out of white noise
SCORINGS = 60  # at most: it is quadratic in the end
CLOSE = 1e-7  # of the cost, that a further step may bring
DISTINCT = 1e-9  # least share of a column's energy that is a direction of its own, per column
LEAST_WHITE = np.exp(-12.0)  # share of the mean power


@dataclass(frozen=True)
class NoiseModel:
    """Noise of one channel.

    Args:
        white: standard deviation of a sample, SI.
        flicker: its density, SI: sf of the module's formula.
        walk: step of the random walk per sample, SI.
    """

    white: float
    flicker: float = 0.0
    walk: float = 0.0

    def spectrum(self, n: int) -> Array:
        """Variance of each cosine coefficient, SI^2, (n,); that of the level is that of its
        neighbour.
        """
        return np.asarray(self.white**2 + self.flicker**2 / _sines(n) + self.walked(n))

    def walked(self, n: int) -> Array:
        """That of the random walk alone, SI^2, (n,)."""
        return np.asarray(self.walk**2 / _sines(n) ** 2)

    def whiten(self, column: Array) -> Array:
        """C^-1/2 times a column, in time, (n,)."""
        from scipy.fft import dct, idct

        return np.asarray(
            idct(dct(column, norm="ortho") / np.sqrt(self.spectrum(len(column))), norm="ortho")
        )


def _sines(n: int) -> Array:
    return np.asarray(2 * np.sin(np.pi * np.maximum(np.arange(n), 1) / (2 * n)))


def robust_white(residual: Array) -> float:
    """White noise from second differences, which no slow signal enters."""
    second = residual[2:] - 2 * residual[1:-1] + residual[:-2]
    spread = 1.4826 * np.median(np.abs(second)) / np.sqrt(6)
    return float(max(spread, 0.05 * np.std(second), ARITHMETIC))


def column_space(columns: Array) -> Array:
    """An orthonormal basis of the space of some columns, (n, rank)."""
    size = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    if not size.any():
        return columns[:, :0]
    size = np.where(size > 0, size, np.inf)
    values, vectors = np.linalg.eigh(columns.T @ columns / np.outer(size, size))
    keep = values > DISTINCT * np.isfinite(size).sum()
    Q = columns @ (vectors[:, keep] / np.sqrt(values[keep]) / size[:, None])
    values, vectors = np.linalg.eigh(
        Q.T @ Q
    )  # once more: what rounding left of the small directions, at the cost of a product
    return np.asarray(Q @ (vectors / np.sqrt(values)))


def estimate_noise(
    residual: Array, mean: Array, start: NoiseModel | None = None, rounds: int = 2
) -> "NoiseFit":
    """The noise behind a residual whose mean model is ``mean``.

    Args:
        residual: cosine coefficients (DCT-II, orthonormal), SI, (n,).
        mean: those of the columns that may be in it with any size, (n, p).
        start: a first guess.
        rounds: of generalised least squares and fit.
    """
    n = len(residual)
    slow = min(
        n, max(LOW, 4 * mean.shape[1])
    )  # beyond it all noise is white and the mean has hardly any part
    tail = residual[slow:]
    if start is None:
        start = NoiseModel(
            max(float(np.sqrt(np.median(residual[n // 2 :] ** 2) / 0.4549)), ARITHMETIC)
        )
    fit = NoiseFit.whole(start)
    for _ in range(rounds):
        root = np.sqrt(fit.model.spectrum(n)[:slow])
        Q = column_space(mean[:slow] / root[:, None])
        left = residual[:slow] / root
        left = (left - Q @ (Q.T @ left)) * root
        dof = np.clip(1 - (Q * Q).sum(axis=1), 0.0, 1.0)
        fit = NoiseFit.of(np.concatenate([left, tail]), np.concatenate([dof, np.ones(n - slow)]))
    return fit


@dataclass(frozen=True)
class NoiseFit:
    """A fitted noise model with its binned spectrum.

    Args:
        model: the most likely one.
        weight: degrees of freedom of each bin, (m,); power: sum of squares, over ``scale``;
            inverse: 1/s of its middle.
        scale: SI^2, of the powers.
    """

    model: NoiseModel
    weight: Array
    power: Array
    inverse: Array
    scale: float

    @classmethod
    def whole(cls, model: NoiseModel) -> "NoiseFit":
        """A model that was not fitted."""
        none = np.zeros(0)
        return cls(model, none, none, none, 1.0)

    @classmethod
    def of(cls, e: Array, dof: Array) -> "NoiseFit":
        """Largest Whittle likelihood for coefficients e with degrees of freedom dof each, (n,)."""
        n = len(e)
        edges = np.unique(np.concatenate([np.arange(1, 24), np.geomspace(24, n, BINS).astype(int)]))
        which = np.searchsorted(edges, np.arange(1, n), side="right") - 1
        return cls._binned(e[1:], dof[1:], _sines(n)[1:], which)

    @classmethod
    def within(cls, parts: Sequence[Array]) -> "NoiseFit":
        """Largest Whittle likelihood for the cosine coefficients of parts of a record, (n_k,) each,
        whose levels are free.
        """
        e = np.concatenate([part[1:] for part in parts])
        s = np.concatenate([_sines(len(part))[1:] for part in parts])
        which = np.floor(BINS * np.log(s / 2.0) / np.log(s.min() / 2.0)).astype(int)
        _, which = np.unique(which, return_inverse=True)
        return cls._binned(e, np.ones(len(e)), s, which)

    @classmethod
    def _binned(cls, e: Array, dof: Array, s: Array, which: Index) -> "NoiseFit":
        """Of coefficients at s, (n,), in bins of these numbers."""
        weight = np.asarray(np.bincount(which, dof), dtype=float)
        power = np.asarray(np.bincount(which, e**2), dtype=float)
        inverse = np.exp(-np.bincount(which, np.log(s)) / np.bincount(which))
        keep = weight > 1e-6
        if keep.sum() < 3:  # the mean model takes all there is: its rms is all that is known
            return cls.whole(NoiseModel(max(float(np.sqrt(np.mean(e**2))), ARITHMETIC)))
        scale = max(float(power[keep].sum() / weight[keep].sum()), ARITHMETIC**2)
        return cls(
            NoiseModel(0.0), weight[keep], power[keep] / scale, inverse[keep], scale
        ).searched()

    @classmethod
    def alike(cls, fits: Sequence["NoiseFit"]) -> "NoiseFit":
        """Largest likelihood for several channels whose noise is alike, in units of the white noise
        of each.

        What one record of one channel tells of its flicker and its walk apart is little. A channel
        without a spectrum of its own
        (its mean model takes all there is) tells nothing; where none has one the noise is white.
        """
        scales = [f.scale / f.model.white**2 for f in fits]
        power = np.concatenate([f.power * scale for f, scale in zip(fits, scales, strict=True)])
        weight, inverse = (
            np.concatenate(parts) for parts in ([f.weight for f in fits], [f.inverse for f in fits])
        )
        return (
            cls(NoiseModel(1.0), weight, power, inverse, 1.0).searched()
            if len(weight)
            else cls.whole(NoiseModel(1.0))
        )

    def searched(self) -> "NoiseFit":
        """With the most likely model of its spectrum."""
        low = 1 / float(self.inverse.max())
        starts = np.array([[1.0, 1e-2 * low, 1e-1 * low**2], [1.0, low, 1e-4 * low**2]])
        return replace(
            self,
            model=self.at(min((self.search(s) for s in starts), key=lambda found: found[0])[1]),
        )

    def cost(self, v: Array) -> float:
        """-2 log likelihood at the variances v = (sw^2, sf^2, sr^2) / scale."""
        S = self._shares @ v
        return float(self.weight @ np.log(S) + (self.power / S).sum())

    @cached_property
    def _shares(self) -> Array:
        """What each of the three variances, at 1, adds to the spectrum of each bin, (m, 3)."""
        return np.column_stack([np.ones_like(self.inverse), self.inverse, self.inverse**2])

    def search(self, start: Array, fixed: int | None = None) -> tuple[float, Array]:
        """Smallest cost from a start, flicker or walk held, and where.

        By scoring: the cost's expected curvature is that of a weighted least-squares problem, whose
            variances are not negative.
        """
        from scipy.optimize import nnls

        v, free = np.array(start), [k for k in range(3) if k != fixed]
        held = 0.0 if fixed is None else self._shares[:, fixed] * v[fixed]
        cost = self.cost(v)
        for _ in range(SCORINGS):
            root = np.sqrt(self.weight) / (self._shares @ v)
            columns = self._shares[:, free] * root[:, None]
            size = np.sqrt((columns**2).sum(axis=0))
            step = np.zeros(3)
            step[free] = (
                nnls(columns / size, (self.power / self.weight - held) * root)[0] / size - v[free]
            )
            step[0] = max(step[0], LEAST_WHITE - v[0])
            before, share = cost, 1.0
            while (cost := self.cost(v + share * step)) > before and share > CLOSE:
                share /= 2
            if cost > before:
                return before, v
            v = v + share * step
            if before - cost < CLOSE:
                break
        return cost, v

    def at(self, v: Array) -> NoiseModel:
        """The model of some variances."""
        return NoiseModel(*(float(x) for x in np.sqrt(v * self.scale)))

    def bounds(self, drop: float = 3.84) -> tuple[NoiseModel, NoiseModel]:
        """Models with as much flicker, and as much random walk, as the record allows: the cost
        rises by ``drop``.
        """
        model = self.model
        if not len(self.weight):
            return model, model
        best = np.maximum(
            np.array([model.white, model.flicker, model.walk]) ** 2 / self.scale,
            np.finfo(float).eps ** 1.5,
        )
        return self._bound(best, 1, drop), self._bound(best, 2, drop)

    def _bound(self, best: Array, which: int, drop: float) -> NoiseModel:
        from scipy.optimize import brentq

        floor = self.cost(best)
        low = 1 / float(self.inverse.max())
        inside = max(float(np.log(best[which])), (2 * which - 2) * np.log(low) - 14.0)
        found = best

        def above(size: float) -> float:
            nonlocal found
            start = found.copy()
            start[which] = np.exp(size)
            cost, v = self.search(start, which)
            if cost - floor <= drop:
                found = v
            return cost - floor - drop

        if above(inside) < 0 < above(6.0):
            brentq(above, inside, 6.0, xtol=0.01)
        return self.at(found)
