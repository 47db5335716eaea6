"""Observations and actions of an agent, the same for one environment and for many."""

from itertools import product

import numpy as np
from gymnasium import spaces

from tiltcal.core.arrays import Array
from tiltcal.design.gym.calibrations import Bench, Task
from tiltcal.setup.pose_schemes import table_angles
from tiltcal.setup.setup import Rig
from tiltcal.setup.tables import DUAL

DEEPEST = -20.0  # log of posterior over prior that is shown at most
DWELLS = (5.0, 10.0, 20.0)  # s, of the discrete variant


def observation_space(task: Task) -> spaces.Box:
    """log(posterior/prior) of each parameter of interest, sin and cos of the angles, share of the
    time left.
    """
    p = 3 * task.width
    low = np.concatenate([np.full(p, DEEPEST), np.full(4, -1.0), [0.0]]).astype(np.float32)
    high = np.concatenate([np.zeros(p), np.ones(5)]).astype(np.float32)
    return spaces.Box(low, high, dtype=np.float32)


def observe(bench: Bench) -> "np.ndarray[tuple[int, int], np.dtype[np.float32]]":
    """The observation of each, (count, n), a new array."""
    known = np.clip(np.log(bench.sigmas().reshape(bench.count, -1)), DEEPEST, 0.0)
    left = np.clip(1 - bench.elapsed / bench.task.budget_s, 0.0, 1.0)
    return np.concatenate(
        [known, np.sin(bench.angles), np.cos(bench.angles), left[:, None]],
        axis=1,
        dtype=np.float32,
        casting="same_kind",
    )


def action_space() -> spaces.Box:
    """Outer and inner angle as shares of half a turn, and the dwell between the shortest (-1) and
    the longest (1).
    """
    return spaces.Box(-1.0, 1.0, (3,), dtype=np.float32)


def pose_of(action: Array, task: Task) -> tuple[Array, Array]:
    """Angles, rad, (n, 2), and dwell, s, (n,), of continuous actions, (n, 3); angles wrap, dwells
    are bounded.
    """
    share = (np.clip(action[:, 2], -1.0, 1.0) + 1) / 2
    return np.pi * np.asarray(action[:, :2], dtype=float), task.shortest_s + share * (
        task.longest_s - task.shortest_s
    )


def menu() -> Array:
    """The discrete variant's poses as continuous angles, rad, (26, 2): faces, edges and corners."""
    up = np.array([d for d in product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
    up /= np.linalg.norm(up, axis=1)[:, None]
    return np.array([table_angles(Rig(table=DUAL.name), u, 0, "environment") for u in up])


def action_of(
    angles: Array, dwell: Array, task: Task
) -> "np.ndarray[tuple[int, int], np.dtype[np.float32]]":
    """The continuous action of poses, (n, 3): the inverse of ``pose_of``.

    Args:
        angles: rad, (n, axes).
        dwell: s, (n,).
        task: budget and limits.
    """
    wrapped = (angles + np.pi) % (2 * np.pi) - np.pi
    share = (dwell - task.shortest_s) / (task.longest_s - task.shortest_s)
    return np.column_stack([wrapped / np.pi, 2 * share - 1]).astype(np.float32)
