"""Tones whose frequency moves with time, temperature, the input of a reading or the speed of turn:
the idle tone of a converter, the beat of two oscillators.

In the spectra of short stretches such a tone is a ridge: f = f0 + s u, u being what it follows
(stack-slide search: Brady and Creighton, Phys. Rev. D 61, 082001, 2000). A power is taken by its
rank among those of the same frequency, of stretches at rest or of those with motion, as the
exponential score of that rank (Savage, Ann. Math. Stat. 27, 1956): their sum along a ridge is
gamma distributed in noise of any colour, at rest and in motion, and steady lines hold no ridge.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.diagnosis.data.observations import Observations
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.residual_checks.oscillations import (
    equalised,
    log_excess_of_sums,
    probability,
    searched,
)
from tiltcal.effects.base import Effect
from tiltcal.effects.curve_coordinates import coordinate_of

LENGTHS = (64, 128, 256, 512)  # samples of a stretch
FEWEST = 20  # stretches at rest, or with motion in them, that are compared with each other
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
    floors: Mapping[str, float],
) -> tuple[MovingTone, ...]:
    """Of each channel the tone that says most, where it is there with at least this probability.

    Args:
        whitened: the noise that a model leaves.
        residual: of it, cosine coefficients in units of the noise, (n,) each.
        effects: of the model.
        least: probability from which one is told.
        floors: see ``searched``.
    """
    found = []
    for k, channel in searched(whitened, floors):
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
    alike = [rows for rows in (every[~moves], every[moves]) if len(rows) >= FEWEST]
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
