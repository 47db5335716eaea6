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
from tiltcal.design.optimal_weights import (
    best_weights,
    certified,
    most_log_det,
    most_visible,
)
from tiltcal.design.pose_grids import grid, spread
from tiltcal.design.signatures import Field, Signatures
from tiltcal.design.time_budget import Clock
from tiltcal.design.visit_order import visiting_order

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
        shares: of each effect of ``seen``; efficiency: D, of the linear terms, over the most on the
            grid.
        bounds: on the least share of any design, and of those that keep the ``REQUIRED`` share of
            the D-efficiency.
        references: most energy a pose of each effect; reference_gap: how far off they are at most.
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
        """D-efficiency of the linear terms: det(F'F / n)^(1/q) over the most. angles: rad, (n,
        axes).
        """
        return float(np.exp(Field(self.seen, angles).log_det(_even(angles))[0] - self.log_det))

    def merit(self, angles: Array) -> float:
        """Least share, lessened where the linear terms lose too much. angles: rad, (n, axes)."""
        return float(self.shares(angles).min() - 10 * max(REQUIRED - self.efficiency(angles), 0.0))


def blind_to_nothing(
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
        progress: is told what is being done, and how long it takes.
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
        part: is told what part of the effects is done.
    """
    found = []
    for k in range(len(seen.names)):
        found.append(most_visible(field.only(k)))
        part((k + 1) / len(seen.names))
    references = np.array([upper for _, upper in found])
    gap = max(upper / lower - 1 for lower, upper in found)
    return Goal(seen, references, most_log_det(field)), gap


def climbed(angles: Array, goal: Goal, clock: Clock, iterations: int) -> Array:
    """The poses after ascent of the soft minimum of the shares, the linear terms kept. angles: rad,
    (n, axes).
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
