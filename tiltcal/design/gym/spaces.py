"""Observations and actions of an agent, the same for one environment and for many."""

from itertools import product

import numpy as np
from gymnasium import spaces

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import DEG
from tiltcal.design.gym.calibrations import Bench, Task
from tiltcal.setup.pose_schemes import table_angles
from tiltcal.setup.setup import Rig
from tiltcal.setup.tables import DUAL

DEEPEST = -20.0  # log of posterior over prior that is shown at most
EVERYWHERE = Task()
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
    """Outer and inner angle, from the lowest (-1) to the highest (1) that is allowed, or as shares
    of half a turn where there are no limits, and the dwell from the shortest (-1) to the longest
    (1).
    """
    return spaces.Box(-1.0, 1.0, (3,), dtype=np.float32)


def pose_of(action: Array, task: Task) -> tuple[Array, Array]:
    """Angles, rad, (n, 2), and dwell, s, (n,), of continuous actions, (n, 3). Angles wrap where an
    axis has no limits, and are bounded otherwise, as dwells are.
    """
    share = (np.clip(action[:, 2], -1.0, 1.0) + 1) / 2
    middle, half = _spans(task)
    angles = np.asarray(action[:, :2], dtype=float)
    bounded = np.where(task.endless, angles, np.clip(angles, -1.0, 1.0))
    return middle + half * bounded, task.shortest_s + share * (task.longest_s - task.shortest_s)


def _spans(task: Task) -> tuple[Array, Array]:
    """Middle and half width of what an action spans, rad, (2,) each."""
    low = np.where(task.endless, -180.0, task.reach.low) * DEG
    high = np.where(task.endless, 180.0, task.reach.high) * DEG
    return (low + high) / 2, (high - low) / 2


def menu(task: Task = EVERYWHERE) -> Array:
    """The discrete variant's poses as continuous angles, rad, (n, 2): faces, edges and corners, 26
    where the limits allow all.

    Raises:
        TiltcalError: the limits allow none.
    """
    up = np.array([d for d in product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
    up /= np.linalg.norm(up, axis=1)[:, None]
    every = np.array([table_angles(Rig(table=DUAL.name), u, 0, "environment") for u in up])
    found = every[[task.reach.holds(angles / DEG) for angles in every]]
    if len(found) == 0:
        raise TiltcalError(
            "environment, limits_deg",
            found="no face, edge or corner within the limits",
            need="one",
            do="widen them, or take the continuous environment",
        )
    return found


def action_of(
    angles: Array, dwell: Array, task: Task
) -> "np.ndarray[tuple[int, int], np.dtype[np.float32]]":
    """The continuous action of poses, (n, 3): the inverse of ``pose_of``.

    Args:
        angles: rad, (n, axes).
        dwell: s, (n,).
        task: budget and limits.
    """
    middle, half = _spans(task)
    wrapped = np.where(task.endless, (angles + np.pi) % (2 * np.pi) - np.pi, angles)
    share = (dwell - task.shortest_s) / (task.longest_s - task.shortest_s)
    return np.column_stack([(wrapped - middle) / half, 2 * share - 1]).astype(np.float32)
