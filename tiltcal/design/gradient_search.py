"""Continuous improvement of a sequence: all angles and dwells at once, by gradients, at a fixed
table time.

A move's largest axis is smoothed upwards (a p-norm), so that what is found never overruns. Dwells
share what time is left after moves, settling and shortest dwells: D_k = shortest + R softmax(z)_k.
The gradient is exact but for the slope of the rows, which are differenced one-sidedly.
"""

from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import one_of
from tiltcal.design.bounded_descent import minimise
from tiltcal.design.criteria import CRITERIA, NONE, value_and_slope
from tiltcal.design.model import Model
from tiltcal.design.time_budget import SAME, Clock

APART = 50.0  # nats by which two poses that coincide are pushed apart
POWER = 8  # of the norm that stands for the largest axis
KEPT = 1.3  # of the least move: the smoothed size of a move is up to so much above the true one
SOFT = 1e-4  # rad^2, rounds the corner of a move of length zero
STEP = 1e-5  # rad, s: of the differences


@dataclass(frozen=True)
class Draft:
    """A sequence during the search.

    Args:
        angles: rad, (n, axes).
        z: logarithmic shares of the free time, (n,).
        value: the criterion, nats.
    """

    angles: Array
    z: Array
    value: float = -np.inf


@dataclass(frozen=True)
class Problem:
    """What is to be designed.

    Args:
        model: information of poses.
        clock: table time of poses.
        criterion: figure of merit, a name of ``criteria``.
        floors: of D and of the tilt, nats, that a sequence is not to fall below.
    """

    model: Model
    clock: Clock
    criterion: str = "both"
    floors: tuple[float, float] = NONE

    def __post_init__(self) -> None:
        one_of(self.criterion, CRITERIA, "criterion")

    @property
    def least(self) -> int:
        """Poses of which a fit of all parameters has a reading left to be judged by."""
        return len(self.model.names) // len(self.model.white) + 1

    def dwells(self, angles: Array, z: Array) -> Array:
        """Seconds of each dwell: the free time shared out, none beyond the longest, (n,).

        Args:
            angles: rad, (n, axes).
            z: shares before the softmax, (n,).
        """
        share = np.exp(z - z.max())
        dwell = (
            self.clock.shortest + max(float(self.clock.spare(angles)), 0.0) * share / share.sum()
        )
        for _ in range(8):  # what is cut off goes to the others
            over = np.maximum(dwell - self.clock.longest, 0.0).sum()
            dwell = np.minimum(dwell, self.clock.longest)
            open_ = dwell < self.clock.longest
            if over < 1e-9 or not open_.any():
                break
            dwell[open_] += over * share[open_] / share[open_].sum()
        return self.clock.shortened(angles, np.minimum(dwell, self.clock.longest))

    def information(self, angles: Array, dwell: Array) -> Array:
        """Information of a sequence with its true table times, (p, p).

        Args:
            angles: rad, (n, axes).
            dwell: s, (n,).
        """
        return self.model.information(angles, dwell, self.clock.middles(angles, dwell))

    def rated(self, angles: Array, z: Array) -> Draft:
        """A draft with its true value; minus infinity where the moves alone overrun. A pose that
        is taken twice without a move between is one longer dwell.

        Args:
            angles: rad, (n, axes).
            z: shares before the softmax, (n,).
        """
        angles, z = merged(angles, z)
        if float(self.clock.spare(angles)) < 0:
            return Draft(angles, z)
        information = self.information(angles, self.dwells(angles, z))
        return Draft(angles, z, self.value_and_slope(information)[0])

    def value_and_slope(self, information: Array) -> tuple[float, Array]:
        """The criterion, nats, and its derivative by the information, (p, p).

        Args:
            information: (p, p).
        """
        return value_and_slope(information, self.model, self.criterion, self.floors)


def merged(angles: Array, z: Array) -> tuple[Array, Array]:
    """A sequence whose neighbouring poses that are the same are one, with the shares of both.

    Args:
        angles: rad, (n, axes).
        z: shares before the softmax, (n,).
    """
    if len(angles) < 2:
        return angles, z
    fresh = np.concatenate([[True], np.abs(np.diff(angles, axis=0)).max(axis=1) > SAME])
    if fresh.all():
        return angles, z
    first = np.flatnonzero(fresh)
    return angles[first], np.logaddexp.reduceat(z, first)


