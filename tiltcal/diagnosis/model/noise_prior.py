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
        rate_hz: of its samples; count: how many there are.
        worst: flicker and random walk of the worst grade beside white noise of 1 per root hertz,
            and by their sizes, SI; none of what runs in no time.
    """

    rate_hz: float
    count: int
    worst: tuple[tuple[float, float], tuple[float, float]] | None

    @classmethod
    def of(cls, channel: Channel, observations: Observations) -> "AxisPrior":
        """That of a channel of these observations."""
        rate, count = channel.rate_hz, len(channel.time)
        if not rate:
            return cls(rate, count, None)
        kind = observations.scenario.named(channel.sensor).kind
        return cls(rate, count, (worst_grade(kind), largest_slow_noise(kind)))

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
    """What is known of the noise of the axes of one sensor in one recording.

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

    def without(self, k: int) -> "InstrumentPrior":
        """That of the other axes."""
        return InstrumentPrior(
            self.which[:k] + self.which[k + 1 :], self.axes[:k] + self.axes[k + 1 :]
        )

    def only(self, k: int) -> "InstrumentPrior":
        """That of the k-th axis."""
        return InstrumentPrior((self.which[k],), (self.axes[k],))

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
    """The instruments of a recording; a channel that is no reading of its own, whose noise was not
    fitted, or to which a nameless curve adds, is one by itself.
    """
    observations, fits = whitened.observations, whitened.fits
    groups: dict[tuple[int, str, str], list[int]] = {}
    for i, (channel, fit) in enumerate(zip(observations.channels, fits, strict=bool(fits))):
        told = channel.rate_hz and len(fit.bins.weight) and not channel.derived
        alone = not told or i in whitened.curved
        key = (channel.recording, channel.sensor, channel.axis if alone else "")
        groups.setdefault(key, []).append(i)
    return [
        InstrumentPrior(
            tuple(which), tuple(AxisPrior.of(observations.channels[i], observations) for i in which)
        )
        for which in groups.values()
    ]


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


def unlike_others(one: InstrumentPrior, k: int, fits: Sequence[NoiseFit]) -> tuple[float, float]:
    """By how much the noise is more probable if the k-th axis of an instrument need not be like the
    others, nats, and how many times their slow noise it has; (0, 1) where there are no others.

    Args:
        one: the instrument; k: which axis.
        fits: of these axes, the most probable ones.
    """
    if len(fits) < 2:
        return 0.0, 1.0
    rest = one.without(k)
    others = [f for i, f in enumerate(fits) if i != k]
    apart = rest.cost(rest.most_probable(others))
    apart += one.only(k).cost(one.only(k).most_probable([fits[k]]))
    own = one.axes[k].level(fits[k].model)
    levels = [axis.level(f.model) for axis, f in zip(rest.axes, others, strict=True)]
    return max(one.cost(fits) - apart, 0.0), exp(own - sum(levels) / len(levels))


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
