"""Requirements that no sequence can meet, reported with the parameter named."""

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import DEG
from tiltcal.design.gradient_search import Problem
from tiltcal.design.pose_grids import grid, spread

DETERMINED = 0.9  # posterior over prior that counts as separated, when noise is no limit
QUIET = 1e6  # how much quieter than real the instrument is when only the poses are judged
GRID = 15 * DEG
GRID_AXES, SPREAD = 3, 24**3  # most axes of the grid, and poses that stand for those of more


def check_possible(
    problem: Problem, axes: tuple[str, ...], everything: bool = False
) -> tuple[str, ...]:
    """Refuse what cannot be had; with ``everything`` wished for at once, the names of what will
    stay undetermined.

    Raises:
        TiltcalError: the budget is shorter than one pose; or a parameter of interest is not
            determined by any set of poses, or not by those that the table's limits allow.
    """
    clock = problem.clock
    least = clock.settle + clock.shortest
    if clock.budget < least:
        raise TiltcalError(
            "design, budget",
            found=f"{clock.budget:g} s",
            need=(
                f"{least:g} s for one pose ({clock.settle:g} s to settle, {clock.shortest:g} s to"
                f" read) before anything is known of {_first_wanted(problem)}"
            ),
            do="allow more table time",
        )
    model = problem.model
    free = _undetermined(problem, every_pose(problem, limited=False))
    if everything:
        return tuple(
            model.names[i] for i in _undetermined(problem, every_pose(problem, limited=True))
        )
    if len(free):
        _refuse(
            model.names[free[0]],
            len(free),
            "no set of poses separates it from the other terms",
            "leave it out, or name as --nuisance what it is confused with",
        )
    held = _undetermined(problem, every_pose(problem, limited=True))
    if len(held):
        where = needed_pose(problem, int(held[0]))
        angles = ", ".join(
            f"{name} {a / DEG:+.0f} deg" for name, a in zip(axes, where, strict=True)
        )
        _refuse(
            model.names[held[0]],
            len(held),
            f"no pose within the allowed angles determines it; it needs poses such as {angles}",
            "widen --angles",
        )
    return ()


def _refuse(name: str, count: int, found: str, do: str) -> None:
    more = f" (and {count - 1} more)" if count > 1 else ""
    raise TiltcalError(
        f"design, {name}{more}", found=found, need="a sequence that can determine it", do=do
    )


def _first_wanted(problem: Problem) -> str:
    return problem.model.names[int(np.flatnonzero(problem.model.interest)[0])]


def every_pose(problem: Problem, limited: bool) -> Array:
    """A dense set of poses, rad, (n, axes); ``limited``: those that are allowed."""
    limits = problem.clock.limits if limited else (None,) * len(problem.clock.limits)
    return grid(limits, GRID, 0.03) if len(limits) <= GRID_AXES else spread(limits, SPREAD)


def _undetermined(problem: Problem, angles: Array) -> "np.ndarray[tuple[int], np.dtype[np.intp]]":
    """Parameters of interest that all these poses, read by a nearly noiseless instrument, leave as
    they were.
    """
    model, clock = problem.model, problem.clock
    rng = np.random.default_rng(0)
    time = rng.uniform(0, clock.budget, len(angles))
    rows = model.rows(angles, time) / (model.white / np.sqrt(clock.longest))[:, None] * QUIET
    flat = rows.reshape(-1, len(model.names))
    values, vectors = np.linalg.eigh(flat.T @ flat)
    seen = values > 1e-9 * values[-1]
    # share of each parameter in directions without information
    left = 1 - (vectors[:, seen] ** 2).sum(axis=1)
    return np.flatnonzero((left > 1 - DETERMINED**2) & model.interest)


def needed_pose(problem: Problem, index: int) -> Array:
    """A pose beyond the limits that shows most of a parameter that the allowed poses do not show,
    rad, (axes,).
    """
    model = problem.model
    inside, everywhere = every_pose(problem, True), every_pose(problem, False)
    middle = problem.clock.budget / 2
    known = model.rows(inside, np.full(len(inside), middle)).reshape(-1, len(model.names))
    _, s, Vt = np.linalg.svd(known, full_matrices=True)
    rank = int(np.sum(s > 1e-6 * s[0]))
    hidden = Vt[rank:]  # combinations that the allowed poses leave open
    direction = hidden.T @ (hidden @ np.eye(len(model.names))[index])
    shown = model.rows(everywhere, np.full(len(everywhere), middle)) @ direction
    return np.asarray(everywhere[int(np.argmax((shown**2).sum(axis=1)))])
