"""Noise whose size follows a table angle, whenever that angle is passed, or a cycle in time:
contacts that are worn in one sector, a compressor that runs now and then.

The squares of the residual are regressed on what the noise of an instrument may depend on (motion
and rest, time, temperature, speed, inputs; Koenker, J. Econometrics 17, 1981). What is left may
follow an angle or a cycle (``sectors_and_cycles``).

Whether what is left of squares repeats at the same angle, or in time: evidence, and where it is
large.

Parts of a recording agree on the angles at which it is large. The sum of the products of every two
parts, each with bursts of its own, is normal by its own squares (self-normalised sums: de la Pena,
Lai and Shao 2009). A cycle is a line with its harmonics in the spectrum (harmonic summing).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.special import expit, log_ndtr, logsumexp

from tiltcal.core.arrays import Array, Index
from tiltcal.diagnosis.data.observations import Channel, Observations
from tiltcal.diagnosis.hypotheses.priors import NAMELESS
from tiltcal.diagnosis.lines.spectral_lines import evenly, limited, running_median
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.residual_checks.oscillations import log_excess_of_sums, searched
from tiltcal.effects.base import Effect
from tiltcal.effects.curve_coordinates import coordinate_of
from tiltcal.recordings.recording import stem
from tiltcal.statistics.least_squares import column_space

SECTORS = 24  # of a turn
PARTS = (4, 16)  # of a recording, at least and at most: as many as an axis makes turns
FINER = 2  # frequencies a width of a line
SLOWEST = 12  # cycles in a recording: slower ones look like a level that wanders
AROUND = 24  # lines that say what is usual about one
HARMONICS = (1, 2, 4)  # of a cycle, each number as probable as another
TRIED = 41  # periods near that of a line
SIZES = 10.0 ** np.arange(-0.5, 2.5, 0.5)  # expected z of what is there, each as probable


def likeliest_cycle(time: Array, left: Array) -> tuple[float, float]:
    """Period, s, of the cycle that says most, and the logarithm of its Bayes factor, any frequency
    being as probable as another.

    Args:
        time: s, (n,); left: of each row, (n,).
    """
    from scipy.fft import next_fast_len

    values, rate = evenly(time, left)
    size = next_fast_len(FINER * len(values), real=True)
    power = np.abs(np.fft.rfft(values, size)) ** 2
    usual = running_median(power, FINER * AROUND) / np.log(2)
    power = power / np.maximum(usual, np.finfo(float).tiny)
    first = round(SLOWEST * size / len(values))
    count = (len(power) - 1) // max(HARMONICS) - first
    if count < AROUND:
        return 0.0, -np.inf
    lines, total, factors = first + np.arange(count), np.zeros(count), []
    for n in range(1, max(HARMONICS) + 1):
        total = total + power[n * lines]
        if n in HARMONICS:
            factors.append(log_excess_of_sums(total, n))
    factor = logsumexp(factors, axis=0) - np.log(len(HARMONICS) * count)
    best = int(np.argmax(factor))
    return float(size / (lines[best] * rate)), float(factor[best])


def parts_agree(left: Array, phase: Array) -> float:
    """How much parts of a recording agree on where in a turn the noise is large: of unit variance,
    where they do not, and nearly normal where many sectors are visited; the less, the fewer they
    are.

    Args:
        left: of each row, (n,); phase: in turns, (n,).
    """
    turns = float(np.abs(np.diff(phase)).sum())
    parts = int(np.clip(round(turns), *PARTS))
    part = np.arange(len(left)) * parts // len(left)
    cell = part * SECTORS + sectors_of(phase)
    sums, rows = (
        np.bincount(cell, of, parts * SECTORS).reshape(parts, SECTORS)
        for of in (left, np.ones(len(left)))
    )
    # a part that is noisier as a whole says nothing
    pattern = sums - rows * (sums.sum(axis=1) / np.maximum(rows.sum(axis=1), 1.0))[:, None]
    products = (pattern @ pattern.T)[np.triu_indices(parts, 1)]
    energy = float(products @ products)
    return float(products.sum() / np.sqrt(energy)) if energy > 0 else 0.0


def sectors_of(phase: Array) -> Index:
    """Number of the sector of a turn or a cycle, (n,). phase: in turns, (n,)."""
    return np.floor(phase * SECTORS).astype(np.intp) % SECTORS


def log_agreement(z: float) -> float:
    """Logarithm of the Bayes factor of a positive normal score."""
    variance = SIZES**2
    share = variance / (1 + variance)
    each = z**2 / 2 * share - np.log1p(variance) / 2 + log_ndtr(z * np.sqrt(share)) + np.log(2)
    return float(logsumexp(each) - np.log(len(SIZES)))


def sharpest(time: Array, left: Array, period: float) -> float:
    """The period near one in whose sectors the squares differ most, s.

    Args:
        time: s, (n,); left: of each row, (n,).
        period: of a line, s.
    """
    since = time - time[0]
    tried = 1 / (1 / period + np.linspace(-1, 1, TRIED) / float(since[-1]))

    def apart(one: float) -> float:
        sector = sectors_of(since / one)
        count = np.maximum(np.bincount(sector, minlength=SECTORS), 1)
        return float((np.bincount(sector, left, SECTORS) ** 2 / count).sum())

    return float(max(tried, key=apart))


def noisy_sectors(sums: Array) -> Index:
    """The sectors in a row, round the turn, half of them at most, whose sum is largest; their
    numbers go on beyond the last. sums: (SECTORS,).
    """
    twice = np.concatenate([[0.0], np.cumsum(np.tile(sums - sums.mean(), 2))])
    best, found = -np.inf, np.arange(1, dtype=np.intp)
    for width in range(1, SECTORS // 2 + 1):
        within = twice[width : width + SECTORS] - twice[:SECTORS]
        k = int(np.argmax(within))
        if within[k] > best:
            best, found = float(within[k]), k + np.arange(width)
    return found


AFTER = (0.3, 1.0, 3.0, 10.0)  # s, in which the noise may settle after a move
DEGREE = 5  # of the law by which it may depend on temperature, speed and its changes
MIN_ROWS = 256  # rows of a channel, which tell more than what they are regressed on
VARIES = 1e-6  # of the squares, that no rounding is


@dataclass(frozen=True)
class VaryingNoise:
    """Noise of some channels of a sensor that follows an angle or a cycle.

    Args:
        sensor, axes: whose; recording: which, in words; None where there is one only.
        follows: the table axis; None for a cycle.
        period: of a cycle, s; 0 for an angle.
        low, high: ends of the sector in which the noise is large, deg, beyond 360 where it holds 0;
            0 for a cycle.
        times: standard deviation where it is large, by that elsewhere, each by what the noise of an
            instrument may depend on.
    """

    sensor: str
    axes: tuple[str, ...]
    recording: str | None
    follows: str | None
    period: float
    low: float
    high: float
    times: float

    @property
    def words(self) -> str:
        """For the notes."""
        where = f" in {self.recording}" if self.recording else ""
        if self.follows is None:
            noisy = f"in one part of each cycle of {self.period:.3g} s"
        else:
            noisy = f"between {self.low:.0f} and {self.high:.0f} deg of the {self.follows} angle"
        return (
            f"the noise of {self.sensor} {', '.join(self.axes)}{where} is {self.times:.2f} times as"
            f" large {noisy} as elsewhere"
        )


@dataclass(frozen=True)
class Squares:
    """Squares of the residual of one or more channels of a sensor in one recording, less what the
    noise of an instrument may depend on.

    Args:
        channels: which; time: s, (n,); angles: of the turning axes, rad, (n,).
        left: what the regression leaves, of unit variance, (n,).
        size: squares of the residual, (n,); usual: what the regression says of them, (n,).
    """

    channels: tuple[Channel, ...]
    time: Array
    angles: Mapping[str, Array]
    left: Array
    size: Array
    usual: Array

    @classmethod
    def together(cls, every: Sequence["Squares"]) -> "Squares":
        """Those of channels that were read in the same rows."""
        first, left = every[0], np.sum([one.left for one in every], axis=0)
        size, usual = (
            np.mean(of, axis=0)
            for of in zip(*((one.size, one.usual) for one in every), strict=True)
        )
        channels = tuple(c for one in every for c in one.channels)
        return cls(channels, first.time, first.angles, left / left.std(), size, usual)


@dataclass(frozen=True)
class Candidate:
    """What the noise of some channels may follow.

    Args:
        squares: of the channels; axis: whose angle it follows; None for a cycle.
        period: s, of a cycle; factor: logarithm of the Bayes factor.
    """

    squares: Squares
    axis: str | None
    period: float
    factor: float


def varying_noise(
    whitened: WhitenedModel,
    residual: Sequence[Array],
    effects: Sequence[Effect],
    least: float,
) -> tuple[VaryingNoise, ...]:
    """What the noise follows, of what says most, where that is so with at least this probability.

    Args:
        whitened: the noise that a model leaves.
        residual: of it, cosine coefficients in units of the noise, (n,) each.
        effects: of the model.
        least: probability from which it is told.
    """
    every = list(_candidates(whitened, residual, effects))
    if not every:
        return ()
    factors = np.array([one.factor for one in every])
    prior = NAMELESS - np.log(len(every))
    if float(expit(logsumexp(factors) + prior)) < least:
        return ()
    return (_told(every[int(np.argmax(factors))], whitened.observations),)


def _candidates(
    whitened: WhitenedModel,
    residual: Sequence[Array],
    effects: Sequence[Effect],
) -> Iterator[Candidate]:
    """Each channel by itself, and those of a sensor together."""
    groups: dict[tuple[int, str, bytes], list[Squares]] = {}
    for k, channel in searched(whitened):
        left = limited(residual[k])
        if (squares := _squares(whitened.observations, k, left, effects)) is not None:
            key = channel.recording, channel.sensor, channel.rows.tobytes()
            groups.setdefault(key, []).append(squares)
    for group in groups.values():
        alone = group if len(group) == 1 else [*group, Squares.together(group)]
        for squares in alone:
            yield Candidate(squares, None, *likeliest_cycle(squares.time, squares.left))
            for axis, angle in squares.angles.items():
                agreement = parts_agree(squares.left, angle / (2 * np.pi))
                yield Candidate(squares, axis, 0.0, log_agreement(agreement))


def _squares(
    observations: Observations, k: int, left: Array, effects: Sequence[Effect]
) -> Squares | None:
    """The squares of a channel's residual, (n,); None where they do not vary, or are few beside
    what they are regressed on.
    """
    channel, size = observations.channels[k], left**2
    if len(left) < MIN_ROWS:
        return None
    known = column_space(np.column_stack(list(_usual(observations, k, effects))))
    usual = known @ (known.T @ size)
    rest = size - usual
    if not rest.std() > VARIES * size.std():
        return None
    course = observations.courses[channel.recording]
    turning = observations.scenario.rig.kind.turning
    angles = {axis: course.angles[axis][channel.rows] for axis in turning}
    return Squares((channel,), channel.time, angles, rest / rest.std(), size, usual)


def _usual(observations: Observations, k: int, effects: Sequence[Effect]) -> Iterator[Array]:
    """What the noise of an instrument may depend on, (n,) each: motion and rest, time, temperature,
    speed and how it changes, what the sensor feels, and how long ago the table moved.
    """
    channel = observations.channels[k]
    sense = observations.watches(effects)[channel.recording].sense[channel.sensor]
    own = sense.true_input()[:, channel.column]
    moving = (channel.stop < 0).astype(float)
    yield from (np.ones(len(moving)), moving)
    span = (channel.time - channel.time[0]) / float(np.ptp(channel.time))
    yield from (span, span**2, span**3)
    since = observations.at_samples(k, coordinate_of("since_move", sense, own))
    yield from ((1 - moving) * np.exp(-since / settled) for settled in AFTER)
    # any smooth law of it: in a cycle of the temperature the noise has its harmonics
    braking = coordinate_of("braking", sense, own)
    turns = np.linalg.norm(sense.angular_acceleration, axis=1)
    for course in (sense.temperature, coordinate_of("speed", sense, own), braking, turns):
        u = observations.at_samples(k, course)
        if (reach := float(np.ptp(u))) > 0:
            yield from legvander(2 * (u - u.min()) / reach - 1, DEGREE).T[1:]
    for felt in (own, *sense.force.T):
        u = observations.at_samples(k, felt)
        yield from (u, np.abs(u), u**2)


def _told(best: Candidate, observations: Observations) -> VaryingNoise:
    """What is told of a candidate."""
    squares = best.squares
    period = 0.0
    if best.axis is None:
        period = sharpest(squares.time, squares.left, best.period)
        phase = (squares.time - squares.time[0]) / period
    else:
        phase = squares.angles[best.axis] / (2 * np.pi)
    sector = sectors_of(phase)
    inside = noisy_sectors(np.asarray(np.bincount(sector, squares.left, SECTORS), float))
    noisy = np.isin(sector, inside % SECTORS)
    high, low = (
        squares.size[rows].mean() / max(squares.usual[rows].mean(), np.finfo(float).tiny)
        for rows in (noisy, ~noisy)
    )
    recordings = observations.recordings
    own = stem(recordings[squares.channels[0].recording].source)
    step = 0.0 if best.axis is None else 360.0 / SECTORS
    return VaryingNoise(
        squares.channels[0].sensor,
        tuple(c.axis for c in squares.channels),
        own if len(recordings) > 1 else None,
        best.axis,
        period,
        step * inside[0],
        step * (inside[-1] + 1),
        float(np.sqrt(high / low)),
    )
