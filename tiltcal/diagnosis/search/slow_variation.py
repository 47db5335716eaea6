"""Slow variation that is too large to be an instrument's noise, and that no cause explains.

It fits a random walk or flicker as well as any other slow course, so that only the prior decides:
instruments have grades.
"""

from dataclasses import dataclass

import numpy as np

from tiltcal.diagnosis.model.noise_prior import above_grades, price_of
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.bayes_factors import ENERGIES
from tiltcal.diagnosis.search.priors import SOMETHING, UNLISTED
from tiltcal.statistics.noise_spectrum import NoiseFit

SLOW = 0.1
"""Of the band: below it noise counts as slow."""


@dataclass(frozen=True)
class SlowVariation:
    """Slow variation of one axis of a sensor.

    Args:
        sensor, axis: whose; times: the slow noise of the worst grade, that it is as large as.
        probability: that it is no noise.
    """

    sensor: str
    axis: str
    times: float
    probability: float


def slow_variations(whitened: WhitenedModel, claim: float) -> tuple[SlowVariation, ...]:
    """The channels whose slow noise is no noise with at least this probability: beyond that of the
    worst grade by its size, not only beside the white noise.
    """
    observations = whitened.observations
    prior = SOMETHING * UNLISTED / len(observations.channels) / len(ENERGIES)
    found = []
    for channel, fit in zip(observations.channels, whitened.fits, strict=True):
        if channel.derived:
            continue
        above = above_grades(channel, observations, fit.model).min(axis=0) * _share(fit)
        chance = float(1 / (1 + np.exp(-(price_of(above) + np.log(prior)))))
        if chance >= claim:
            found.append(SlowVariation(channel.sensor, channel.axis, float(above.max()), chance))
    return tuple(found)


def _share(fit: NoiseFit) -> float:
    """How much of its fitted slow noise a record holds where it is slow, at most one: the end of a
    filter's band looks like flicker and says nothing of what is slow.
    """
    bins = fit.bins
    slow = bins.inverse > 1 / (2 * np.sin(np.pi / 2 * SLOW))
    if not slow.any():
        return 1.0
    expected = fit.model.density(1 / bins.inverse[slow])
    power = bins.scale * float((bins.power[slow] / expected).sum())
    return float(np.sqrt(min(power / float(bins.weight[slow].sum()), 1.0)))
