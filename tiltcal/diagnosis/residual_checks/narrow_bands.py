"""Bands of frequency that hold more power than the noise on either side: an oscillation that keeps
no phase, such as a servo that hunts now and then.

The power of a band beside that of its stronger neighbour is F distributed in white noise of any
level, or less; where something is in it, it is so much larger (excess power: Anderson et al., Phys.
Rev. D 63, 042003, 2001). The residual is taken behind a limiter and in units of the noise about
each row, so that gross values and bursts of noise, which correlate neighbouring powers, hold no
band.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.residual_checks.oscillations import EXCESS, equalised, probability, searched
from tiltcal.statistics.cosine_transform import cosines

NARROWEST = 16  # cosine coefficients: fewer are a tone
WIDEST = 1 / 16  # of all
WHITE = 1.1  # the noise by its least variance, where it counts as white


@dataclass(frozen=True)
class NarrowBand:
    """A band of frequencies with more power than the noise beside it.

    Args:
        sensor, axis: whose.
        low, high: Hz.
        times: its power by that of the noise.
        probability: that something is there.
    """

    sensor: str
    axis: str
    low: float
    high: float
    times: float
    probability: float


def narrow_bands(
    whitened: WhitenedModel,
    residual: Sequence[Array],
    least: float,
    floors: Mapping[str, float],
) -> tuple[NarrowBand, ...]:
    """Of each channel the band that says most, where it is there with at least this probability.

    Args:
        whitened: the noise that a model leaves.
        residual: of it, cosine coefficients in units of the noise, (n,) each.
        least: probability from which one is told.
        floors: see ``searched``.
    """
    found = []
    for k, channel in searched(whitened, floors):
        first, width, times, factor = _likeliest(residual[k], whitened.roots[k])
        if (chance := probability(factor, whitened)) >= least:
            step = 1 / (2 * len(residual[k]) * float(np.median(np.diff(channel.time))))
            low, high = first * step, (first + width) * step
            found.append(NarrowBand(channel.sensor, channel.axis, low, high, times, chance))
    return tuple(found)


def _likeliest(residual: Array, root: Array) -> tuple[int, int, float, float]:
    """First coefficient and number of those of the band that says most, its power by that beside
    it, and the logarithm of the Bayes factor of something in it, any band being as probable as
    another.

    Args:
        residual: cosine coefficients in units of the noise, (n,).
        root: the noise, (n,).
    """
    power, n = cosines(equalised(residual)) ** 2, len(residual)
    up_to = np.concatenate([[0.0], np.cumsum(power)])
    white = int(np.argmax(root < np.sqrt(WHITE) * root.min()))
    best, bands = (0, 0, 0.0, -np.inf), 0
    width = NARROWEST
    while width <= WIDEST * n:
        first = np.arange(white + width, n - 2 * width, width // 2)
        bands += len(first)
        inside = up_to[first + width] - up_to[first]
        below = up_to[first] - up_to[first - width]
        above = up_to[first + 2 * width] - up_to[first + width]
        times = inside / np.maximum(np.maximum(below, above), np.finfo(float).tiny)
        factors = log_excess(times, width)
        if len(first) and factors.max() > best[3]:
            k = int(np.argmax(factors))
            best = int(first[k]), width, float(times[k]), float(factors[k])
        width *= 2
    return *best[:3], best[3] - float(np.log(max(bands, 1)))


def log_excess(times: Array, width: int) -> Array:
    """Logarithm of the Bayes factor of bands in which something is, (n,).

    Args:
        times: power of each by that of its stronger neighbour, (n,).
        width: coefficients of a band, and of each neighbour.
    """
    whole = 1 + EXCESS[:, None]
    fall = np.log1p(times) - np.log1p(times / whole)
    return np.asarray(
        logsumexp(width / 2 * (2 * fall - np.log(whole)), axis=0) - np.log(len(whole))
    )
