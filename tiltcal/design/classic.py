"""Textbook sequences as table angles, and the best that each reaches with a budget: baselines of a
design.
"""

from collections.abc import Iterator

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import one_of
from tiltcal.core.frames import sphere
from tiltcal.core.units import DEG
from tiltcal.design.gradient_search import Draft, Problem
from tiltcal.design.time_budget import Clock, unwound
from tiltcal.setup.pose_schemes import directions, table_angles
from tiltcal.setup.setup import Rig
from tiltcal.setup.tables import DUAL, Table

CLASSIC = ("six", "8", "12", "24", "tumble", "sweep", "two_position", "spiral")
ONE_PLANE = {"six": 90, "8": 45, "12": 30, "24": 15, "tumble": 30, "spiral": 15}
"""Step of each sequence on a table that turns in one plane only, deg."""
ROUNDING = 1e-9  # rad
VISITS = (2, 4, 8, 14)  # of each pose, tried
MOST = 400  # poses that a baseline is tried with


def classic(name: str, table: Table = DUAL) -> Array:
    """Angles of one cycle of a classic sequence, rad, (n, tilting axes), in its customary order.

    ``six``: the faces. ``8``: the corners. ``12``: the edges. ``24``: eight positions every 45 deg
    in three planes. ``tumble``: three planes every 30 deg (IEEE 1293). ``sweep``: 0 to 90 deg and
    back by 10 deg about the first axis. ``two_position``: two poses 180 deg apart about the
    horizontal. ``spiral``: 24 equally spread directions, each from the nearest. A table that cannot
    turn every direction up goes through the positions of one plane; axes that are not needed stay
    at zero.

    Raises:
        TiltcalError: there is no such sequence.
    """
    one_of(name, CLASSIC, "classic sequence")
    if name in ("sweep", "two_position"):
        up = np.arange(0, 91, 10.0)
        first = np.concatenate([up, up[-2::-1]]) if name == "sweep" else np.array([90.0, 270.0])
        return _padded(first[:, None] * DEG, table)
    if table.pointing is None:
        return _padded(np.arange(0.0, 360.0, ONE_PLANE[name])[:, None] * DEG, table)
    if name in ("24", "tumble"):
        return planes(45 if name == "24" else 30, table)
    up = {
        "six": directions("6"),
        "8": directions("8"),
        "12": directions("12"),
        "spiral": sphere(24),
    }[name]
    return angles_of(up if name == "six" else nearest_order(up), table)


def _padded(angles: Array, table: Table) -> Array:
    """Angles of the first axes that tilt, with zeros for the others, (n, tilting axes)."""
    others = np.zeros((len(angles), len(table.tilting) - angles.shape[1]))
    return np.hstack([angles, others])


def planes(step: int, table: Table = DUAL) -> Array:
    """Every ``step`` deg in three planes, rad, (n, tilting axes)."""
    turn = np.arange(0, 360, step)
    assert table.pointing is not None
    if table.pointing[1][1] != "z":  # both axes horizontal at zero
        parts = [
            np.column_stack([0 * turn, turn]),
            np.column_stack([turn, 0 * turn]),
            np.column_stack([turn, 0 * turn + 90]),
        ]
    else:
        parts = [
            np.column_stack([turn, 0 * turn]),
            np.column_stack([turn, 0 * turn + 90]),
            np.column_stack([0 * turn + 90, turn]),
        ]
    return _padded(np.asarray(np.vstack(parts) * DEG, dtype=np.float64), table)


def angles_of(up: Array, table: Table) -> Array:
    """Angles of the axes that tilt, for directions of up on a straight mount, rad, (n, tilting
    axes).

    Args:
        up: (n, 3).
        table: table that takes the poses.
    """
    found = [table_angles(Rig(table=table.name), u, 0, "classic sequence") for u in up]
    return np.array(found)[:, -len(table.tilting) :]


def nearest_order(up: Array) -> Array:
    """Directions reordered so that each is the nearest of those left. up: (n, 3)."""
    left, order = list(range(1, len(up))), [0]
    while left:
        k = max(left, key=lambda i: float(up[i] @ up[order[-1]]))
        left.remove(k)
        order.append(k)
    return up[order]


def baseline(problem: Problem, name: str, table: Table = DUAL) -> Draft:
    """A classic sequence, repeated or shortened to the number of poses that is best for the
    criterion, with equal dwells. Poses that the limits forbid are left out, others are on the
    steps: it obeys the same limits as a plan.
    """
    return best_length(problem, within_limits(classic(name, table), problem.clock))


def best_length(problem: Problem, cycle: Array, every: int = 1) -> Draft:
    """A cycle of poses, repeated or shortened to the number that is best for the criterion, with
    equal dwells; no poses where the budget allows none.

    Args:
        problem: model, clock and criterion.
        cycle: rad, (n, axes).
        every: numbers of poses that are tried: its multiples.
    """
    best = Draft(np.zeros((0, cycle.shape[1])), np.zeros(0))
    for angles in _lengths(problem, cycle, every):
        trial = problem.rated(angles, np.zeros(len(angles)))
        best = trial if trial.value > best.value else best
    return best


def within_limits(cycle: Array, clock: Clock) -> Array:
    """The poses of a cycle that the limits allow, whole turns apart if need be, on the steps of the
    table; rad, (m, axes).

    Args:
        cycle: rad, (n, axes).
        clock: table time and limits.
    """
    found = np.array(cycle, dtype=float)
    kept = np.ones(len(found), dtype=bool)
    for k, pair in enumerate(clock.limits):
        if pair is not None:
            turns = np.round((sum(pair) / 2 - found[:, k]) / (2 * np.pi))
            found[:, k] += 2 * np.pi * turns
            kept &= (found[:, k] >= pair[0] - ROUNDING) & (found[:, k] <= pair[1] + ROUNDING)
    return clock.inside(found[kept])


def dwelling(problem: Problem, table: Table = DUAL) -> list[Draft]:
    """The classic sequences with several short moves at each of their poses, there and back: a pose
    that is taken again has a new floor, and the way to it costs next to nothing.

    Args:
        problem: model, clock and criterion.
        table: table that takes the poses.
    """
    clock, found = problem.clock, {}
    for name in CLASSIC:
        cycle = within_limits(classic(name, table), clock)
        stops = np.unique(np.round(cycle, 9), axis=0) if table.pointing is None else cycle
        for visits in VISITS:
            there = np.repeat(stops, visits, axis=0)
            there[1::2] += clock.nudge * np.where(there[1::2] > _middles(clock), -1, 1)
            around = best_length(problem, clock.inside(np.vstack([there, there[::-1]])), 4)
            if len(around.angles):
                found[around.angles.tobytes()] = around
    return list(found.values())


def _middles(clock: Clock) -> Array:
    """Of the allowed angles, rad, (axes,); where an axis turns without end: no angle is beyond."""
    return np.array([np.inf if pair is None else sum(pair) / 2 for pair in clock.limits])


def _lengths(problem: Problem, cycle: Array, every: int) -> Iterator[Array]:
    """The cycle repeated and cut to every number of poses that fits the budget."""
    if len(cycle) == 0:
        return
    clock = problem.clock
    repeated = unwound(np.tile(cycle, (-(-MOST // len(cycle)), 1)), clock.limits, clock.origin)
    cost = np.cumsum(clock.moves(repeated) + clock.settle + clock.shortest)
    for n in range(every, int(np.searchsorted(cost, clock.budget, side="right")) + 1, every):
        if cost[n - 1] + n * (clock.longest - clock.shortest) >= 0.5 * clock.budget:
            yield repeated[:n]
