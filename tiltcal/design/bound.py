"""What no poses can pass that are read when a plan reads, and for as long: optimal weights, with a
certificate.

Each visit of a plan weighs as much as its mean is worth. As a function of a measure on poses every
criterion is concave, so that its tangent at any measure bounds all others (equivalence theorem):
the most that the tangent allows is a bound, whether the weights have converged or not. The moves
between the poses cost nothing here, and a visit may be shared out among poses, so that the bound is
not always reached.

Source: Kiefer and Wolfowitz 1960 (equivalence); Silvey, Titterington and Torsney 1978
(multiplicative algorithm); Pukelsheim 1993, *Optimal Design of Experiments*, ch. 2 and 7.
"""

from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import DEG
from tiltcal.design.criteria import value_and_slope
from tiltcal.design.gradient_search import Problem
from tiltcal.design.pose_grids import grid, spread

GRID = {1: 1 * DEG, 2: 15 * DEG}  # of the poses that get weights, by the number of axes
DENSE = {1: 0.25 * DEG, 2: 6 * DEG}  # of those over which the tangent is bounded
FEW, MANY = 500, 4000  # spread poses of more axes
PARTS = 10  # of the table time
ROUNDS, EXCHANGES = 60, 3  # of the weights; how often poses are added where the tangent is steep
NEAR, AROUND = 64, 20  # best poses near which the tangent is looked at again, and how often each
CLOSE = 1e-3  # nats between value and bound at which weights are good enough
DROPPED = 1e-4  # of the largest weight


@dataclass(frozen=True)
class Ideal:
    """The best weights found, and what none can pass.

    Args:
        angles: rad, (m, axes).
        weights: of each pose in each part of the table time, 1 / variance, (parts, m).
        value: of the criterion with these weights, nats.
        bound: on it, nats.
    """

    angles: Array
    weights: Array
    value: float
    bound: float


@dataclass(frozen=True)
class _Visits:
    """When a plan reads, and what its means weigh.

    Args:
        problem: model, clock and criterion.
        time: of the middles, s, (n,).
        weight: of the first channel, 1 / variance, (n,).
        noise: of the channels, relative to that of the first, (k,).
    """

    problem: Problem
    time: Array
    weight: Array
    noise: Array

    @property
    def edges(self) -> Array:
        """Of the parts of the time, s, (parts + 1,): one part where nothing depends on it."""
        parts = PARTS if self.problem.model.timed else 1
        return np.linspace(0.0, self.problem.clock.budget, parts + 1)

    @property
    def in_parts(self) -> Array:
        """Weight in each part, (parts,)."""
        return np.histogram(self.time, self.edges, weights=self.weight)[0]

    def rows(self, angles: Array, times: Array) -> Array:
        """Columns in the noise of the first channel at each time, (times, m, k, p)."""
        m = len(angles)
        found = self.problem.model.rows(np.tile(angles, (len(times), 1)), np.repeat(times, m))
        found = found / self.noise[:, None]
        return np.asarray(found.reshape(len(times), m, *found.shape[1:]))

    def scaled(self, w: Array) -> Array:
        """Weights that are in each part what the visits weigh there, (parts, m)."""
        return np.asarray(w * (self.in_parts / np.maximum(w.sum(axis=1), 1e-300))[:, None])


def ideal(problem: Problem, angles: Array, dwell: Array) -> Ideal:
    """The best weights for the times at which a plan reads, and the bound.

    Args:
        problem: model, clock and criterion.
        angles: of the plan, rad, (n, axes).
        dwell: s, (n,).
    """
    each = problem.model.weights(dwell)
    noise = np.sqrt(each[0, 0] / each[0])
    visits = _Visits(problem, problem.clock.middles(angles, dwell), each[:, 0], noise)
    poses, steep, bound = _poses(problem, GRID, FEW), angles, np.inf
    w = np.ones((len(visits.edges) - 1, len(poses)))
    for _ in range(EXCHANGES):
        poses = np.vstack([poses, steep])
        w = np.hstack([w, np.full((len(w), len(steep)), w.mean())])
        poses, w, value, slope, reached = _improved(visits, poses, w)
        largest, steep = _largest(visits, slope)
        bound = min(bound, value + float(visits.weight @ largest) - reached)
        if bound - value < CLOSE:
            break
    return Ideal(poses, w, value, bound)


