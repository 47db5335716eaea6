"""Max-min design: the poses whose least visible effect is most visible, with little loss for the
ordinary calibration.

share_e = energy of effect e that a design leaves visible, over the most that any design of as many
poses can leave. As functions of weights on a grid of poses the energies are concave: the greatest
least share over all weights is a bound that no number of poses can pass, and its dual certifies it.
The poses follow from the best weights by gradient ascent of a soft minimum.

Source: T-optimality, Atkinson and Fedorov 1975; maximin efficiency, Dette 1997.
"""

from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.progress import Part, Progress, Stages, silent, unmeasured
from tiltcal.core.tasks.engines import Engine
from tiltcal.core.tasks.run_tasks import values_of
from tiltcal.core.units import DEG
from tiltcal.design.bounded_descent import minimise
from tiltcal.design.pose_grids import grid, spread
from tiltcal.design.signatures import Field, Signatures
from tiltcal.design.time_budget import Clock
from tiltcal.design.visit_order import visiting_order

CLOSE = 1.002  # upper over lower bound at which a reference is accurate enough
CUTS = 4  # planes of a bound


def most_visible(field: Field, rounds: int = 600) -> tuple[float, float]:
    """What the best weights found leave of an effect, and what no weights can pass.

    Multiplicative ascent; the largest energy at any pose is the bound (equivalence theorem).
    Where convergence is slow, cutting planes.
    """
    n = len(field.F)
    w = best = np.full(n, 1 / n)
    least, upper = 0.0, np.inf
    for k in range(rounds):
        r = field.left_over(w)[:, 0]
        mean = float(w @ r)
        best, least = (w, mean) if mean > least else (best, least)
        upper = min(upper, float(r.max()))
        if upper < CLOSE * least:
            return least, upper
        w = w * np.exp((1.0 + 4.0 * k / rounds) * (r / mean - 1).clip(-1, 1))
        w /= w.sum()
    least, below = certified(field, np.ones(1), best, planes=60)
    return least, min(upper, below)


def most_log_det(field: Field, rounds: int = 200) -> float:
    """What no weights can pass of the log determinant per term, mean of the channels (D-optimality,
    equivalence theorem).
    """
    n = len(field.F)
    w, upper = np.full(n, 1 / n), np.inf
    for _ in range(rounds):
        value, slope = field.log_det(w)
        upper = min(upper, value + float(np.log(slope.max())))
        if slope.max() < 1.0005:
            break
        w = w * slope
        w /= w.sum()
    return upper


def best_weights(field: Field, references: Array, rounds: int = 300) -> Array:
    """Weights with the greatest least share, (n,).

    Multiplicative ascent of the mix of effects that a soft minimum picks, ever sharper.

    Args:
        field: information of the poses.
        references: most energy of each effect, (effects,).
        rounds: number of iterations.
    """
    n = len(field.F)
    w = np.full(n, 1 / n)
    best, least = w, -np.inf
    for k in range(rounds):
        r = field.left_over(w) / references
        seen = w @ r
        if seen.min() > least:
            best, least = w, float(seen.min())
        mix = np.exp(-80 * (0.2 + 2.0 * k / rounds) * (seen - seen.min()))
        pull = r @ (mix / mix.sum())
        w = w * np.exp(0.8 * (pull / float(w @ pull) - 1).clip(-1, 1))
        w /= w.sum()
    return best


def certified(
    field: Field, references: Array, best: Array, planes: int = CUTS, log_det: float | None = None
) -> tuple[float, float]:
    """The greatest least share found, and what no weights can pass, by cutting planes (Kelley
    1960).

    Terms fitted with other weights v leave at least the energy that the best terms leave, so that
    share_e(w) <= sum_x w(x) r_e(x; v) for all w and v, and log det is concave. Each round solves a
    linear programme over w and takes v between its solution and the best weights so far.

    Args:
        references: (effects,).
        best: (n,).
        field: of all poses.
        references: most of each effect.
        best: weights to start from.
        planes: how many v.
        log_det: of the linear terms, which the weights have to keep; any unless given.
    """
    from scipy.optimize import linprog

    n = len(best)
    rows: list[Array] = []
    right: list[float] = []
    v, least, upper = best, -np.inf, np.inf
    for _ in range(planes):
        left = field.left_over(v) / references
        value, slope = field.log_det(v)
        if (v @ left).min() > least and (log_det is None or value >= log_det):
            best, least = v, float((v @ left).min())
        rows += [np.append(-share, 1.0) for share in left.T]
        right += [0.0] * len(references)
        if log_det is not None:
            rows.append(np.append(-slope, 0.0))
            right.append(value - 1 - log_det)
        found = linprog(
            np.append(np.zeros(n), -1.0),
            A_ub=np.array(rows),
            b_ub=np.array(right),
            A_eq=np.append(np.ones(n), 0.0)[None, :],
            b_eq=[1.0],
            bounds=[(0, None)] * n + [(None, None)],
            method="highs",
        )
        upper = min(upper, -float(found["fun"]))
        if upper < CLOSE * least:
            break
        solution = found["x"][:-1].clip(0)
        v = (solution / solution.sum() + 3 * best) / 4
    return least, upper


