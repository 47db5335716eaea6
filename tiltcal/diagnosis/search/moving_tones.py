"""Tones whose frequency moves with time, temperature, the input of a reading or the speed of turn:
the idle tone of a converter, the beat of two oscillators.

In the spectra of short stretches such a tone is a ridge: f = f0 + s u, u being what it follows. In
noise the powers along a ridge, each by the usual one of its frequency and of its stretch, are
exponential; where a tone is, they are so much larger (stack-slide search: Brady and Creighton,
Phys. Rev. D 61, 082001, 2000). What is steady in frequency or short in time is no ridge.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from tiltcal.core.arrays import Array, Index
from tiltcal.diagnosis.data.observations import Channel, Observations
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.limited_residual import EXCESS, equalised
from tiltcal.diagnosis.search.priors import SOMETHING, UNLISTED
from tiltcal.effects.base import Effect
from tiltcal.effects.curve_coordinates import coordinate_of

LENGTHS = (64, 128, 256, 512)  # samples of a stretch
FEWEST = 20  # stretches of which a median says what is usual
SLOWEST = 2  # frequencies of a stretch's spectrum that a tone passes at least
LARGEST = 20.0  # times the noise: one stretch alone is no ridge
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
        times: its power by that of the noise about it.
        probability: that something is there.
    """

    sensor: str
    axis: str
    follows: str
    low: float
    high: float
    times: float
    probability: float


@dataclass(frozen=True)
class Ridge:
    """A ridge in the spectra of stretches.

    Args:
        low, high: least and largest frequency, as shares of the sampling rate.
        times: mean power by that of the noise.
        factor: logarithm of the Bayes factor of a tone, any ridge being as probable as another.
    """

    low: float
    high: float
    times: float
    factor: float


def moving_tones(
    whitened: WhitenedModel,
    residual: Sequence[Array],
    effects: Sequence[Effect],
    claim: float,
    floors: Mapping[str, float],
) -> tuple[MovingTone, ...]:
    """Of each channel the tone that says most, where it is there with at least this probability;
    none by hand.

    Args:
        whitened: the noise that a model leaves.
        residual: of it, cosine coefficients in units of the noise, (n,) each.
        effects: of the model.
        claim: probability from which one is told.
        floors: sensors with coarse codes, which oscillate with the input: none of them is told.
    """
    observations = whitened.observations
    if not observations.courses:
        return ()
    prior = float(np.log(SOMETHING * UNLISTED / len(observations.channels)))
    found = []
    for channel, left in zip(observations.channels, residual, strict=True):
        if channel.derived or channel.sensor in floors:
            continue
        signal = equalised(left)
        followed = _followed(observations, channel, effects)
        ridges = {
            (name, length): ridge
            for name, u in followed.items()
            for length in LENGTHS
            if (ridge := likeliest_ridge(signal, u, length)) is not None
        }
        if not ridges:
            continue
        (name, _), ridge = max(ridges.items(), key=lambda each: each[1].factor)
        odds = prior + ridge.factor - float(np.log(len(ridges)))
        if (chance := float(1 / (1 + np.exp(-odds)))) >= claim:
            rate = 1 / float(np.median(np.diff(channel.time)))
            low, high = ridge.low * rate, ridge.high * rate
            found.append(
                MovingTone(channel.sensor, channel.axis, name, low, high, ridge.times, chance)
            )
    return tuple(found)


def _followed(
    observations: Observations, channel: Channel, effects: Sequence[Effect]
) -> dict[str, Array]:
    """What the frequency of a tone in a channel may follow, (n,) each."""
    sense = observations.watches(effects)[channel.recording].sense[channel.sensor]
    rows = np.minimum(channel.rows // observations.block, len(sense.time) - 1)
    own = sense.true_input()[:, channel.column]
    every = {
        OF_TIME: channel.time,
        OF_TEMPERATURE: sense.temperature[rows],
        OF_INPUT: own[rows],
        OF_SIZE: np.abs(own[rows]),
        OF_SPEED: coordinate_of("speed", sense, own)[rows],
    }
    return {name: u for name, u in every.items() if np.ptp(u) > 0}


def likeliest_ridge(signal: Array, u: Array, length: int) -> Ridge | None:
    """The ridge that says most in the spectra of stretches; None where they are too few, or where
    what it follows stays as it is.

    Args:
        signal: (n,); u: what the frequency follows, (n,).
        length: samples of a stretch.
    """
    starts = np.arange(0, len(signal) - length + 1, length // 2)
    if len(starts) < FEWEST:
        return None
    power = _powers(signal, starts, length)
    count = power.shape[1]
    sums = np.concatenate([[0.0], np.cumsum(u)])
    mean = sums[starts + length] - sums[starts]
    if not np.ptp(mean) > 0:
        return None
    share = (mean - mean.min()) / np.ptp(mean)
    best, path = 0.0, np.zeros(len(starts), np.intp)
    for at in _paths(share, count):
        along = power[np.arange(len(starts))[:, None], at].sum(axis=0)
        k = int(np.argmax(along))
        if along[k] > best:
            best, path = float(along[k]), at[:, k]
    tried = 2 * (count - SLOWEST + 1) * count
    factor = float(log_ridge(np.array([best]), len(starts))[0]) - float(np.log(tried))
    low, high = (float(k + 1) / length for k in (path.min(), path.max()))
    return Ridge(low, high, best / len(starts), factor)


def _powers(signal: Array, starts: Index, length: int) -> Array:
    """Powers of stretches by the usual ones of their frequency and of their stretch, LARGEST at
    most, without those of nothing and of half the sampling rate, (stretches, frequencies).
    """
    window = np.hanning(length + 1)[:length]
    rows = starts[:, None] + np.arange(length)
    power = np.abs(np.fft.rfft(signal[rows] * window, axis=1)[:, 1:-1]) ** 2
    power /= np.median(power, axis=0)
    # the median of an exponential distribution is that share of its mean
    power *= np.log(2) / np.median(power, axis=1)[:, None]
    return np.minimum(power, LARGEST)


def _paths(share: Array, count: int) -> Iterator[Index]:
    """Where every ridge of a slope passes, from every frequency on, folded at both ends of the
    band, (stretches, count); slope after slope. share: of the range of what it follows,
    (stretches,).
    """
    first = np.arange(count)
    for slope in (*range(-count, 1 - SLOWEST), *range(SLOWEST, count + 1)):
        at = (first + np.rint(slope * share).astype(np.intp)[:, None]) % (2 * count)
        yield np.where(at < count, at, 2 * count - 1 - at)


def log_ridge(total: Array, count: int) -> Array:
    """Logarithm of the Bayes factor of sums of powers with a tone in them, (n,): of exponential
    ones, 1 + EXCESS times as large.

    Args:
        total: sums, (n,); count: of how many powers.
    """
    more = EXCESS[:, None]
    each = total * more / (1 + more) - count * np.log1p(more)
    return np.asarray(logsumexp(each, axis=0) - np.log(len(EXCESS)))
