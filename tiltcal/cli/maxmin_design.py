"""``tiltcal design --blind-to-nothing``."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from tiltcal.api.table_scene import table_in
from tiltcal.cli.design import clock_given, problem_of
from tiltcal.cli.design_options import Aim, TableTime
from tiltcal.cli.output import paragraph, print_json, print_table, progress_line, say
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import make_folder
from tiltcal.core.tasks.engines import Engine
from tiltcal.design.gradient_search import Problem
from tiltcal.design.maxmin import REQUIRED, MaxMin, blind_to_nothing, grid_of_poses
from tiltcal.design.plan import Plan
from tiltcal.design.scenario_problem import sensor_of
from tiltcal.design.signatures import catalogue_signatures
from tiltcal.design.static_instrument import Still
from tiltcal.design.steps import printable, write_plan
from tiltcal.design.time_budget import Clock
from tiltcal.effects import CATALOGUE
from tiltcal.laboratory.scenario import Scenario
from tiltcal.report.design import poses_of_plan
from tiltcal.report.visible_poses import write_visible_poses

SEEN = 0.002  # smallest share at which an effect counts as visible


def design_visible_poses(
    scenario: Scenario,
    count: int,
    aim: Aim,
    table: TableTime,
    seed: int,
    engine: Engine | None,
    output: Path | None,
    as_json: bool,
) -> int:
    """Find ``count`` poses for which the least visible effect is as visible as possible."""
    sensor = sensor_of(scenario, aim.sensor)
    at_sensor = scenario.seen_by(sensor)
    clock = clock_given(table, at_sensor)
    _check_budget(clock, count * (clock.settle + clock.shortest), count)
    still = Still(at_sensor, clock.budget)
    wanted = () if "all" in aim.terms else aim.terms
    seen = catalogue_signatures(still, sensor, grid_of_poses(clock), aim.grade, wanted)
    terms = 1 + seen.spanned.shape[1]
    if count <= terms:
        _refuse(count, f"more than {terms}", "bias, scale and cross-axis terms absorb all of them")
    with progress_line() as progress:
        found = blind_to_nothing(seen, clock, count, seed, engine=engine, progress=progress)
    if found.shares.min() < SEEN:
        _refuse(count, "more", f"they do not show {seen.names[int(found.shares.argmin())]}")
    problem, _ = problem_of(replace(aim, terms=()), table, at_sensor, clock)
    plan = timed(found, problem, still.axes)
    up = still.up(plan.angles)
    if output:
        folder = make_folder(output)
        write_plan(plan, scenario, up, folder)
        poses = poses_of_plan(plan, up, scenario)
        page, table_shown = folder / "report.html", table_in(poses, scenario)
        missing = by_need(found)
        write_visible_poses(found, plan, page, scenario.name, poses, table_shown, missing)
    if as_json:
        print_json(plan.to_json() | summary(found))
    else:
        say(printable(plan, up))
        show(found)
    return 0


def show(found: MaxMin) -> None:
    """Print the shares, their bounds, and the effects that stay invisible."""
    seen = found.seen
    rows = [
        [name, f"{share:.3f}", "poses"]
        for name, share in zip(seen.names, found.shares, strict=True)
    ]
    rows += [[name, f"{share:.3f}", "order"] for name, share in found.in_order.items()]
    print_table(["effect", "share of the best possible", "shown by"], rows)
    paragraph(
        f"least share {found.shares.min():.4f}; no design exceeds {found.bounds[0]:.4f}, none that"
        f" keeps {100 * REQUIRED:g} % of the linear D-efficiency {found.bounds[1]:.4f} (convex"
        f" bounds over a dense set of poses; references within {100 * found.reference_gap:.2f} %);"
        f" D-efficiency of the linear terms {100 * found.efficiency:.2f} %"
    )
    ordinary = ", ".join(seen.ordinary) or "none"
    paragraph(f"absorbed by bias, scale and cross-axis terms: {ordinary}")
    paragraph("not visible in any sequence of dwells here:")
    for needs, names in by_need(found).items():
        paragraph(f"  {', '.join(names)}: needs {needs}")


def by_need(found: MaxMin) -> dict[str, list[str]]:
    """Effects that neither the poses nor their order show, by what excites them."""
    excited: dict[str, list[str]] = {}
    for name in unseen(found):
        excited.setdefault(CATALOGUE[name.split()[0]].excited_by, []).append(name)
    return excited


def unseen(found: MaxMin) -> list[str]:
    """Effects that neither the poses nor their order show."""
    seen = found.seen
    return sorted({*seen.unseen, *seen.in_order} - {*found.in_order, *seen.names, *seen.ordinary})


def timed(found: MaxMin, problem: Problem, axes: tuple[str, ...]) -> Plan:
    """The poses with equal dwells that fill the budget.

    Raises:
        TiltcalError: the budget is too short.
    """
    clock = problem.clock
    _check_budget(clock, clock.budget - float(clock.spare(found.angles)), len(found.angles))
    return Plan(
        problem, found.angles, problem.dwells(found.angles, np.zeros(len(found.angles))), axes, {}
    )


def _refuse(count: int, need: str, why: str) -> None:
    raise TiltcalError(
        "design --blind-to-nothing",
        found=f"{count} poses",
        need=f"{need}: {why}",
        do="allow more poses",
    )


def _check_budget(clock: Clock, needed: float, count: int) -> None:
    """Refuse a budget that is too short for the poses."""
    if needed > clock.budget:
        raise TiltcalError(
            "design, budget",
            found=f"{clock.budget:g} s",
            need=f"{needed:.0f} s or more for {count} poses",
            do="raise --budget-s",
        )


def summary(found: MaxMin) -> dict[str, object]:
    """The shares and bounds as JSON."""
    return {
        "shares": dict(zip(found.seen.names, map(float, found.shares), strict=True)),
        "in_order": found.in_order,
        "least_share": float(found.shares.min()),
        "bound": found.bounds[0],
        "bound_at_d_efficiency": found.bounds[1],
        "reference_gap": found.reference_gap,
        "d_efficiency": found.efficiency,
        "taken_up": list(found.seen.ordinary),
        "unseen": unseen(found),
    }
