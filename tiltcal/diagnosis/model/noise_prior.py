"""The noise of an instrument, with what is known of instruments: they come in grades.

White noise may be of any size. Flicker and random walk above those of the worst grade are the less
probable, the larger they are: their logarithm is normal there. Whether slow noise goes with the
white noise or has sizes of its own differs between instruments: each is as probable as the other.
"""

from collections.abc import Callable

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Channel, Observations
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.effects.sensor.noise import largest_slow_noise, worst_grade
from tiltcal.statistics.noise_spectrum import NoiseFit, NoiseModel

SPREAD = 2.0
"""Factor of one standard deviation by which slow noise is above that of the worst grade."""


def noise_price(whitened: WhitenedModel) -> float:
    """-log prior of the noise of all channels, nats; nothing where it was not estimated."""
    observations = whitened.observations
    pairs = zip(observations.channels, whitened.fits, strict=bool(whitened.fits))
    return sum(slow_noise_price(c, observations, f.model) for c, f in pairs)


def with_probable_noise(whitened: WhitenedModel) -> WhitenedModel:
    """The same columns under the noise of the largest posterior probability, each channel for
    itself; its fits hold the likelihood.
    """
    observations = whitened.observations
    fits = [
        _most_probable(fit, _prior(channel, observations))
        for channel, fit in zip(observations.channels, whitened.fits, strict=True)
    ]
    same = all(new is old for new, old in zip(fits, whitened.fits, strict=True))
    return whitened if same else whitened.as_fitted(fits)


def slow_noise_price(channel: Channel, observations: Observations, model: NoiseModel) -> float:
    """-log prior of a channel's slow noise, nats: that of an instrument whose slow noise goes with
    its white noise, and that of one whose does not, mixed by halves.
    """
    prices = [price_of(above) for above in above_grades(channel, observations, model)]
    return float(np.log(2) - np.logaddexp(-prices[0], -prices[1]))


def above_grades(channel: Channel, observations: Observations, model: NoiseModel) -> Array:
    """Flicker and random walk over those of the worst grade, beside the same white noise and by
    their size, (2, 2); 0 where there is no grade.
    """
    rate = channel.rate_hz
    if not rate:
        return np.zeros((2, 2))
    kind = observations.scenario.named(channel.sensor).kind
    white = float(np.sqrt(model.density(np.array([2.0]))[0] / rate))
    worst = np.array([np.array(worst_grade(kind)) * white, largest_slow_noise(kind)])
    return model.slow_noise(rate) / worst


def price_of(above: Array) -> float:
    """-log prior of flicker and random walk so many times those of the worst grade, nats. above:
    (2,).
    """
    return 0.5 * float(((np.log(np.maximum(above, 1.0)) / np.log(SPREAD)) ** 2).sum())


def _prior(channel: Channel, observations: Observations) -> Callable[[NoiseModel], float]:
    return lambda model: slow_noise_price(channel, observations, model)


def _most_probable(fit: NoiseFit, price: Callable[[NoiseModel], float]) -> NoiseFit:
    """A fit at its most probable model; itself where its prior says nothing."""
    if not len(fit.bins.weight) or not price(fit.model) > 0:
        return fit
    return NoiseFit(fit.model.most_probable(fit.bins, price), fit.bins)
