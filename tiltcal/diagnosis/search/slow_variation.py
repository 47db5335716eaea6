"""Slow variation that is too large to be an instrument's noise, and that no cause explains.

It fits a random walk or flicker as well as any other slow course, so that only the prior decides:
instruments have grades, and the axes of one are alike.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import expit

from tiltcal.diagnosis.model.noise_prior import NOTHING, above_price, instruments, unlike_others
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
        sensor, axis: whose.
        times: the slow noise of the worst grade, that it is as large as; or that of the other axes
            of the sensor, where that says more.
        beside_axes: whether it is that.
        probability: that it is no noise.
    """

    sensor: str
    axis: str
    times: float
    beside_axes: bool
    probability: float


def slow_variations(
    whitened: WhitenedModel, least: float, floors: Mapping[str, float]
) -> tuple[SlowVariation, ...]:
    """The channels whose slow noise is no noise with at least this probability: beyond that of the
    worst grade by its size, not only beside the white noise, or unlike that of the sensor's other
    axes.

    Args:
        whitened: the noise that a model leaves.
        least: probability from which one is told.
        floors: size, SI, of what coarse codes do to a sensor's misfit: none below it is told.
    """
    observations, fits = whitened.observations, whitened.fits
    prior = SOMETHING * UNLISTED / len(observations.channels)
    prior /= len(ENERGIES)  # that it has this size
    found = []
    for one in instruments(whitened):
        together = one.most_probable([fits[i] for i in one.which])  # a record at rest has others
        for k, (i, axis) in enumerate(zip(one.which, one.axes, strict=True)):
            channel = observations.channels[i]
            hidden = axis.level(fits[i].model) < np.log(floors.get(channel.sensor) or NOTHING)
            if channel.derived or hidden:
                continue
            above = np.min(axis.above(fits[i].model), axis=0) * _share(fits[i])
            large, (unlike, times) = above_price(above.tolist()), unlike_others(one, k, together)
            chance = float(expit(large + unlike + np.log(prior)))
            if chance >= least and times >= 1:  # of two axes apart, the one with more
                size = times if unlike > large else float(above.max())
                found.append(
                    SlowVariation(channel.sensor, channel.axis, size, unlike > large, chance)
                )
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
