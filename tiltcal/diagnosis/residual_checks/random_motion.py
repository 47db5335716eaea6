"""Random motion of the base, the mount or a table axis: people walk by, a pier sways, a clamp is
loose. To each channel by itself that is noise. But what one channel reads predicts what another
does, as the attitude has it, and no noise of their electronics does.

What some channels of a recording see of a motion predicts the others, as the attitude has it.

The motion is estimated from some channels by least squares at each instant, and what it would do to
one more channel is compared with what that channel reads: a regression with one coefficient, from
no motion to all of it. Noise of a channel, whatever its spectrum and however its level changes, has
nothing to do with what others see. What they read themselves is regressed beside, octave by octave:
noise of a common supply is the same at every attitude. The channels follow one after the other, so
that their likelihoods multiply (chain rule of probability).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, zip_longest

import numpy as np
from scipy.special import expit, log_ndtr, logsumexp

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Channel, Columns, Observations
from tiltcal.diagnosis.hypotheses.curves import tilt_law
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.hypotheses.priors import NAMELESS, UNLISTED, UNLISTED_SHARE, log_priors
from tiltcal.diagnosis.lines.spectral_lines import limited
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.residual_checks.oscillations import searched
from tiltcal.effects.base import Effect
from tiltcal.effects.learned import LearnedReadout, LearnedTilt
from tiltcal.statistics.cosine_transform import cosines, inverse_cosines
from tiltcal.statistics.least_squares import column_space

FEWEST = 24  # frequencies of the slowest range: with fewer, a motion is no random one
UNSEEN = 0.1
"""Information on a motion, in the mean of a recording, that is added at each instant: where the
channels see less than that, little of it is estimated.
"""
SEES = 0.01  # of the information on a motion, what a channel has to have to be asked
STEPS, CLOSE = 12, 0.03  # of the solution for a motion, and how far it is solved
OWN = 0.1
"""Of the prediction of a channel, what is left of it beside what the others read: with less it is
no other than that.
"""


@dataclass(frozen=True)
class MotionSource:
    """What may move at random.

    Args:
        name: of it; stage: of the chain.
        parts: change of the channels by each of its independent parts, SI.
    """

    name: str
    stage: str
    parts: tuple[Columns, ...]


class CrossPrediction:
    """The channels of one recording at all of its stamps, and at so many more, at which none was
    read, that its octaves are whole.

    Args:
        channels: each with its residual in time, in units of the noise, and the root of the
            spectrum of that noise, by number.
    """

    def __init__(self, channels: Mapping[int, tuple[Channel, Array, Array]]) -> None:
        self._channels = {k: channel for k, (channel, *_) in channels.items()}
        stamps = np.unique(np.concatenate([c.time for c in self._channels.values()]))
        halvings = max(int(np.log2(len(stamps) / FEWEST)), 0)
        self.count = -(-len(stamps) // 2**halvings) * 2**halvings
        self.octaves = _octaves(self.count, halvings)
        self._step = float(np.median(np.diff(stamps)))
        self._at = {k: np.searchsorted(stamps, c.time) for k, c in self._channels.items()}
        self._white = {k: float(root.min()) for k, (*_, root) in channels.items()}
        self._colour = {k: root / self._white[k] for k, (*_, root) in channels.items()}
        self._waves = {k: cosines(left) for k, (_, left, _) in channels.items()}
        self._left = {k: self._placed(k, left) for k, (_, left, _) in channels.items()}
        self._read = {
            k: self._placed(k, inverse_cosines(waves * self._colour[k]))
            for k, waves in self._waves.items()
        }

    def frequency(self, coefficient: int) -> float:
        """Hz."""
        return coefficient / (2 * self.count * self._step)

    def evidence(self, place: MotionSource) -> Array:
        """Logarithm of the Bayes factor of a motion of a place in each octave, any part of what is
        predicted being as probable as another; the mean of two orders of the channels. (octaves,).
        """
        seen = self._seen(place)
        orders = [list(seen), list(seen)[::-1]]
        each = [np.zeros(len(self.octaves)) for _ in orders]
        for total, order in zip(each, orders, strict=True):
            for k in range(1, len(order)):
                total += list(self._given(order[k], order[:k], seen))
        return np.asarray(logsumexp(each, axis=0) - np.log(len(each)))

    def _given(self, one: int, others: Sequence[int], seen: Columns) -> Iterator[float]:
        """What each octave says of a channel, given others; seen: of each channel, (p, count)."""
        rows = self._at[one]
        read = [
            self._within(self._left[k], low, high) for k in others for low, high in self.octaves
        ]
        basis = column_space(np.column_stack([cosines(wave[rows]) for wave in read]))
        left = self._waves[one] - basis @ (basis.T @ self._waves[one])
        for low, high in self.octaves:
            motion = self._estimated(others, seen, low, high)
            wave = cosines((seen[one] * motion).sum(axis=0)[rows]) / self._colour[one]
            rest = wave - basis @ (basis.T @ wave)
            told = rest @ rest > OWN * (wave @ wave)
            yield _factor_of(rest, left) if told else 0.0

    def _seen(self, place: MotionSource) -> Columns:
        """What the channels that see a place answer to each of its parts, in units of their white
        noise, (p, count).
        """
        found = {}
        for k, channel in self._channels.items():
            none = np.zeros(len(channel.time))
            answers = np.array([part.get(k, none) for part in place.parts])
            found[k] = self._placed(k, channel.weighed(answers)) / self._white[k]
        most = max(float((s**2).sum()) for s in found.values())
        return {k: s for k, s in found.items() if (s**2).sum() > SEES * most}

    def _estimated(self, channels: Sequence[int], seen: Columns, low: int, high: int) -> Array:
        """A motion within an octave as some channels see it, (p, count): the mean of its posterior,
        every frequency being as probable as another.
        """
        from scipy.sparse.linalg import LinearOperator, cg

        rows = max(self.count // (2 * high), 1)  # that a motion so slow does not tell apart
        score = _means(np.array([seen[k] * self._read[k] for k in channels]).sum(axis=0), rows)
        both = np.array([seen[k][:, None] * seen[k] for k in channels]).sum(axis=0)
        information = _means(both, rows)
        shape = len(score), high - low
        beside = UNSEEN * float(np.trace(information).mean()) / len(score)

        def answered(within: Array) -> Array:
            motion = self._of(within.reshape(shape), low, score.shape[1])
            back = cosines(np.einsum("pqn,qn->pn", information, motion))[:, low:high]
            return back.ravel() + beside * within

        size = shape[0] * shape[1]
        operator = LinearOperator((size, size), matvec=answered, dtype=float)
        found, _ = cg(operator, cosines(score)[:, low:high].ravel(), rtol=CLOSE, maxiter=STEPS)
        longer = np.sqrt(self.count / score.shape[1])
        return longer * self._of(found.reshape(shape), low, self.count)

    def _of(self, within: Array, low: int, count: int) -> Array:
        """Columns with these cosine coefficients from ``low`` on, (p, m) -> (p, count)."""
        waves = np.zeros((len(within), count))
        waves[:, low : low + within.shape[1]] = within
        return inverse_cosines(waves)

    def _placed(self, number: int, column: Array) -> Array:
        """Columns of a channel at all stamps, (..., n) -> (..., count)."""
        whole = np.zeros((*column.shape[:-1], self.count))
        whole[..., self._at[number]] = column
        return whole

    def _within(self, column: Array, low: int, high: int) -> Array:
        """What columns have within an octave, (..., count)."""
        waves = cosines(column)
        waves[..., :low] = 0.0
        waves[..., high:] = 0.0
        return inverse_cosines(waves)


def _octaves(count: int, halvings: int) -> list[tuple[int, int]]:
    """First cosine coefficient of each octave and of the next one, the fastest octave first; last
    what is slower than these, down to one cycle in two recordings.
    """
    ends = [count // 2**k for k in range(halvings + 1)]
    return [(low, high) for high, low in pairwise([*ends, 1])]


def _means(column: Array, rows: int) -> Array:
    """Means of columns over so many rows, (..., n) -> (..., n / rows)."""
    return np.asarray(column.reshape(*column.shape[:-1], -1, rows).mean(axis=-1))


def _factor_of(wave: Array, left: Array) -> float:
    """Logarithm of the Bayes factor of what is predicted of a channel in what it reads, in cosine
    coefficients and units of its noise, (n,) each; of more than that noise where the rest, as far
    as the prediction weighs it, has more (White 1980).
    """
    cross, energy = float(wave @ left), float(wave @ wave)
    rest = left - min(max(cross / energy, 0.0), 1.0) * wave
    noise = max(float(wave**2 @ rest**2) / energy, 1.0)
    return log_factor(cross / noise, energy / noise)


def log_factor(cross: float, energy: float) -> float:
    """Logarithm of the Bayes factor of a coefficient between nothing and one, each as probable as
    another, to none.

    Args:
        cross: inner product of what is predicted and what is read, in units of the noise.
        energy: of what is predicted.
    """
    root = float(np.sqrt(energy))
    ends = np.array([-cross / root, (energy - cross) / root])
    low, high = sorted(log_ndtr(ends if ends[0] < 0 else -ends).tolist())
    mass = high + np.log1p(-np.exp(low - high)) if high > low else -np.inf
    return float(cross**2 / (2 * energy) + np.log(2 * np.pi) / 2 - np.log(root) + mass)


ALWAYS = (0.0, 1.0)  # knots of a constant
ONE = {"c0": 1.0, "c1": 1.0}  # rad: a curve that is one everywhere
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
) -> tuple[RandomMotion, ...]:
    """What moves at random, where that is so with at least this probability: the place that says
    most. Every place is as probable as another.

    Args:
        whitened: the noise that a model leaves.
        residual: of it, cosine coefficients in units of the noise, (n,) each.
        effects: of the model.
        least: probability from which it is told.
    """
    observations = whitened.observations
    channels = {k: c for k, c in searched(whitened) if c.rate_hz}
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
    every = [(place, _octave_edges(place, recordings)) for place in _places(observations, effects)]
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
    place: MotionSource,
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


def _places(observations: Observations, effects: Sequence[Effect]) -> Iterator[MotionSource]:
    """Whatever may move: two frames, and the table axes."""

    def tilt(slot: str, turn: str) -> Columns:
        one = LearnedTilt(ONE, coordinate="time", knots=ALWAYS, slot=slot, turn=turn)
        return observations.changes(one, effects)

    yield MotionSource("base", "environment", tuple(tilt("base", turn) for turn in "xy"))
    yield MotionSource("mount", "mount", tuple(tilt("mount", turn) for turn in "xyz"))
    for axis in observations.scenario.rig.axis_names:
        readout = LearnedReadout(ONE, coordinate="time", knots=ALWAYS, axis=axis)
        yield MotionSource(f"{axis} axis", "table", (observations.changes(readout, effects),))


def _octave_edges(place: MotionSource, recordings: Sequence[CrossPrediction]) -> list[Octave]:
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
