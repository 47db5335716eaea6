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
from math import exp, log, log1p, sqrt, tanh

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Channel, Observations
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.effects.sensor.noise import largest_slow_noise, worst_grade
from tiltcal.statistics.noise_spectrum import Expansion, NoiseFit, NoiseModel, sines

SPREAD = 2.0
"""Factor of one standard deviation by which slow noise is above that of the worst grade."""
ALIKE = 1.7
"""Factor of one standard deviation by which the slow noise of an axis is off that of its
instrument: so far apart are the published bias instabilities of the axes of 15 instruments.
"""
ROUNDS = 20  # at most, of one axis after the other
CLOSE = 0.05  # nats, that a further round may bring
NOTHING = 1e-300  # of a variance
FASTEST = 2.0  # s of the highest frequency: all that is left there is white noise
OWN = np.array([[0.0, 0.5, 0.0], [0.0, 0.0, 0.5]])  # log of flicker and walk by log of variances
WHITE = np.array([0.5, 0.0, 0.0])  # the same of white noise


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
        white = sqrt(sum(_of_fastest(model)) / self.rate_hz)
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
        return 0.5 * _log(sum(self._of_level(model)))

    def slopes(self, model: NoiseModel) -> tuple[Array, Array]:
        """How the level, and the logarithms of what is above the worst grade, change with the
        logarithms of the variances of white noise, flicker and random walk: (3,) and (2, 2, 3).
        """
        level, fastest = (_shares(x) for x in (self._of_level(model), _of_fastest(model)))
        beside = OWN - fastest / 2
        return level / 2, np.array([beside, OWN])

    def _of_level(self, model: NoiseModel) -> list[float]:
        """What white noise, flicker and random walk add to the mean square of slow noise."""
        flicker, walk = model.slow_noise(1.0).tolist()
        of_flicker, of_walk = _variances(self.count)
        return [model.white**2 / self.count, flicker**2 * of_flicker, walk**2 * of_walk]


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
        return self.expanded(models)[0]

    def expanded(self, models: Sequence[NoiseModel]) -> Expansion:
        """The price along the logarithms of the variances of white noise, flicker and random walk
        of the first axis, the curvature without its negative part.
        """
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

    def _price_of_one(self, k: int, models: Sequence[NoiseModel]) -> Callable[..., Expansion]:
        """-log prior of the noise of all axes by that of the k-th: of an instrument whose slow
        noise goes with its white noise, and of one whose does not, mixed by halves.
        """
        own, others = self.axes[k], [i for i in range(len(models)) if i != k]
        levels = np.array([self.axes[i].level(models[i]) for i in others])
        apart = np.array([levels - [_log(models[i].white) for i in others], levels])
        above = [self.axes[i].above(models[i]) for i in others]
        costs = [sum(above_price(a[j]) for a in above) + _spread(apart[j]) for j in (0, 1)]
        means = apart.mean(axis=1) if others else np.zeros(2)
        free = sqrt(1 - 1 / len(models)) / log(ALIKE)

        def price(model: NoiseModel) -> Expansion:
            over = np.log(np.maximum(own.above(model), 1.0)) / log(SPREAD)
            level, (by_level, by_above) = own.level(model), own.slopes(model)
            off = free * (np.array([level - _log(model.white), level]) - means)
            by_over = np.where(over > 0, 1.0, 0.0)[:, :, None] * by_above / log(SPREAD)
            by_off = free * np.array([by_level - WHITE, by_level])
            z = np.column_stack([over, off])
            return _halves(costs, z, np.concatenate([by_over, by_off[:, None]], axis=1))

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


def _spread(x: Array) -> float:
    """-log prior of how far the slow noise of the axes of an instrument is apart, nats. x: the
    logarithms of their rms, or of that beside the white noise.
    """
    return 0.5 * float(((x - x.mean()) ** 2).sum()) / log(ALIKE) ** 2 if len(x) else 0.0


def _halves(costs: Sequence[float], z: Array, slopes: Array) -> Expansion:
    """-log of the mean of two probabilities, each with a cost of its own and half a sum of squares;
    the curvature by the slopes of these alone, as in least squares.

    Args:
        costs: (2,); z: what is squared, (2, m); slopes: of it, (2, m, p).
    """
    one, other = np.array(costs) + 0.5 * (z * z).sum(axis=1)
    cost = min(one, other) + log(2) - log1p(exp(-abs(one - other)))
    first = 0.5 - 0.5 * tanh((one - other) / 2)
    shares = np.array([first, 1 - first])[:, None, None]
    weighed = (shares * slopes).reshape(-1, slopes.shape[2])
    return float(cost), z.ravel() @ weighed, slopes.reshape(weighed.shape).T @ weighed


def _of_fastest(model: NoiseModel) -> list[float]:
    """What white noise, flicker and random walk add to the density at the highest frequency."""
    flicker, walk = model.slow_noise(1.0).tolist()
    return [model.white**2, flicker**2 / FASTEST, (walk / FASTEST) ** 2]


def _shares(parts: Sequence[float]) -> Array:
    return np.array(parts) / max(sum(parts), NOTHING)


@lru_cache(maxsize=256)
def _variances(n: int) -> tuple[float, float]:
    """Variance over n samples of flicker and of a random walk of size 1."""
    s = sines(n)[1:]
    return float((1 / s).sum() / n), float((1 / s**2).sum() / n)


def _most_probable(fit: NoiseFit, price: Callable[..., Expansion]) -> NoiseFit:
    """A fit at its most probable model; itself where its prior says nothing."""
    if not len(fit.bins.weight) or not price(fit.model)[0] > 0:
        return fit
    return NoiseFit(fit.model.most_probable(fit.bins, price), fit.bins)
