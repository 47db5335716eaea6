"""Training a simple policy without deep learning: the cross-entropy method on a linear policy, all
candidates stepped at once.

``python -m tiltcal.design.gym.training`` trains one and prints what it is worth in addition to the
baselines.

The functional form: the next pose is the present one plus a step that is linear in (1, time left,
sin and cos of the angles), and so is the dwell. Source of the method: Rubinstein 1999.
"""

from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.design.gym.calibrations import Task
from tiltcal.design.gym.policies import Policy, named, rollout

FEATURES = 6
START = np.array([[0.25, 0, 0, 0, 0, 0], [0.15, 0, 0, 0, 0, 0], [-0.75, 0, 0, 0, 0, 0]])
"""A path over the angles in equal steps, read 12 s at each: what the search begins with."""


@dataclass(frozen=True)
class Trained:
    """A linear policy.

    Args:
        weights: (3, FEATURES), of the step of outer and inner in half turns, and of the dwell's
            action.
        history: best return of each generation, nats.
    """

    weights: Array
    history: tuple[float, ...]

    def __call__(self, observations: Array, step: int) -> Array:
        """Actions, (n, 3)."""
        return linear_policy(self.weights[None])(observations, step)


def linear_policy(weights: Array) -> Policy:
    """The policy of weights, (n or 1, 3, FEATURES): one row of observations each."""

    def act(observations: Array, _: int) -> Array:
        tail = np.asarray(observations[:, -5:], dtype=float)  # sin, sin, cos, cos, time left
        features = np.column_stack([np.ones(len(tail)), tail[:, 4], tail[:, :4]])
        out = np.einsum("nij,nj->ni", np.broadcast_to(weights, (len(tail), 3, FEATURES)), features)
        present = np.arctan2(tail[:, :2], tail[:, 2:4]) / np.pi
        out[:, :2] = (present + out[:, :2] + 1) % 2 - 1
        return np.clip(out, -1, 1).astype(np.float32)

    return act


def train(
    task: Task, generations: int = 40, population: int = 256, elite: int = 24, seed: int = 0
) -> Trained:
    """The best policy that the cross-entropy method finds."""
    rng = np.random.default_rng(seed)
    mean, spread = START.copy(), np.full(START.shape, 0.2)
    best, history = (mean, -np.inf), []
    for _ in range(generations):
        candidates = mean + spread * rng.standard_normal((population, *mean.shape))
        worth = rollout(linear_policy(candidates), task, population)
        chosen = candidates[np.argsort(-worth)[:elite]]
        mean, spread = chosen.mean(axis=0), chosen.std(axis=0) + 0.003
        if worth.max() > best[1]:
            best = (candidates[int(np.argmax(worth))], float(worth.max()))
        history.append(float(worth.max()))
    return Trained(best[0], tuple(history))


def main() -> None:
    """Train on the default task and compare."""
    task = Task()
    trained = train(task)
    print(
        f"trained linear policy: {float(rollout(trained, task)[0]):.2f} nats after"
        f" {len(trained.history)} generations"
    )
    for name in ("random", "24", "greedy", "design"):
        print(f"{name}: {float(np.median(rollout(named(name, task), task, 100))):.2f} nats")


if __name__ == "__main__":
    main()