def _improved(visits: _Visits, poses: Array, w: Array) -> tuple[Array, Array, float, Array, float]:
    """Poses and weights after some rounds, the criterion, its slope, and what the tangent gives at
    these weights.
    """
    rows = visits.rows(poses, (visits.edges[:-1] + visits.edges[1:]) / 2)
    w = visits.scaled(w)
    for _ in range(ROUNDS):
        value, slope, pull = _state(visits.problem, rows, w)
        reached = float((w * pull).sum())
        if float(visits.in_parts @ pull.max(axis=1)) - reached < CLOSE:
            break
        w = visits.scaled(w * np.maximum(pull, 0.0))
        kept = w.max(axis=0) > DROPPED * w.max()
        if kept.sum() < 0.7 * len(kept):
            poses, rows, w = poses[kept], rows[:, kept], visits.scaled(w[:, kept])
    value, slope, pull = _state(visits.problem, rows, w)
    return poses, w, value, slope, float((w * pull).sum())


def efficiency(problem: Problem, angles: Array, dwell: Array) -> float:
    """Of a plan, a lower bound: information per parameter over the most that any poses give that
    are read at the same times for as long; of the criterion, as a ratio of variances.

    Args:
        problem: model, clock and criterion.
        angles: rad, (n, axes).
        dwell: s, (n,).
    """
    information = problem.information(angles, dwell)
    value, _ = value_and_slope(information, problem.model, problem.criterion)
    short = ideal(problem, angles, dwell).bound - value
    return float(np.exp(-2 * max(short, 0.0) / problem.model.interest.sum()))


def _state(problem: Problem, rows: Array, w: Array) -> tuple[float, Array, Array]:
    """Criterion, its slope, and that by each weight, (parts, m)."""
    p = rows.shape[-1]
    flat = (rows * np.sqrt(w)[:, :, None, None]).reshape(-1, p)
    value, slope = value_and_slope(np.eye(p) + flat.T @ flat, problem.model, problem.criterion)
    return value, slope, _pull(rows, slope)


def _pull(rows: Array, slope: Array) -> Array:
    flat = rows.reshape(-1, rows.shape[-1])
    each = ((flat @ slope) * flat).sum(axis=1)
    return np.asarray(each.reshape(rows.shape[:3]).sum(axis=2))


def _largest(visits: _Visits, slope: Array) -> tuple[Array, Array]:
    """Largest slope by the weight of each visit, over all allowed poses, (n,), and the poses where
    it is largest, rad, (m, axes).

    Columns are affine in time, so that it is convex in time: straight lines between the edges of
    the parts are above it.
    """
    problem, edges = visits.problem, visits.edges
    poses = _poses(problem, DENSE, MANY)

    def at(tried: Array) -> Array:
        return np.vstack([_pull(visits.rows(tried, edges[[i]]), slope) for i in range(len(edges))])

    found = at(poses)
    axes = poses.shape[1]
    step = DENSE.get(axes, 10 * DEG)
    best = poses[np.argsort(-found.max(axis=0))[:NEAR]]
    around = np.random.default_rng(0).uniform(-step, step, (AROUND, axes))
    near = problem.clock.inside((best[:, None] + around).reshape(-1, axes))
    close = at(near)
    largest = np.maximum(found.max(axis=1), close.max(axis=1))
    steep = near[np.argsort(-close.max(axis=0))[:NEAR]]
    return np.interp(visits.time, edges, largest), steep


def _poses(problem: Problem, steps: dict[int, float], count: int) -> Array:
    """Allowed poses that stand for all, rad, (m, axes)."""
    clock = problem.clock
    step = steps.get(len(clock.limits))
    every = spread(clock.limits, count) if step is None else grid(clock.limits, step)
    return np.unique(clock.inside(every), axis=0) if clock.step > 0 else every
