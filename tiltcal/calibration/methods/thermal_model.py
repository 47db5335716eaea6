"""Readings over temperature as block means; the polynomial and the memory that predict blocks left
out best.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from tiltcal.calibration.methods.terms import term_columns
from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import AXES
from tiltcal.core.units import G0
from tiltcal.instrument.temperature import Memory, TemperatureCourse
from tiltcal.recordings.references import NO_REFERENCES, References
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.statistics.dwell_noise import second_difference_noise
from tiltcal.statistics.least_squares import Factored

ORDERS = range(6)  # of the bias
AXIS_ORDERS = range(4)  # of scale and cross-axis terms
LAGS = 20  # from SHORTEST_LAG samples to LONGEST_LAG of the recording, in equal ratios
SHORTEST_LAG, LONGEST_LAG = 2, 1 / 3
TURNS = np.geomspace(1 / 30, 1, 6)  # of the range of temperature
FOLDS = 10
STRETCHES = 40  # of time, dealt out to the folds in turn: neighbours are left out together
RIDGE = 1e-13


@dataclass(frozen=True)
class Blocks:
    """Means over short stretches at rest.

    Args:
        error: readings less the force that acts, where it is known, SI, (n, k).
        force: that acts in g, (n, 3); None where no attitude is known.
        pose: number of the unknown attitude, (n,); all 0 where the force is known.
        rows: first row and row after the last of each, (n, 2).
        time: of the middle, s, (n,).
        references: what uncertain references add to the readings, (q, n, k).
    """

    error: Array
    force: Array | None
    pose: Index
    rows: Index
    time: Array
    references: References = NO_REFERENCES

    @property
    def size(self) -> int:
        """Rows of the longest block."""
        return int(np.max(np.diff(self.rows, axis=1)))

    def mean(self, values: Array) -> Array:
        """Mean of a column of the recording over each block, (n,)."""
        total = np.concatenate([[0.0], np.cumsum(values)])
        first, last = self.rows.T
        return np.asarray((total[last] - total[first]) / (last - first))


@dataclass(frozen=True)
class Further:
    """Terms in addition to bias, scale factor and cross-axis terms, each of one channel.

    Args:
        names: of the parameters, (q,).
        units: of them, (q,).
        channels: of them, (q,).
        columns: reading per unit of each, SI, (n, q).
    """

    names: Sequence[str]
    units: Sequence[str]
    channels: Index
    columns: Array

    @classmethod
    def of(cls, terms: Sequence[str], sensor: Sensor, setup: Setup, blocks: Blocks) -> "Further":
        """The terms of a sensor at its blocks.

        Args:
            terms: linear effects of the sensor.
            sensor: which.
            setup: of the recording.
            blocks: of the sensor.

        Raises:
            TiltcalError: a term is unknown, or no known attitudes determine it.
        """
        if not terms:
            return cls((), (), np.zeros(0, np.intp), np.zeros((len(blocks.time), 0)))
        if blocks.force is None:
            raise TiltcalError(
                f"calibration terms {', '.join(terms)} of sensor {sensor.name}",
                found="one attitude, or attitudes that are not known",
                need="several known attitudes, about all axes",
                do="leave them out, or label the dwells",
            )
        names, units, columns = term_columns(terms, sensor, setup, blocks.force * G0)
        channels = np.argmax(np.abs(columns).max(axis=1), axis=1)
        own = columns[np.arange(len(names)), :, channels]
        return cls(names, units, channels, own.T)


@dataclass(frozen=True)
class Model:
    """Powers of temperature in the bias and in scale and axes, and a memory."""

    bias: int
    axes: int
    memory: Memory

    def words(self) -> str:
        """The model in words."""
        found = f"bias of order {self.bias}"
        if self.axes:
            found += f", scale and axes of order {self.axes}"
        return f"{found}, {self.memory.words()}"


@dataclass(frozen=True)
class Design:
    """Columns of the widest model under one memory; a model is a choice of them.

    Args:
        X: (n, p), by temperature scaled to its range.
        power: of temperature in each column, -1 for the memory, (p,).
        axis: 0 ... 2 where the column is multiplied by that component of the force, else -1, (p,).
        further: number of the further term of one channel that the column is of, else -1, (p,).
        terms: the further terms.
    """

    X: Array
    power: Index
    axis: Index
    further: Index
    terms: Further

    @classmethod
    def of(cls, blocks: Blocks, warm: Array, memory: Array | None, further: Further) -> "Design":
        """From temperature (in units of half its range, about its mean) and the memory, (n,).

        Args:
            blocks: of one sensor.
            warm: temperature, (n,).
            memory: (n,); None: without one.
            further: terms in addition.
        """
        columns, power, axis = [], [], []
        for k in range(blocks.pose.max() + 1):
            columns.append((blocks.pose == k).astype(float))
            power.append(0)
            axis.append(-1)
        for n in ORDERS[1:]:
            columns.append(warm**n)
            power.append(n)
            axis.append(-1)
        if blocks.force is not None:
            for n, j in product(AXIS_ORDERS, range(3)):
                columns.append(warm**n * blocks.force[:, j])
                power.append(n)
                axis.append(j)
        if memory is not None:
            columns.append(memory)
            power.append(-1)
            axis.append(-1)
        count = len(further.names)
        none = [-1] * count
        return cls(
            np.column_stack([*columns, further.columns]),
            np.array([*power, *[0] * count]),
            np.array([*axis, *none]),
            np.array([-1] * len(columns) + list(range(count))),
            further,
        )

    def allowed(self, channels: int) -> Mask:
        """Which columns each channel may have, (p, k). channels: their number, k."""
        own = np.append(self.terms.channels, -1)[self.further]
        return np.asarray((own[:, None] < 0) | (own[:, None] == np.arange(channels)))

    def chosen(self, model: Model, channels: int) -> list[tuple[Index, Index]]:
        """Columns of a model: their numbers, (p,), and the channels that have them. channels: their
        number.
        """
        bias = (self.axis < 0) & (self.power <= model.bias)
        axes = (self.axis >= 0) & (self.power <= model.axes)
        groups: dict[tuple[int, ...], list[int]] = {}
        for i, allowed in enumerate(self.allowed(channels).T):
            groups.setdefault(tuple(np.flatnonzero((bias | axes) & allowed)), []).append(i)
        return [(np.array(keep), np.array(which)) for keep, which in groups.items()]


@dataclass(frozen=True)
class Choice:
    """A model with its held-out errors.

    Args:
        model: powers and memory.
        design: its columns.
        heldout: rms error of blocks left out, SI, (k,).
        score: mean over folds of the squared errors, in units of the noise; spread: its standard
            error.
        size: number of parameters of all channels.
    """

    model: Model
    design: Design
    heldout: Array
    score: float
    spread: float
    size: int


def folds_of(blocks: Blocks) -> Index:
    """Fold of each block: stretches of time dealt out in turn, (n,)."""
    stretch = np.arange(len(blocks.time)) * STRETCHES // len(blocks.time)
    return np.asarray(stretch % FOLDS)


def compared(
    blocks: Blocks,
    courses: Sequence[tuple[Memory, TemperatureCourse]],
    reference: float,
    scale: float,
    further: Further,
) -> list[Choice]:
    """Every model with its held-out errors.

    Args:
        blocks: of one sensor.
        courses: memories that are tried, with the course of the temperature under each.
        reference: T0, degC.
        scale: half the range, degC.
        further: terms of every model.
    """
    fold = folds_of(blocks)
    warm = (blocks.mean(courses[0][1].level) - reference) / scale
    orders = AXIS_ORDERS if blocks.force is not None else range(1)
    found: list[Choice] = []
    for memory, course in courses:
        state = None if memory.kind == "none" else blocks.mean(course.memory)
        design = Design.of(blocks, warm, state, further)
        grams = [_gram(design.X[fold == k], blocks.error[fold == k]) for k in range(FOLDS)]
        for bias, axes in product(ORDERS, orders):
            if axes <= bias:
                found.append(_choice(Model(bias, axes, memory), design, grams))
    return _scored(found)


def _gram(X: Array, Y: Array) -> tuple[Array, Array, Array, int]:
    return X.T @ X, X.T @ Y, np.asarray((Y * Y).sum(axis=0)), len(X)


def _choice(
    model: Model, design: Design, grams: Sequence[tuple[Array, Array, Array, int]]
) -> Choice:
    """Squared errors of each fold under the fit of the others, in ``heldout`` as (FOLDS, k)."""
    G = np.sum([g for g, _, _, _ in grams], axis=0)
    C = np.sum([c for _, c, _, _ in grams], axis=0)
    channels = C.shape[1]
    groups = design.chosen(model, channels)
    errors = np.empty((len(grams), channels))
    for fold, (Gf, Cf, Sf, n) in enumerate(grams):
        for keep, which in groups:
            square, own = np.ix_(keep, keep), np.ix_(keep, which)
            A = (G - Gf)[square]
            ridge = RIDGE * np.trace(A) * np.eye(len(keep))
            x = np.linalg.lstsq(A + ridge, (C - Cf)[own], rcond=None)[0]
            error = Sf[which] + (x * (Gf[square] @ x - 2 * Cf[own])).sum(axis=0)
            errors[fold, which] = np.maximum(error, 0.0) / max(n, 1)
    size = sum(len(keep) * len(which) for keep, which in groups)
    return Choice(model, design, errors, 0.0, 0.0, size)


def _scored(found: Sequence[Choice]) -> list[Choice]:
    """With errors in units of the least of each channel."""
    least = np.min([c.heldout.mean(axis=0) for c in found], axis=0)
    unit = np.maximum(least, 1e-300)
    scored = []
    for c in found:
        folds = (c.heldout / unit).mean(axis=1)
        spread = float(folds.std(ddof=1) / np.sqrt(len(folds)))
        rms = np.sqrt(c.heldout.mean(axis=0))
        scored.append(Choice(c.model, c.design, rms, float(folds.mean()), spread, c.size))
    return scored


def smallest(found: Sequence[Choice]) -> Choice:
    """The smallest model whose held-out error is within one standard error of the least.

    Source: Breiman, Friedman, Olshen and Stone (1984), Classification and Regression Trees, 3.4.3.
    """
    best = min(found, key=lambda c: c.score)
    near = [c for c in found if c.score <= best.score + best.spread]
    return min(near, key=lambda c: (c.size, c.score))


def memories(time: Array, span: float) -> Iterator[Memory]:
    """The memories that are tried on a recording over a range of temperature. time: s, (n,); span:
    of temperature, K.
    """
    yield Memory()
    shortest = SHORTEST_LAG * float(np.median(np.diff(time)))
    for constant in np.geomspace(shortest, LONGEST_LAG * float(np.ptp(time)), LAGS):
        yield Memory("lag", float(constant))
    for share in TURNS:
        yield Memory("hysteresis", float(share * span))


@dataclass(frozen=True)
class ChannelFit:
    """The parameters of one channel.

    Args:
        keep: numbers of the columns whose parameters the blocks determine, (p,).
        values: (p,).
        covariance: (p, p).
        contributions: what one standard uncertainty of each reference changes, (p, q).
        dropped: numbers of the columns whose parameters they do not determine.
    """

    keep: Index
    values: Array
    covariance: Array
    contributions: Array
    dropped: Index


@dataclass(frozen=True)
class Estimated:
    """A model fitted to blocks.

    Args:
        channels: their parameters.
        left: residuals, SI, (n, k).
        residuals: the same less what stated references add most probably, SI, (n, k).
        rank: number of independent parameters of all channels.
    """

    channels: Sequence[ChannelFit]
    left: Array
    residuals: Array
    rank: int


def estimate(choice: Choice, blocks: Blocks) -> Estimated:
    """A model by least squares, with covariances by stretches of time and by stated references.

    The sandwich over stretches holds whatever their noise is correlated like inside.

    Source: Liang and Zeger, Biometrika 73 (1986).
    """
    uncertain, (n, k) = blocks.references, blocks.error.shape
    columns = uncertain.columns if len(uncertain.owner) else np.zeros((0, n, k))
    groups = [
        (keep, which, Factored.of(choice.design.X[:, keep]))
        for keep, which in choice.design.chosen(choice.model, k)
    ]
    whole, beyond = blocks.error.copy(), columns.copy()
    for _, which, f in groups:
        whole[:, which] -= f.u @ (f.u.T @ whole[:, which])
        beyond[:, :, which] -= f.u @ (f.u.T @ columns[:, :, which])
    left = _without_references(whole, beyond[uncertain.fitted])
    found: dict[int, ChannelFit] = {}
    for keep, which, f in groups:
        inverse = f.gain @ f.u.T
        known = f.determined
        rank = len(f.singular)
        number = max(STRETCHES, 3 * rank)
        stretch = np.arange(n) * number // n
        for i in which:
            changes = inverse @ columns[:, :, i].T
            scores = np.zeros((number, len(keep)))
            np.add.at(scores, stretch, (inverse * left[:, i]).T)
            stated = changes[:, uncertain.fitted]
            noise = number / max(number - rank, 1) * (scores.T @ scores)
            covariance = (noise + stated @ stated.T)[np.ix_(known, known)]
            values = (inverse @ blocks.error[:, i])[known]
            found[i] = ChannelFit(keep[known], values, covariance, changes[known], keep[~known])
    rank = sum(len(f.singular) * len(which) for _, which, f in groups)
    return Estimated([found[i] for i in range(k)], whole, left, rank)


def _without_references(left: Array, columns: Array) -> Array:
    """Residuals less what stated references add to them most probably: no part of the noise.

    Args:
        left: SI, (n, k).
        columns: what one standard uncertainty of each adds to the residuals, SI, (q, n, k).
    """
    if not len(columns):
        return left
    noise = np.array([second_difference_noise(channel) for channel in left.T])
    noise = np.maximum(noise, 1e-300)
    U = (columns / noise).reshape(len(columns), -1).T
    errors = np.linalg.solve(np.eye(len(columns)) + U.T @ U, U.T @ (left / noise).ravel())
    return np.asarray(left - np.tensordot(errors, columns, axes=1))


def names(sensor: Sensor, channel: int, design: Design, keep: Index) -> list[str]:
    """Names of the parameters of one channel.

    Args:
        sensor: which.
        channel: its number.
        design: columns of the model.
        keep: numbers of those that are asked for, (p,).
    """
    found, axis = [], sensor.axes[channel]
    for power, j, further in zip(
        design.power[keep], design.axis[keep], design.further[keep], strict=True
    ):
        prefix = f"temp{power}_" if power > 0 else ""
        if further >= 0:
            found.append(design.terms.names[further])
        elif power < 0:
            found.append(f"{sensor.name}.tempmem_{axis}")
        elif j < 0:
            found.append(f"{sensor.name}.{prefix}bias_{axis}")
        elif AXES[j] == axis:
            found.append(f"{sensor.name}.{prefix}scale_{axis}")
        else:
            found.append(f"{sensor.name}.{prefix}cross_{axis}{AXES[j]}")
    return found


def units(sensor: Sensor, choice: Choice, keep: Index) -> list[str]:
    """Units of parameters of a channel, those of a bias and of a sensitivity in SI, per power of
    degC. keep: numbers of their columns, (p,).
    """
    si, design = ("rad_s" if sensor.quantity == "rate" else "m_s2"), choice.design
    # a lagged temperature is a difference of temperatures, the state of a hysteresis a number
    memory = 1 if choice.model.memory.kind == "lag" else 0
    found = []
    for power, j, further in zip(
        design.power[keep], design.axis[keep], design.further[keep], strict=True
    ):
        base = "1" if j >= 0 else si
        degrees = memory if power < 0 else power
        unit = f"{base}_degC{degrees}" if degrees else base
        found.append(design.terms.units[further] if further >= 0 else unit)
    return found
