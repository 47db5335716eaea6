"""Readings over temperature as block means; the polynomial and the memory that predict blocks left
out best.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.core.frames import AXES
from tiltcal.instrument.temperature import Memory, TemperatureCourse
from tiltcal.recordings.references import NO_REFERENCES, References
from tiltcal.statistics.dwell_noise import second_difference_noise

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
    """

    X: Array
    power: Index
    axis: Index

    @classmethod
    def of(cls, blocks: Blocks, warm: Array, memory: Array | None) -> "Design":
        """From temperature (in units of half its range, about its mean) and the memory, (n,)."""
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
        return cls(np.column_stack(columns), np.array(power), np.array(axis))

    def chosen(self, model: Model) -> Index:
        """Columns of a model. Their numbers, (p,)."""
        bias = (self.axis < 0) & (self.power <= model.bias)
        axes = (self.axis >= 0) & (self.power <= model.axes)
        return np.flatnonzero(bias | axes)


@dataclass(frozen=True)
class Choice:
    """A model with its held-out errors.

    Args:
        model: powers and memory.
        design: its columns.
        heldout: rms error of blocks left out, SI, (k,).
        score: mean over folds of the squared errors, in units of the noise; spread: its standard
            error.
        size: number of columns.
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
) -> list[Choice]:
    """Every model with its held-out errors.

    Args:
        blocks: of one sensor.
        courses: memories that are tried, with the course of the temperature under each.
        reference: T0, degC.
        scale: half the range, degC.
    """
    fold = folds_of(blocks)
    warm = (blocks.mean(courses[0][1].level) - reference) / scale
    orders = AXIS_ORDERS if blocks.force is not None else range(1)
    found: list[Choice] = []
    for memory, course in courses:
        state = None if memory.kind == "none" else blocks.mean(course.memory)
        design = Design.of(blocks, warm, state)
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
    keep = design.chosen(model)
    square = np.ix_(keep, keep)
    G = np.sum([g for g, _, _, _ in grams], axis=0)
    C = np.sum([c for _, c, _, _ in grams], axis=0)
    errors = []
    for Gf, Cf, Sf, n in grams:
        A = (G - Gf)[square]
        ridge = RIDGE * np.trace(A) * np.eye(len(keep))
        x = np.linalg.lstsq(A + ridge, (C - Cf)[keep], rcond=None)[0]
        error = Sf + (x * (Gf[square] @ x - 2 * Cf[keep])).sum(axis=0)
        errors.append(np.maximum(error, 0.0) / max(n, 1))
    return Choice(model, design, np.array(errors), 0.0, 0.0, len(keep))


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
class Estimated:
    """A model fitted to blocks.

    Args:
        keep: numbers of its columns, (p,).
        values: (p, k).
        covariances: of each channel, (k, p, p).
        left: residuals, (n, k).
        residuals: the same less what stated references add most probably, (n, k).
        contributions: what one standard uncertainty of each reference changes, (k, p, q).
    """

    keep: Index
    values: Array
    covariances: Array
    left: Array
    residuals: Array
    contributions: Array


def estimate(choice: Choice, blocks: Blocks) -> Estimated:
    """A model by least squares, with covariances by stretches of time and by stated references.

    The sandwich over stretches holds whatever their noise is correlated like inside.

    Source: Liang and Zeger, Biometrika 73 (1986).
    """
    keep = choice.design.chosen(choice.model)
    X = choice.design.X[:, keep]
    scale = np.linalg.norm(X, axis=0)
    inverse = np.linalg.pinv(X / scale)
    values = inverse @ blocks.error / scale[:, None]
    uncertain = blocks.references
    columns = uncertain.columns if len(uncertain.owner) else np.zeros((0, *blocks.error.shape))
    changes = np.einsum("pn,qnk->kpq", inverse, columns) / scale[:, None]
    whole = blocks.error - X @ values
    left = _without_references(
        whole,
        (columns - np.einsum("np,kpq->qnk", X, changes))[uncertain.fitted],
    )
    number = max(STRETCHES, 3 * len(keep))
    stretch = np.arange(len(X)) * number // len(X)
    covariances = []
    for i in range(left.shape[1]):
        scores = np.zeros((number, len(keep)))
        np.add.at(scores, stretch, (inverse * left[:, i]).T)
        factor = number / max(number - len(keep), 1)
        stated = changes[i][:, uncertain.fitted]
        noise = factor * (scores.T @ scores) / np.outer(scale, scale)
        covariances.append(noise + stated @ stated.T)
    return Estimated(keep, values, np.array(covariances), whole, left, changes)


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


def names(sensor: str, axis: str, design: Design, keep: Index) -> list[str]:
    """Names of the parameters of one channel, "" where a column is no parameter of the sensor.
    keep: numbers of the columns, (p,).
    """
    found = []
    for power, j in zip(design.power[keep], design.axis[keep], strict=True):
        prefix = f"temp{power}_" if power > 0 else ""
        if power < 0:
            found.append(f"{sensor}.tempmem_{axis}")
        elif j < 0:
            found.append(f"{sensor}.{prefix}bias_{axis}")
        elif AXES[j] == axis:
            found.append(f"{sensor}.{prefix}scale_{axis}")
        else:
            found.append(f"{sensor}.{prefix}cross_{axis}{AXES[j]}")
    return found
