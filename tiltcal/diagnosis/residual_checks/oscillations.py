"""What searches for oscillations without a name share: the residual in which they look, and the
prior.

Bands of frequency that hold more power than the noise on either side: an oscillation that keeps
no phase, such as a servo that hunts now and then.

The power of a band beside that of its stronger neighbour is F distributed in white noise of any
level, or less; where something is in it, it is so much larger (excess power: Anderson et al., Phys.
Rev. D 63, 042003, 2001). The residual is taken behind a limiter and in units of the noise about
each row, so that gross values and bursts of noise, which correlate neighbouring powers, hold no
band.

Tones whose frequency moves with time, temperature, the input of a reading or the speed of turn:
the idle tone of a converter, the beat of two oscillators.

In the spectra of short stretches such a tone is a ridge: f = f0 + s u, u being what it follows
(stack-slide search: Brady and Creighton, Phys. Rev. D 61, 082001, 2000). A power is taken by its
rank among those of the same frequency, of stretches at rest or of those with motion, as the
exponential score of that rank (Savage, Ann. Math. Stat. 27, 1956): their sum along a ridge is
gamma distributed in noise of any colour, at rest and in motion, and steady lines hold no ridge.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import expit, logsumexp

from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.diagnosis.data.observations import Channel, Observations
from tiltcal.diagnosis.hypotheses.priors import NAMELESS
from tiltcal.diagnosis.lines.spectral_lines import limited, noise_about
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.effects.base import Effect
from tiltcal.effects.curve_coordinates import coordinate_of
from tiltcal.statistics.cosine_transform import cosines

ROWS = 256  # that tell the noise about each
EXCESS = 10.0 ** np.arange(-2, 2.5, 0.5)
"""Power of an oscillation, in that of the noise: each as probable as another."""


def searched(whitened: WhitenedModel) -> Iterator[tuple[int, Channel]]:
    """The channels in which oscillations are looked for, with their numbers; none by hand, where a
    hand trembles at no steady frequency, and none with coarse codes: they oscillate with the input.
    """
    observations = whitened.observations
    for k, channel in enumerate(observations.channels if observations.courses else ()):
        if not channel.derived and channel.sensor not in whitened.floors:
            yield k, channel


def probability(factor: float, whitened: WhitenedModel) -> float:
    """That an oscillation is there. factor: logarithm of its Bayes factor in one channel."""
    prior = NAMELESS - float(np.log(len(whitened.observations.channels)))
    return float(expit(factor + prior))


def equalised(residual: Array) -> Array:
    """A residual in time, behind the limiter, in units of the noise about each row, (n,). residual:
    cosine coefficients in units of the noise, (n,).
    """
    left = limited(residual)
    return np.asarray(left / np.sqrt(noise_about(left, ROWS)))


def log_excess_of_sums(total: Array, count: int) -> Array:
    """Logarithm of the Bayes factor of sums of powers with something in them, (n,): powers that are
    1 + EXCESS times as large.

    Args:
        total: sums of powers in units of the usual one, exponential in noise, (n,).
        count: of how many powers.
    """
    more = EXCESS[:, None]
    each = total * more / (1 + more) - count * np.log1p(more)
    return np.asarray(logsumexp(each, axis=0) - np.log(len(EXCESS)))


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
) -> tuple[NarrowBand, ...]:
    """Of each channel the band that says most, where it is there with at least this probability.

    Args:
        whitened: the noise that a model leaves.
        residual: of it, cosine coefficients in units of the noise, (n,) each.
        least: probability from which one is told.
    """
    found = []
    for k, channel in searched(whitened):
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


LENGTHS = (64, 128, 256, 512)  # samples of a stretch
MIN_STRETCHES = 20  # stretches at rest, or with motion in them, that are compared with each other
SLOWEST = 2  # frequencies of a stretch's spectrum that a tone passes at least
OF_TIME, OF_TEMPERATURE, OF_INPUT, OF_SIZE, OF_SPEED = (
    "time",
    "temperature",
    "its own input",
    "the magnitude of its own input",
    "the speed of turn",
)


@dataclass(frozen=True)
class MovingTone:
    """A tone of a reading whose frequency follows something.

    Args:
        sensor, axis: whose.
        follows: what, in words.
        low, high: between which frequencies it moves, Hz.
        probability: that something is there.
    """

    sensor: str
    axis: str
    follows: str
    low: float
    high: float
    probability: float


@dataclass(frozen=True)
class Ridge:
    """A ridge in the spectra of stretches.

    Args:
        low, high: least and largest frequency, as shares of the sampling rate.
        factor: logarithm of the Bayes factor of a tone, any ridge being as probable as another.
    """

    low: float
    high: float
    factor: float


def moving_tones(
    whitened: WhitenedModel,
    residual: Sequence[Array],
    effects: Sequence[Effect],
    least: float,
) -> tuple[MovingTone, ...]:
    """Of each channel the tone that says most, where it is there with at least this probability.

    Args:
        whitened: the noise that a model leaves.
        residual: of it, cosine coefficients in units of the noise, (n,) each.
        effects: of the model.
        least: probability from which one is told.
    """
    found = []
    for k, channel in searched(whitened):
        signal, moving = equalised(residual[k]), channel.stop < 0
        followed = _followed(whitened.observations, k, effects)
        ridges = {
            (name, length): ridge
            for name, u in followed.items()
            for length in LENGTHS
            if (ridge := likeliest_ridge(signal, u, moving, length)) is not None
        }
        if not ridges:
            continue
        (name, _), ridge = max(ridges.items(), key=lambda each: each[1].factor)
        factor = ridge.factor - float(np.log(len(ridges)))
        if (chance := probability(factor, whitened)) >= least:
            rate = 1 / float(np.median(np.diff(channel.time)))
            low, high = ridge.low * rate, ridge.high * rate
            found.append(MovingTone(channel.sensor, channel.axis, name, low, high, chance))
    return tuple(found)


def _followed(
    observations: Observations, number: int, effects: Sequence[Effect]
) -> dict[str, Array]:
    """What the frequency of a tone in a channel may follow, (n,) each."""
    channel = observations.channels[number]
    sense = observations.watches(effects)[channel.recording].sense[channel.sensor]
    own = sense.true_input()[:, channel.column]
    followed = {
        OF_TEMPERATURE: sense.temperature,
        OF_INPUT: own,
        OF_SIZE: np.abs(own),
        OF_SPEED: coordinate_of("speed", sense, own),
    }
    every = {OF_TIME: channel.time} | {
        name: observations.at_samples(number, u) for name, u in followed.items()
    }
    return {name: u for name, u in every.items() if np.ptp(u) > 0}


def likeliest_ridge(signal: Array, u: Array, moving: Mask, length: int) -> Ridge | None:
    """The ridge that says most in the spectra of stretches; None where they are too few, or where
    what it follows stays as it is.

    Args:
        signal: (n,); u: what the frequency follows, (n,).
        moving: rows at which the table moves, (n,).
        length: samples of a stretch.
    """
    starts = np.arange(0, len(signal) - length + 1, length // 2)
    every = starts[:, None] + np.arange(length)
    moves = moving[every].any(axis=1)
    alike = [rows for rows in (every[~moves], every[moves]) if len(rows) >= MIN_STRETCHES]
    if not alike:
        return None
    scores = np.concatenate([_scores(signal[rows]) for rows in alike])
    mean = np.concatenate([u[rows].mean(axis=1) for rows in alike])
    count = scores.shape[1]
    if not np.ptp(mean) > 0:
        return None
    share = (mean - mean.min()) / np.ptp(mean)
    best, path = 0.0, np.zeros(len(scores), np.intp)
    for at in _paths(share, count):
        along = scores[np.arange(len(scores))[:, None], at].sum(axis=0)
        k = int(np.argmax(along))
        if along[k] > best:
            best, path = float(along[k]), at[:, k]
    tried = 2 * (count - SLOWEST + 1) * count
    factor = float(log_excess_of_sums(np.array([best]), len(scores))[0]) - float(np.log(tried))
    low, high = (float(k + 1) / length for k in (path.min(), path.max()))
    return Ridge(low, high, factor)


def _scores(stretches: Array) -> Array:
    """Powers of stretches, (k, length), by the usual one of each stretch, as the exponential scores
    of their ranks at each frequency, (k, frequencies); without those of nothing and of half the
    sampling rate.
    """
    length = stretches.shape[1]
    window = np.hanning(length + 1)[:length]
    power = np.abs(np.fft.rfft(stretches * window, axis=1)[:, 1:-1]) ** 2
    power /= np.median(power, axis=1)[:, None]
    rank = np.argsort(np.argsort(power, axis=0), axis=0)
    return np.asarray(-np.log1p(-(rank + 0.5) / len(power)))


def _paths(share: Array, count: int) -> Iterator[Index]:
    """Where every ridge of a slope passes, from every frequency on, folded at both ends of the
    band, (stretches, count); slope after slope. share: of the range of what it follows,
    (stretches,).
    """
    first = np.arange(count)
    for slope in (*range(-count, 1 - SLOWEST), *range(SLOWEST, count + 1)):
        at = (first + np.rint(slope * share).astype(np.intp)[:, None]) % (2 * count)
        yield np.where(at < count, at, 2 * count - 1 - at)