def ascend(problem: Problem, draft: Draft, iterations: int, dwells_only: bool = False) -> Draft:
    """The draft after some iterations of L-BFGS (within the clock's limits), or itself when that is
    no better.
    """
    n, axes = draft.angles.shape
    climb = _Climb(problem, n, axes)
    start = np.concatenate([draft.angles.ravel(), draft.z])
    pairs = [pair or (-np.inf, np.inf) for pair in problem.clock.limits]
    limits = (
        np.tile(np.array(pairs), (n, 1))
        if not dwells_only
        else np.repeat(draft.angles.ravel()[:, None], 2, axis=1)
    )
    low, high = np.vstack([limits, np.tile([-12.0, 12.0], (n, 1))]).T
    found = minimise(climb, start, low, high, iterations)
    better = problem.rated(found[: n * axes].reshape(n, axes), found[n * axes :])
    return better if better.value > draft.value else draft


@dataclass(frozen=True)
class _Climb:
    """Minus the criterion and its gradient by (angles, z) in one vector."""

    problem: Problem
    n: int
    axes: int

    def __call__(self, x: Array) -> tuple[float, Array]:
        model, clock = self.problem.model, self.problem.clock
        angles, z = x[: self.n * self.axes].reshape(self.n, self.axes), x[self.n * self.axes :]
        origin = clock.origin[None]
        leg = np.diff(angles, axis=0, prepend=origin, append=origin)[: self.n + clock.returns]
        moves, by_leg = _soft_largest(leg, clock.rate)
        free = clock.budget - moves.sum() - self.n * (clock.settle + clock.shortest)
        if free <= 0:  # back inside, the shortest way
            return 1e4 - free, np.concatenate([_of_legs(by_leg, self.n).ravel(), np.zeros(self.n)])
        push, by_push = self._apart(moves, by_leg)
        share = np.exp(z - z.max())
        share /= share.sum()
        dwell = clock.shortest + free * share
        time = np.cumsum(moves[: self.n] + clock.settle + dwell) - dwell / 2
        rows, slopes, by_time = self._rows(angles, time)
        weights = model.weights(dwell)
        flat = (rows * np.sqrt(weights)[:, :, None]).reshape(-1, rows.shape[2])
        value, G = self.problem.value_and_slope(np.eye(rows.shape[2]) + flat.T @ flat)
        pull = rows @ G
        of_angle = 2 * np.einsum("nk,nkp,ankp->na", weights, pull, slopes)
        of_dwell = (np.einsum("nkp,nkp->nk", pull, rows) * weights**2 * model.white**2).sum(
            axis=1
        ) / dwell**2
        of_move = np.zeros(len(leg))
        if by_time is not None:
            of_time = 2 * np.einsum("nk,nkp,nkp->n", weights, pull, by_time)
            later = np.cumsum(of_time[::-1])[::-1]
            of_move[: self.n], of_dwell = later, of_dwell + later - of_time / 2
        of_free = float((of_dwell * share).sum())
        of_angle += _of_legs((of_move - of_free)[:, None] * by_leg - by_push, self.n)
        return push - value, -np.concatenate(
            [of_angle.ravel(), free * share * (of_dwell - of_free)]
        )

    def _apart(self, moves: Array, by_leg: Array) -> tuple[float, Array]:
        """What keeps neighbouring poses from becoming one, nats, and its slope by the legs: two
        readings would be one with one floor. moves: s, (legs,); by_leg: (legs, axes).
        """
        between = np.arange(len(moves)) % self.n > 0  # neither from nor to the start
        least = self.problem.clock.nudge * KEPT / self.problem.clock.rate
        near = np.where(between, np.maximum(1 - moves / least, 0.0), 0.0)
        slope = -2 * APART * near / least
        return float(APART * (near**2).sum()), slope[:, None] * by_leg

    def _rows(self, angles: Array, time: Array) -> tuple[Array, Array, Array | None]:
        """Rows, (n, k, p), their slopes by each axis, (axes, n, k, p), and by time when the model
        depends on it.
        """
        points = [angles, *(angles + STEP * e for e in np.eye(self.axes))]
        times = [time] * len(points)
        if self.problem.model.timed:
            points, times = [*points, angles], [*times, time + STEP]
        parts = self.problem.model.rows(np.concatenate(points), np.concatenate(times)).reshape(
            len(points), self.n, len(self.problem.model.white), -1
        )
        slopes = (parts[1:] - parts[0]) / STEP
        return parts[0], slopes[: self.axes], slopes[-1] if self.problem.model.timed else None


def _soft_largest(leg: Array, rate: float) -> tuple[Array, Array]:
    """Seconds of each move, (n,), never below the true ones, and their slopes by the leg, (n,
    axes).
    """
    square = leg**2 + SOFT
    total = (square ** (POWER // 2)).sum(axis=1)
    size = total ** (1 / POWER)
    return size / rate, square ** (POWER // 2 - 1) * leg * (size / total)[:, None] / rate


def _of_legs(by_leg: Array, poses: int) -> Array:
    """Gradient by the angles from that by the legs to them, and by the way back if there is one."""
    found = by_leg[:poses].copy()
    found[: len(by_leg) - 1] -= by_leg[1:]
    return found
