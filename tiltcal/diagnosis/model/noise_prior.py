"""The noise of an instrument, with what is known of instruments: they come in grades, and the axes
of one are alike.

White noise may be of any size. Flicker and random walk above those of the worst grade are the less
probable, the larger they are: their logarithm is normal there. The logarithm of the slow noise of
an axis is normal about that of its instrument. Whether slow noise goes with the white noise or has
sizes of its own differs between instruments: each is as probable as the other.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import exp, log, log1p, sqrt

import numpy as np

from tiltcal.diagnosis.data.observations import Channel, Observations
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.effects.sensor.noise import largest_slow_noise, worst_grade
from tiltcal.statistics.noise_spectrum import NoiseFit, NoiseModel, sines

SPREAD = 2.0
"""Factor of one standard deviation by which slow noise is above that of the worst grade."""
ALIKE = 1.7
"""Factor of one standard deviation by which the slow noise of an axis is off that of its
instrument: so far apart are the published bias instabilities of the axes of 15 instruments.
"""
ROUNDS = 20  # at most, of one axis after the other
CLOSE = 0.05  # nats, that a further round may bring
NOTHING = 1e-300  # of a variance
FASTEST = np.array([2.0])  # s of the highest frequency: all that is left there is white noise


@dataclass(frozen=True)
class AxisPrior:
    """What is known of the noise of one channel before it is read.

    Args:
        rate_hz: of its samples; count: how many there are in the longest record of its instrument:
            slow noise grows with the time that it is looked at.
        worst: flicker and random walk of the worst grade beside white noise of 1 per root hertz,
            and by their sizes, SI; none of what runs in no time.
    """

    rate_hz: float
    count: int
    worst: tuple[tuple[float, float], tuple[float, float]] | None

    @classmethod
    def of(cls, channel: Channel, observations: Observations, longest: float) -> "AxisPrior":
        """That of a channel of these observations; longest: s, of the records of its instrument."""
        rate = channel.rate_hz
        if not rate:
            return cls(rate, len(channel.time), None)
        kind = observations.scenario.named(channel.sensor).kind
        return cls(rate, round(longest * rate), (worst_grade(kind), largest_slow_noise(kind)))

    def above(self, model: NoiseModel) -> list[list[float]]:
        """Flicker and random walk over those of the worst grade, beside the same white noise and by
        their size, (2, 2); 0 where there is no grade.
        """
        if self.worst is None:
            return [[0.0, 0.0], [0.0, 0.0]]
        white = sqrt(float(model.density(FASTEST)[0]) / self.rate_hz)
        slow = model.slow_noise(self.rate_hz).tolist()
        beside, size = self.worst
        return [
            [x / (white * worst) for x, worst in zip(slow, beside, strict=True)],
            [x / worst for x, worst in zip(slow, size, strict=True)],
        ]

    def level(self, model: NoiseModel) -> float:
        """Logarithm of the rms of the slow noise over all samples, SI: at least what white noise
        leaves of their level.
        """
        flicker, walk = model.slow_noise(1.0).tolist()
        of_flicker, of_walk = _variances(self.count)
        variance = flicker**2 * of_flicker + walk**2 * of_walk + model.white**2 / self.count
        return 0.5 * _log(variance)


@dataclass(frozen=True)
class InstrumentPrior:
    """What is known of the noise of the axes of one sensor, of each recording those of its own.

    Args:
        which: numbers of the channels; axes: of each.
    """

    which: tuple[int, ...]
    axes: tuple[AxisPrior, ...]

    def price(self, models: Sequence[NoiseModel]) -> float:
        """-log prior of the noise of these axes, nats."""
        return self._price_of_one(0, models)(models[0])

    def cost(self, fits: Sequence[NoiseFit]) -> float:
        """-log posterior of fits of these axes, up to a constant, nats."""
        return sum(f.deviance for f in fits) / 2 + self.price([f.model for f in fits])

    def only(self, places: Sequence[int]) -> "InstrumentPrior":
        """That of the axes at these places."""
        return InstrumentPrior(
            tuple(self.which[k] for k in places), tuple(self.axes[k] for k in places)
        )

    def most_probable(self, fits: Sequence[NoiseFit]) -> list[NoiseFit]:
        """The fits of these axes at their most probable models, one axis after the other until that
        changes nothing.
        """
        found, cost = list(fits), np.inf
        for _ in range(ROUNDS if len(found) > 1 else 1):
            for k in range(len(found)):
                price = self._price_of_one(k, [f.model for f in found])
                found[k] = _most_probable(found[k], price)
            before, cost = cost, self.cost(found)
            if before - cost < CLOSE:
                break
        return found

    def _price_of_one(self, k: int, models: Sequence[NoiseModel]) -> Callable[[NoiseModel], float]:
        """-log prior of the noise of all axes by that of the k-th, nats: of an instrument whose
        slow noise goes with its white noise, and of one whose does not, mixed by halves.
        """
        own = self.axes[k]
        pairs = list(zip(self.axes, models, strict=True))
        levels = [axis.level(m) for axis, m in pairs]
        white = [_log(m.white) for m in models]
        others = [axis.above(m) for i, (axis, m) in enumerate(pairs) if i != k]
        beside, size = (sum(above_price(above[j]) for above in others) for j in (0, 1))

        def price(model: NoiseModel) -> float:
            levels[k], white[k] = own.level(model), _log(model.white)
            own_beside, own_size = (above_price(above) for above in own.above(model))
            return _halves(
                beside + own_beside + _spread([x - w for x, w in zip(levels, white, strict=True)]),
                size + own_size + _spread(levels),
            )

        return price


def instruments(whitened: WhitenedModel) -> list[InstrumentPrior]:
    """The instruments of the recordings; a channel that is no reading of its own, whose noise was
    not fitted, or to which a nameless curve adds, is one by itself.
    """
    observations, fits = whitened.observations, whitened.fits
    groups: dict[tuple[object, ...], list[int]] = {}
    for i, (channel, fit) in enumerate(zip(observations.channels, fits, strict=bool(fits))):
        told = channel.rate_hz and len(fit.bins.weight) and not channel.derived
        alone = not told or i in whitened.curved
        key = (channel.sensor, i) if alone else (channel.sensor,)
        groups.setdefault(key, []).append(i)
    return [_instrument(which, observations) for which in groups.values()]


def _instrument(which: Sequence[int], observations: Observations) -> InstrumentPrior:
    """One instrument, of these channels."""
    channels = [observations.channels[i] for i in which]
    longest = max(len(c.time) / c.rate_hz if c.rate_hz else 0.0 for c in channels)
    axes = tuple(AxisPrior.of(c, observations, longest) for c in channels)
    return InstrumentPrior(tuple(which), axes)


def noise_price(whitened: WhitenedModel) -> float:
    """-log prior of the noise of all channels, nats; nothing where it was not estimated."""
    fits = whitened.fits
    return sum(one.price([fits[i].model for i in one.which]) for one in instruments(whitened))


def with_probable_noise(whitened: WhitenedModel) -> WhitenedModel:
    """The same columns under the noise of the largest posterior probability; its fits hold the
    likelihood.
    """
    fits = list(whitened.fits)
    for one in instruments(whitened):
        found = one.most_probable([fits[i] for i in one.which])
        for i, fit in zip(one.which, found, strict=True):
            fits[i] = fit
    same = all(new is old for new, old in zip(fits, whitened.fits, strict=True))
    return whitened if same else whitened.as_fitted(fits)


def unlike_others(
    one: InstrumentPrior, places: Sequence[int], fits: Sequence[NoiseFit]
) -> tuple[float, float]:
    """By how much the noise is more probable if some axes of an instrument need not be like the
    others, nats, and how many times their slow noise they have; (0, 1) where there are no others.

    Args:
        one: the instrument; places: of these axes in it.
        fits: of all its axes, the most probable ones.
    """
    others = [k for k in range(len(fits)) if k not in places]
    if not others:
        return 0.0, 1.0
    apart, levels = 0.0, list[float]()
    for part in (places, others):
        own, mine = one.only(part), [fits[k] for k in part]
        apart += own.cost(own.most_probable(mine))
        each = [axis.level(f.model) for axis, f in zip(own.axes, mine, strict=True)]
        levels.append(sum(each) / len(each))
    return max(one.cost(fits) - apart, 0.0), exp(levels[0] - levels[1])


def above_price(above: Sequence[float]) -> float:
    """-log prior of flicker and random walk so many times those of the worst grade, nats."""
    return 0.5 * sum((log(max(x, 1.0)) / log(SPREAD)) ** 2 for x in above)


def _log(size: float) -> float:
    return log(max(size, NOTHING))


def _spread(x: Sequence[float]) -> float:
    """-log prior of how far the slow noise of the axes of an instrument is apart, nats. x: the
    logarithms of their rms, or of that beside the white noise.
    """
    mean = sum(x) / len(x)
    return 0.5 * sum((each - mean) ** 2 for each in x) / log(ALIKE) ** 2


def _halves(one: float, other: float) -> float:
    """-log of the mean of two probabilities, given those of each."""
    return min(one, other) + log(2) - log1p(exp(-abs(one - other)))


@lru_cache(maxsize=256)
def _variances(n: int) -> tuple[float, float]:
    """Variance over n samples of flicker and of a random walk of size 1."""
    s = sines(n)[1:]
    return float((1 / s).sum() / n), float((1 / s**2).sum() / n)


def _most_probable(fit: NoiseFit, price: Callable[[NoiseModel], float]) -> NoiseFit:
    """A fit at its most probable model; itself where its prior says nothing."""
    if not len(fit.bins.weight) or not price(fit.model) > 0:
        return fit
    return NoiseFit(fit.model.most_probable(fit.bins, price), fit.bins)
