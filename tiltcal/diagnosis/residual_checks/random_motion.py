"""Random motion of the base, the mount or a table axis: people walk by, a pier sways, a clamp is
loose. To each channel by itself that is noise. But what one channel reads predicts what another
does, as the attitude has it, and no noise of their electronics does.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np
from scipy.special import expit, logsumexp

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Channel, Columns, Observations
from tiltcal.diagnosis.hypotheses.curves import tilt_law
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.hypotheses.priors import NAMELESS, UNLISTED, UNLISTED_SHARE, log_priors
from tiltcal.diagnosis.lines.limited_residual import limited
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.residual_checks.cross_prediction import CrossPrediction, Place
from tiltcal.diagnosis.residual_checks.oscillations import searched
from tiltcal.effects.base import Effect
from tiltcal.effects.learned import LearnedReadout, LearnedTilt

ALWAYS = (0.0, 1.0)  # knots of a constant
ONE = {"c0": 1.0, "c1": 1.0}
IN_USE = 0.25  # probability that a motion is in an octave: in two or three of ten


@dataclass(frozen=True)
class RandomMotion:
    """Something that moves at random.

    Args:
        sensors, axes: whose readings it changes.
        place: what moves, in words; stage: of the chain.
        low, high: Hz, between which it moves.
        probability: that something is there; names: of each name, given that something is.
    """

    sensors: tuple[str, ...]
    axes: tuple[str, ...]
    place: str
    stage: str
    low: float
    high: float
    probability: float
    names: Mapping[str, float]


@dataclass(frozen=True)
class Octave:
    """What a place does between two frequencies.

    Args:
        low, high: Hz; factor: logarithm of the Bayes factor of a motion.
    """

    low: float
    high: float
    factor: float

    @property
    def probability(self) -> float:
        """That the place moves in it, given that it moves."""
        return float(expit(self.factor + np.log(IN_USE / (1 - IN_USE))))


def random_motions(
    whitened: WhitenedModel,
    residual: Sequence[Array],
    effects: Sequence[Effect],
    least: float,
    floors: Mapping[str, float],
) -> tuple[RandomMotion, ...]:
    """What moves at random, where that is so with at least this probability: the place that says
    most. Every place is as probable as another.

    Args:
        whitened: the noise that a model leaves.
        residual: of it, cosine coefficients in units of the noise, (n,) each.
        effects: of the model.
        least: probability from which it is told.
        floors: see ``oscillations.searched``.
    """
    observations = whitened.observations
    channels = {k: c for k, c in searched(whitened, floors) if c.rate_hz}
    recordings = []
    for number in range(len(observations.recordings)):
        own = {
            k: (channel, limited(residual[k]), whitened.roots[k])
            for k, channel in channels.items()
            if channel.recording == number
        }
        recordings += [CrossPrediction(own)] if len(own) > 1 else []
    if not recordings:
        return ()
    every = [(place, _octaves(place, recordings)) for place in _places(observations, effects)]
    factors = np.array([_factor(octaves) for _, octaves in every])
    odds = float(logsumexp(factors) - np.log(len(every))) + NAMELESS
    if (chance := float(expit(odds))) < least:
        return ()
    place, octaves = every[int(np.argmax(factors))]
    told = [c for k, c in channels.items() if any(k in part for part in place.parts)]
    best = max(octaves, key=lambda octave: octave.factor)
    used = [octave for octave in octaves if octave.probability > 1 / 2] or [best]
    names = {UNLISTED: 1.0}
    if octaves[-1] in used and (law := tilt_law(place.name, "time")):
        slow, random = _in_another_form(law, whitened.hypotheses), UNLISTED_SHARE / len(every)
        names = {UNLISTED: random / (random + slow), law: slow / (random + slow)}
    return (_motion(place, used, told, chance, names),)


def _in_another_form(name: str, hypotheses: Sequence[Hypothesis]) -> float:
    """Prior probability of a listed law in another form than its textbook's."""
    shares = np.exp(log_priors(hypotheses))
    return sum(float(share) for share, h in zip(shares, hypotheses, strict=True) if h.alias == name)


def _motion(
    place: Place,
    used: Sequence[Octave],
    channels: Sequence[Channel],
    probability: float,
    names: Mapping[str, float],
) -> RandomMotion:
    """What is told of a place that moves.

    Args:
        place: which; used: octaves in which it moves; channels: that see it.
        probability: that something moves; names: of each name.
    """
    return RandomMotion(
        tuple(dict.fromkeys(channel.sensor for channel in channels)),
        tuple(dict.fromkeys(channel.axis for channel in channels)),
        f"the {place.name}",
        place.stage,
        min(octave.low for octave in used),
        max(octave.high for octave in used),
        probability,
        names,
    )


def _places(observations: Observations, effects: Sequence[Effect]) -> Iterator[Place]:
    """Whatever may move: two frames, and the table axes."""

    def tilt(slot: str, turn: str) -> Columns:
        one = LearnedTilt(ONE, coordinate="time", knots=ALWAYS, slot=slot, turn=turn)
        return observations.changes(one, effects)

    yield Place("base", "environment", tuple(tilt("base", turn) for turn in "xy"))
    yield Place("mount", "mount", tuple(tilt("mount", turn) for turn in "xyz"))
    for axis in observations.scenario.rig.axis_names:
        readout = LearnedReadout(ONE, coordinate="time", knots=ALWAYS, axis=axis)
        yield Place(f"{axis} axis", "table", (observations.changes(readout, effects),))


def _octaves(place: Place, recordings: Sequence[CrossPrediction]) -> list[Octave]:
    """What each octave says of a place, in all recordings together."""
    longest = max(recordings, key=lambda one: one.count)
    every = zip_longest(*(one.evidence(place) for one in recordings), fillvalue=0.0)
    return [
        Octave(longest.frequency(low), longest.frequency(high), float(sum(each)))
        for (low, high), each in zip(longest.octaves, every, strict=True)
    ]


def _factor(octaves: Sequence[Octave]) -> float:
    """Logarithm of the Bayes factor of a motion in one octave at least, each being one of them with
    the probability IN_USE.
    """
    none = len(octaves) * np.log(1 - IN_USE)
    some = sum(np.logaddexp(np.log(1 - IN_USE), np.log(IN_USE) + o.factor) for o in octaves)
    return float(some + np.log(-np.expm1(none - some)) - np.log(-np.expm1(none)))