GRID = {1: 2 * DEG, 2: 10 * DEG}  # by the number of axes
SPREAD = 2048  # poses that stand for those of more axes
SHARP = 300.0  # of the soft minimum
KEPT = 0.9853  # D-efficiency that ascent aims at
REQUIRED = 0.985  # and that a design has to have
PENALTY = 3000.0
DIFF = 1e-5  # rad
FIRST_CLIMB = 0.7  # of the time of improving
BEST, CLIMB, ORDER, BOUNDS = (
    "the poses that show each effect best",
    "improving poses",
    "order of the poses",
    "bounds",
)
SHARES = {BEST: 55, CLIMB: 29, ORDER: 10, BOUNDS: 6}
"""Of the time, measured on 14 and 24 poses of a dual table, per cent."""


@dataclass(frozen=True)
class MaxMin:
    """A design that shows every effect.

    Args:
        seen: the effects.
        angles: rad, (n, axes), in the order of visiting.
        shares: of each effect of ``seen``.
        efficiency: D, of the linear terms, over the most on the grid.
        bounds: on the least share of any design, and of those that keep the ``REQUIRED`` share of
            the D-efficiency.
        references: most energy a pose of each effect.
        reference_gap: how far off they are at most.
        in_order: share of each effect that only the order shows.
    """

    seen: Signatures
    angles: Array
    shares: Array
    efficiency: float
    bounds: tuple[float, float]
    references: Array
    reference_gap: float
    in_order: dict[str, float]


@dataclass(frozen=True)
class Goal:
    """What poses are judged by: the most of each effect, and the most log determinant, that any
    could have.
    """

    seen: Signatures
    references: Array
    log_det: float

    def shares(self, angles: Array) -> Array:
        """Share of each effect, (effects,). angles: rad, (n, axes)."""
        energy = Field(self.seen, angles).left_over(_even(angles)).mean(axis=0)
        return np.asarray(energy / self.references)

    def efficiency(self, angles: Array) -> float:
        """D-efficiency of the linear terms: det(F'F / n)^(1/q) over the most.

        Args:
            angles: rad, (n, axes).
        """
        return float(np.exp(Field(self.seen, angles).log_det(_even(angles))[0] - self.log_det))

    def merit(self, angles: Array) -> float:
        """Least share, lessened where the linear terms lose too much. angles: rad, (n, axes)."""
        return float(self.shares(angles).min() - 10 * max(REQUIRED - self.efficiency(angles), 0.0))


