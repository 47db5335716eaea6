"""Policies, all of one signature: observations (n, d) and the number of the step -> actions (n, 3).

Those that follow a list of poses see nothing; what they are worth is what an agent has to beat.
"""

from collections.abc import Callable, Iterator

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.design.classic import baseline
from tiltcal.design.gradient_search import Problem
from tiltcal.design.gym.calibrations import Bench, Task
from tiltcal.design.gym.environment import CalibrationVector
from tiltcal.design.gym.spaces import DWELLS, action_of, menu
from tiltcal.design.plan import design
from tiltcal.design.polynomial import textbook_model

Policy = Callable[[Array, int], Array]
BASELINES = ("random", "six", "12", "24", "tumble", "spiral", "greedy", "design")


def rollout(policy: Policy, task: Task, count: int = 1) -> Array:
    """Return of one episode in each of ``count`` environments, nats, (count,)."""
    environment = CalibrationVector(
        count,
        model=task.model,
        drift=task.drift,
        budget_s=task.budget_s,
        rate_deg_s=task.rate_deg_s,
        settle_s=task.settle_s,
        shortest_s=task.shortest_s,
        longest_s=task.longest_s,
        limits_deg=task.limits_deg,
    )
    observations, _ = environment.reset()
    total, live, step = np.zeros(count), np.ones(count, dtype=bool), 0
    while live.any():
        observations, rewards, over, _, _ = environment.step(policy(observations, step))
        total += np.where(live, rewards, 0.0)
        live &= ~over
        step += 1
    return total


def following(angles: Array, dwell: Array, task: Task) -> Policy:
    """The policy that goes through a list of poses, rad, (n, 2), s, (n,); after the last it asks
    for what overruns.
    """
    actions = action_of(angles, dwell, task)
    last = np.array([1.0, 1.0, 1.0], dtype=np.float32)

    def act(observations: Array, step: int) -> Array:
        return np.tile(actions[step] if step < len(actions) else last, (len(observations), 1))

    return act


def randomly(seed: int) -> Policy:
    """Any angles, dwells of 5 to 30 s or so."""
    rng = np.random.default_rng(seed)

    def act(observations: Array, _: int) -> Array:
        actions = rng.uniform(-1, 1, (len(observations), 3))
        actions[:, 2] = actions[:, 2] * 0.25 - 0.75
        return actions.astype(np.float32)

    return act


def named(name: str, task: Task, seed: int = 0) -> Policy:
    """A baseline: ``random``, a classic sequence cut to its best length, ``greedy``, or
    ``design``.
    """
    if name == "random":
        return randomly(seed)
    if name == "greedy":
        return following(*greedy(task), task)
    problem = Problem(textbook_model(task.model, task.drift, task.budget_s), task.clock)
    if name == "design":
        plan = design(problem, seed=seed)
        return following(plan.angles, plan.dwell, task)
    draft = baseline(problem, name)
    return following(draft.angles, problem.dwells(draft.angles, draft.z), task)


def greedy(task: Task) -> tuple[Array, Array]:
    """Poses, each of which brings the most nats per second from where the table stands: angles (n,
    2), dwells (n,).
    """
    return _joined(_greedily(task))


def _greedily(task: Task) -> Iterator[tuple[Array, float]]:
    poses = menu(task)
    choices = np.repeat(poses, len(DWELLS), axis=0)
    dwells = np.tile(DWELLS, len(poses))
    bench = Bench(task, len(choices))
    everyone = np.ones(len(choices), dtype=bool)
    while True:
        before = bench.steps
        nats, over, spent = bench.step(choices, dwells, everyone)
        taken = bench.steps > before
        if not taken.any():
            return
        best = int(np.argmax(np.where(taken, nats / np.maximum(spent, 1e-9), -np.inf)))
        yield choices[best], float(dwells[best])
        if over[best]:
            return
        for state in (bench.covariance, bench.drift, bench.angles, bench.elapsed, bench.steps):
            state[:] = state[best].copy()


def _joined(poses: Iterator[tuple[Array, float]]) -> tuple[Array, Array]:
    listed = list(poses)
    return np.array([a for a, _ in listed]), np.array([d for _, d in listed])
