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
from tiltcal.design.time_budget import SAME

GRID = {1: 1 * DEG, 2: 15 * DEG}  # of the poses that get weights, by the number of axes
DENSE = {1: 0.25 * DEG, 2: 6 * DEG}  # of those over which the tangent is bounded
FEW, MANY = 500, 4000  # spread poses of more axes
PARTS = 10  # of the table time
NODES = 8  # of a part, where weight is spread out over the table time
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
        span: first and last time of the parts, s.
    """

    problem: Problem
    time: Array
    weight: Array
    noise: Array
    span: tuple[float, float]

    @property
    def edges(self) -> Array:
        """Of the parts of the time, s, (parts + 1,): one part where nothing depends on it."""
        parts = PARTS if self.problem.model.timed else 1
        return np.linspace(*self.span, parts + 1)

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
    middles = problem.clock.middles(angles, dwell)
    span = (0.0, problem.clock.budget)
    return _ideal(_Visits(problem, middles, each[:, 0], noise, span), angles)


def ideal_of_all(problem: Problem) -> Ideal:
    """The best weights at any poses and times, and a bound on every plan of the table time.

    Proof. Before a dwell of d seconds there are a settling time and a move to another pose, of
    SAME and of a step at least (nearer poses count as one): together s at least, the move left out
    before the first. So the intervals from s / 2 before each dwell to s / 2 after it do not
    overlap, and all lie between s / 2 less the move, and T + s / 2. The weight of a dwell, w(d), is
    at most r (d + s), with r = max w(d) / (d + s) over all allowed d. The tangent of the criterion
    by the information gives a dwell w(d) times the pull of its pose at its middle. The pull is a
    square of columns that are affine in time, convex, so that its mean over the interval, which
    has the same middle, is no less (Jensen). Thus the dwells together get no more than the
    integral over the table time of r times the largest pull of any pose.

    Args:
        problem: model, clock and criterion.
    """
    clock, model = problem.clock, problem.model
    lost = clock.settle + max(clock.step, SAME) / clock.rate
    longest = max(min(clock.longest, clock.budget), clock.shortest)
    # d / ((white^2 + floor^2 d) (d + s)) is largest at the root of s white^2 / floor^2, and falls
    # on both sides of it
    best = np.sqrt(lost) * model.white / np.maximum(model.floor, 1e-9 * model.white)
    dwell = np.clip(best, clock.shortest, longest)
    density = np.diag(model.weights(dwell)) / (dwell + lost)
    span = (clock.settle - lost / 2, clock.budget + lost / 2)
    cells = np.linspace(*span, NODES * PARTS + 1)
    middles, weight = (cells[:-1] + cells[1:]) / 2, density[0] * np.diff(cells)
    noise = np.sqrt(density[0] / density)
    visits = _Visits(problem, middles, weight, noise, span)
    return _ideal(visits, clock.inside(clock.origin[None]))


def _ideal(visits: _Visits, angles: Array) -> Ideal:
    """The best weights, and the bound; angles: poses in addition to a grid, rad, (n, axes)."""
    problem = visits.problem
    poses, steep, bound = _poses(problem, GRID, FEW), angles, np.inf
    w = np.ones((len(visits.edges) - 1, len(poses)))
    for _ in range(EXCHANGES):
        poses = np.vstack([poses, steep])
        w = np.hstack([w, np.full((len(w), len(steep)), w.mean())])
        poses, w, value, slope, reached = _improved(visits, poses, w)
        most, steep = _largest(visits, slope)
        bound = min(bound, value + most - reached)
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


@dataclass(frozen=True)
class Efficiency:
    """Of a plan, lower bounds on its information per parameter over the most that is possible; of
    the criterion, as a ratio of variances.

    Args:
        at_its_times: over any poses that are read at the same times for as long.
        of_all: over any poses, numbers of readings, times and dwells in the same table time.
    """

    at_its_times: float
    of_all: float


def efficiencies(problem: Problem, angles: Array, dwell: Array) -> Efficiency:
    """Both efficiencies of a plan.

    Args:
        problem: model, clock and criterion.
        angles: rad, (n, axes).
        dwell: s, (n,).
    """
    every = _share(problem, angles, dwell, ideal_of_all(problem).bound)
    return Efficiency(efficiency(problem, angles, dwell), every)


def efficiency(problem: Problem, angles: Array, dwell: Array) -> float:
    """That at the times of the plan.

    Args:
        problem: model, clock and criterion.
        angles: rad, (n, axes).
        dwell: s, (n,).
    """
    return _share(problem, angles, dwell, ideal(problem, angles, dwell).bound)


def _share(problem: Problem, angles: Array, dwell: Array, bound: float) -> float:
    information = problem.information(angles, dwell)
    value, _ = value_and_slope(information, problem.model, problem.criterion)
    short = bound - value
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


def _largest(visits: _Visits, slope: Array) -> tuple[float, Array]:
    """The most that the tangent gives to the weight of all visits, over all allowed poses, and the
    poses where it is largest, rad, (m, axes).

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
    return float(visits.weight @ np.interp(visits.time, edges, largest)), steep


def _poses(problem: Problem, steps: dict[int, float], count: int) -> Array:
    """Allowed poses that stand for all, rad, (m, axes)."""
    clock = problem.clock
    step = steps.get(len(clock.limits))
    every = spread(clock.limits, count) if step is None else grid(clock.limits, step)
    return np.unique(clock.inside(every), axis=0) if clock.step > 0 else every