def maximise_least_visibility(
    seen: Signatures,
    clock: Clock,
    poses: int = 24,
    seed: int = 0,
    starts: int = 4,
    engine: Engine | None = None,
    progress: Progress = silent,
) -> MaxMin:
    """The max-min design of some poses.

    Args:
        seen: the effects.
        clock: what the table may do.
        poses: how many.
        seed: of the drafts.
        starts: how many drafts.
        engine: where drafts are improved; this process if not given. The design is the same.
        progress: receives what is being done, and how long it takes.
    """
    stages = Stages(progress, SHARES)
    tried = grid_of_poses(clock)
    field = Field(seen, tried)
    stages.begin(BEST)
    goal, gap = goal_of(seen, field, stages.part)
    stages.begin(CLIMB)
    weights = best_weights(field, goal.references)
    rng = np.random.default_rng(seed)
    begun = []
    for k in range(starts):
        chosen = tried[rng.choice(len(tried), poses, replace=k > starts // 2, p=weights)]
        begun.append(chosen + rng.normal(0, 0.03, chosen.shape))
    drafts = values_of(climbed, [(a, goal, clock, 60) for a in begun], engine)
    stages.part(FIRST_CLIMB)
    ranked = sorted(drafts, key=goal.merit)
    best = max(
        values_of(climbed, [(a, goal, clock, 300) for a in ranked[-2:]], engine), key=goal.merit
    )
    stages.begin(ORDER)
    ordered, in_order = visiting_order(seen, best, clock, rng)
    stages.begin(BOUNDS)
    both = Field(seen, np.vstack([tried, best]))
    of_grid = np.append(weights, np.zeros(poses))
    of_design = np.append(np.zeros(len(tried)), _even(best))
    kept = goal.log_det + float(np.log(REQUIRED))
    bounds = (
        certified(both, goal.references, of_grid)[1],
        certified(both, goal.references, of_design, log_det=kept)[1],
    )
    return MaxMin(
        seen,
        ordered,
        goal.shares(ordered),
        goal.efficiency(ordered),
        bounds,
        goal.references,
        gap,
        in_order,
    )


def _even(angles: Array) -> Array:
    return np.full(len(angles), 1 / len(angles))


def grid_of_poses(clock: Clock) -> Array:
    """All allowed poses on the grid; of more than two axes as many spread ones, rad, (n, axes)."""
    step = GRID.get(len(clock.limits))
    return spread(clock.limits, SPREAD) if step is None else grid(clock.limits, step)


def goal_of(seen: Signatures, field: Field, part: Part = unmeasured) -> tuple[Goal, float]:
    """The most energy of each effect and the most log determinant, and how far off the former are
    at most.

    Args:
        seen: the effects.
        field: of all poses of the grid.
        part: callback, called with the share of the effects that is done.
    """
    found = []
    for k in range(len(seen.names)):
        found.append(most_visible(field.only(k)))
        part((k + 1) / len(seen.names))
    references = np.array([upper for _, upper in found])
    gap = max(upper / lower - 1 for lower, upper in found)
    return Goal(seen, references, most_log_det(field)), gap


def climbed(angles: Array, goal: Goal, clock: Clock, iterations: int) -> Array:
    """The poses after ascent of the soft minimum of the shares, the linear terms kept.

    Args:
        angles: rad, (n, axes).
        goal: effects, with the references.
        clock: table time of poses.
        iterations: number of iterations.
    """
    n, axes = angles.shape
    bounds = [pair or (-np.inf, np.inf) for pair in clock.limits]
    low, high = np.tile(np.array(bounds).T, n)

    def fall(x: Array) -> tuple[float, Array]:
        return _falling(x.reshape(n, axes), goal)

    return clock.inside(minimise(fall, angles.ravel(), low, high, iterations).reshape(n, axes))


def _falling(angles: Array, goal: Goal) -> tuple[float, Array]:
    """Minus the soft minimum, with a penalty on lost D-efficiency, and its gradient by the angles,
    (axes n,).

    The fitted linear terms are at their optimum, so only the poses' own energies move with the
    poses.
    """
    n, axes = angles.shape
    even = _even(angles)
    here = Field(goal.seen, angles)
    terms = here.fitted(even)
    energy = here.energy(terms)
    seen = energy.mean(axis=0) / goal.references
    mix = np.exp(-SHARP * (seen - seen.min()))
    value = float(seen.min() - np.log(mix.sum()) / SHARP)
    mix /= mix.sum() * goal.references
    kept = float(np.exp(here.log_det(even)[0] - goal.log_det))
    lost = max(KEPT - kept, 0.0)
    slope = np.empty((n, axes))
    for axis in range(axes):
        ahead = Field(goal.seen, angles + DIFF * np.eye(axes)[axis])
        moved = (ahead.energy(terms) - energy) @ mix
        slope_of_log_det = _log_det_slope(here.F, (ahead.F - here.F) / DIFF)
        slope[:, axis] = moved / (n * DIFF) + 2 * PENALTY * lost * kept * slope_of_log_det
    return -value + PENALTY * lost**2, -slope.ravel()


def _log_det_slope(F: Array, dF: Array) -> Array:
    """Derivative of the log determinant per term, mean of the channels, by each pose, (n,)."""
    n, channels, terms = F.shape
    found = np.zeros(n)
    for k in range(channels):
        inverse = np.linalg.inv(F[:, k].T @ F[:, k] / n + 1e-12 * np.eye(terms))
        found += 2 * np.einsum("ni,ij,nj->n", F[:, k], inverse, dF[:, k]) / (n * terms * channels)
    return found
