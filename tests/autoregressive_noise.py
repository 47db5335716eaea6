"""A noise model from outside: autoregressive of second order, in one class.

x_t = a1 x_(t-1) + a2 x_(t-2) + e_t has the density sigma^2 / |1 - a1 z - a2 z^2|^2 at
z = exp(-i w), with cos w = 1 - s^2 / 2. The page docs/extend_noise_model.md works through it.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from tiltcal.core.arrays import Array
from tiltcal.statistics.noise_spectrum import NoiseModel, SpectrumBins

STARTS = ((0.0, 0.0), (1.0, 0.0), (1.5, -1.0))  # of the partial autocorrelations' artanh


@dataclass(frozen=True)
class AutoRegressive2(NoiseModel):
    """Autoregressive noise of second order.

    Args:
        white: standard deviation of the innovation, SI.
        a1, a2: coefficients; inside the triangle of stationarity.
    """

    white: float
    a1: float = 0.0
    a2: float = 0.0

    def density(self, s: Array) -> Array:
        z = np.exp(-2j * np.arcsin(np.minimum(s / 2, 1.0)))
        return np.asarray(self.white**2 / np.abs(1 - self.a1 * z - self.a2 * z**2) ** 2)

    def scaled(self, factor: float) -> "AutoRegressive2":
        return AutoRegressive2(factor * self.white, self.a1, self.a2)

    @classmethod
    def most_likely(cls, bins: SpectrumBins) -> "AutoRegressive2":
        found = [minimize(cls._cost, start, bins, method="Nelder-Mead") for start in STARTS]
        return cls._of(min(found, key=lambda f: f.fun).x, bins)

    def bounds(self, bins: SpectrumBins, drop: float) -> tuple[NoiseModel, NoiseModel]:
        """The whole noise as much larger as its number of samples allows, at this shape."""
        share = np.sqrt(1 + np.sqrt(2 * drop / bins.weight.sum()))
        return self.scaled(share), self.scaled(share)

    @classmethod
    def _of(cls, partial: Array, bins: SpectrumBins) -> "AutoRegressive2":
        """The model of some partial autocorrelations (artanh), its size the most likely one."""
        r1, r2 = np.tanh(partial)
        shape = cls(1.0, float(r1 * (1 - r2)), float(r2))
        power = bins.power * bins.scale / shape.density(1 / bins.inverse)
        return shape.scaled(float(np.sqrt(power.sum() / bins.weight.sum())))

    @classmethod
    def _cost(cls, partial: Array, bins: SpectrumBins) -> float:
        density = cls._of(partial, bins).density(1 / bins.inverse)
        return float(bins.weight @ np.log(density))
