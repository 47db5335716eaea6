"""``tiltcal design``; with ``--all-effects-observable`` poses in which every effect is visible,
with ``--split`` the block that separates the alternatives of a diagnosis.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Group, Parameter

from tiltcal.api.designing import DesignedSequence, designed_for_goals
from tiltcal.api.diagnosing import load_nominal_scenario
from tiltcal.api.table_scene import table_in
from tiltcal.cli.design_options import (
    Aim,
    AllEffectsObservable,
    Separation,
    Split,
    TableTime,
    within_options,
)
from tiltcal.cli.options import SEED, EngineName, Jobs, Json
from tiltcal.cli.output import (
    paragraph,
    print_json,
    print_line,
    print_note,
    print_table,
    progress_line,
)
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import claimed, make_folder, require_file, write_json, write_text
from tiltcal.core.read_back import read_toml
from tiltcal.core.tasks.engines import Engine, shared_engine
from tiltcal.core.units import DEG, G0
from tiltcal.design.gradient_search import Problem
from tiltcal.design.maxmin import REQUIRED, MaxMin, grid_of_poses, maximise_least_visibility
from tiltcal.design.plan import Forecast, Plan
from tiltcal.design.polynomial import textbook_model
from tiltcal.design.scenario_problem import clock_of, scenario_problem, sensor_of
from tiltcal.design.signatures import catalogue_signatures
from tiltcal.design.static_instrument import Still
from tiltcal.design.steps import printable, write_plan
from tiltcal.design.terms import Wanted
from tiltcal.design.time_budget import Clock
from tiltcal.diagnosis.investigation.investigate import AMENDED
from tiltcal.diagnosis.investigation.next_block import Limits, NextBlock, next_block
from tiltcal.diagnosis.investigation.stored import read_diagnosis
from tiltcal.effects import CATALOGUE
from tiltcal.effects.sensor.noise import AccNoise
from tiltcal.laboratory.scenario import Scenario, load_scenario, parse_scenario
from tiltcal.recordings.recording_files import read_recording
from tiltcal.report.design import poses_of_plan, write_separating_block, write_visible_poses
from tiltcal.report.poses import Pose, poses_of_steps
from tiltcal.setup.sequence_files import sequence_text
from tiltcal.setup.setup import Rig
from tiltcal.setup.tables import DUAL

AIM = Parameter(name="*", group=Group("Aim", sort_key=1))
TABLE_TIME = Parameter(name="*", group=Group("Table and readings", sort_key=2))
OTHER_DESIGN = Group("Other designs", sort_key=3)
DEFAULT_AIM = Aim()
DEFAULT_TABLE_TIME = TableTime()
DEFAULT_SEPARATION = Separation()
TEXTBOOK = {
    "schema": 1,
    "name": "textbook triad on a dual table",
    "site": {"gravity_m_s2": G0},
    "rig": {"table": DUAL.name},
    "sensor": [
        {
            "name": "accel",
            "kind": "accelerometer",
            "rate_hz": 100,
            "adjustable": ["bias", "scale", "cross_axis"],
        }
    ],
    "effect": [{"id": AccNoise.id, "white_ug_rthz": 100.0}],
}


def design(
    scenario_file: Annotated[
        Path | None,
        Parameter("SCENARIO", help="Scenario with site, rig, sensors, noise and climate."),
    ] = None,
    /,
    *,
    seed: Annotated[int, SEED, Parameter(help="Seed of the search.")] = 0,
    aim: Annotated[Aim, AIM] = DEFAULT_AIM,
    table: Annotated[TableTime, TABLE_TIME] = DEFAULT_TABLE_TIME,
    all_effects_observable: Annotated[AllEffectsObservable, Parameter(group=OTHER_DESIGN)] = None,
    split: Annotated[Split, Parameter(group=OTHER_DESIGN)] = None,
    separation: Annotated[Separation, Parameter(name="*", group=OTHER_DESIGN)] = DEFAULT_SEPARATION,
    output: Annotated[Path | None, Parameter(alias="-o", help="Folder for the plan.")] = None,
    jobs: Jobs = 1,
    engine: EngineName = "processes",
    as_json: Json = False,
) -> int:
    """Find the sequence of poses with the most information per table time.

    Writes design.toml (for `tiltcal simulate`), steps.csv (for a laboratory),
    steps.txt, segments.csv, design.json and report.html to the folder of -o. By default the
    terms are those of the sensors' adjustable lists and of [[effect]] tables with
    fit = true.

      tiltcal design bench.toml --budget-s 300 -o out
      tiltcal design bench.toml --terms bias scale K2 --angles outer=-90:90
      tiltcal design bench.toml --terms all --nuisance drift table_levelling
      tiltcal design bench.toml --budget-s 3600 --goal accel.bias=30ug U=0.01deg
      tiltcal design --textbook quadratic --budget-s 300
      tiltcal design --split out/diagnosis.json --scenario bench.toml -o next

    The last one writes sequence.csv, next_block.json and report.html.
    """
    if split is not None:
        asked = (split, scenario_file, separation, table)
        with shared_engine(engine, jobs) as opened:
            return design_separating_block(*asked, opened, output, as_json)
    scenario = within_options(_scenario_of(scenario_file, aim), table.angles, table.start)
    if all_effects_observable is not None:
        wanted = (all_effects_observable, aim, table, seed)
        with shared_engine(engine, jobs) as opened:
            return design_visible_poses(scenario, *wanted, opened, output, as_json)
    sensor = sensor_of(scenario, aim.sensor)
    seen = scenario.seen_by(sensor)

    def problem_in(time: float) -> tuple[Problem, tuple[str, ...]]:
        within = replace(table, budget_s=time)
        return problem_of(aim, within, seen, clock_given(within, seen))

    with claimed(output):
        with progress_line() as notice, shared_engine(engine, jobs) as opened:
            found = designed_for_goals(
                scenario,
                sensor,
                problem_in,
                table.budget_s,
                aim.goal,
                everything="all" in aim.terms,
                seed=seed,
                progress=notice,
                engine=opened,
            )
        if output:
            found.save(output)
    if as_json:
        print_json(found.to_json())
    else:
        show(found)
    return 0 if found.reaches_goals else 1


def _scenario_of(path: Path | None, aim: Aim) -> Scenario:
    if path is not None:
        return load_scenario(path)
    if aim.textbook is not None:
        return parse_scenario(TEXTBOOK)
    raise TiltcalError(
        "command line of `tiltcal design`",
        found="neither SCENARIO nor --textbook",
        need="an instrument to design for",
        do="name a scenario (`tiltcal init -o bench.toml` writes one)",
    )


def clock_given(table: TableTime, scenario: Scenario) -> Clock:
    """Speed, times and limits of the table, as the options state them."""
    return clock_of(
        scenario,
        table.budget_s,
        table.rate_deg_s,
        table.settle_s,
        table.dwell_s,
        None,
        table.step_deg,
        table.home,
    )


def problem_of(
    aim: Aim, table: TableTime, scenario: Scenario, clock: Clock
) -> tuple[Problem, tuple[str, ...]]:
    """The design problem, and the effects that poses cannot show."""
    nuisance = tuple(n for n in aim.nuisance if n != "none")
    if aim.textbook is not None:
        model = textbook_model(aim.textbook, "drift" in nuisance, clock.budget)
        return Problem(model, clock, aim.criterion), ()
    wanted = Wanted(
        aim.terms,
        nuisance,
        aim.grade,
        aim.prior,
        table.floor_ug * 1e-6 * G0,
        aim.range_deg * DEG,
    )
    return scenario_problem(scenario, sensor_of(scenario, aim.sensor), wanted, clock, aim.criterion)


def show(found: DesignedSequence) -> None:
    """Print the steps, and the forecasts of this design and of classic sequences."""
    print_line(str(found))
    forecast = found.plan.forecast
    rows = [["this design", *_figures(forecast), "all"]]
    for name, (inside, every) in found.plan.allowed.items():
        of_it = found.plan.baselines.get(name)
        figures = ["-"] * 3 if of_it is None else _figures(of_it)
        rows.append([name, *figures, "all" if inside == every else f"{inside} of {every}"])
    header = ["same table time", "nats", "tilt arcsec", "poses", "within the limits"]
    print_table(header, rows, spare=header[-1:])
    if not found.plan.problem.model.interest.all():
        paragraph(
            "the sigmas hold for a fit of all these terms including nuisances: calibrate with terms"
            " that include the drift"
        )
    if not found.plan.redundant:
        paragraph(
            "a fit of all these terms has no reading left to be judged by, and its verdict will be"
            " cannot_tell: allow more table time, or fit fewer terms"
        )
    if found.unseen:
        paragraph("not visible in any pose: " + ", ".join(found.unseen))
    if found.inseparable:
        names = ", ".join(found.inseparable)
        paragraph(f"not separable from the other terms by these poses: {names}")


def _figures(forecast: Forecast) -> list[str]:
    return [f"{forecast.nats:.2f}", f"{forecast.tilt_arcsec:.3f}", str(forecast.poses)]


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
        found = maximise_least_visibility(
            seen, clock, count, seed, engine=engine, progress=progress
        )
    if found.shares.min() < SEEN:
        _refuse(
            count,
            "more",
            f"they do not show_visible_poses {seen.names[int(found.shares.argmin())]}",
        )
    problem, _ = problem_of(replace(aim, terms=()), table, at_sensor, clock)
    plan = timed(found, problem, still.axes)
    up = still.up(plan.angles)
    if output:
        folder = make_folder(output)
        write_plan(plan, scenario, up, folder, printable(plan, up), plan.to_json())
        poses = poses_of_plan(plan, up, scenario)
        page, table_shown = folder / "report.html", table_in(poses, scenario)
        missing = by_need(found)
        write_visible_poses(found, plan, page, scenario.name, poses, table_shown, missing)
    if as_json:
        print_json(plan.to_json() | summary(found))
    else:
        print_line(printable(plan, up))
        show_visible_poses(found)
    return 0


def show_visible_poses(found: MaxMin) -> None:
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
    """Effects that neither the poses nor their order show_visible_poses, by what excites them."""
    excited: dict[str, list[str]] = {}
    for name in unseen(found):
        excited.setdefault(CATALOGUE[name.split()[0]].excited_by, []).append(name)
    return excited


def unseen(found: MaxMin) -> list[str]:
    """Effects that neither the poses nor their order show_visible_poses."""
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
        "design --all-effects-observable",
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


def design_separating_block(
    split: Path,
    scenario_file: Path | None,
    wanted: Separation,
    table: TableTime,
    engine: Engine | None,
    output: Path | None,
    as_json: bool,
) -> int:
    """Propose the block that separates the alternatives of the diagnosis ``split``.

    Raises:
        TiltcalError: the scenario, the diagnosis or its recordings are missing.
    """
    described = wanted.diagnosed or scenario_file
    if described is None:
        raise TiltcalError(
            "command line of `tiltcal design`",
            found="--split without a scenario",
            need="the scenario that was diagnosed",
            do="add --scenario TOML",
        )
    nominal = load_nominal_scenario(described)
    scenario = within_options(nominal, table.angles, table.start)
    diagnosis = read_diagnosis(split)
    amended = require_file(split.with_name("amended.toml"), "amended scenario")
    data = [read_recording(p) for p in _recordings_of(diagnosis, split, wanted.recordings)]
    limits = Limits(
        table.budget_s / 60,
        table.rate_deg_s,
        table.dwell_s[0],
        slide_rate=wanted.rate_mm_s,
    )
    with progress_line() as progress:
        amended_table = read_toml(amended, "amended scenario", AMENDED)
        plan = next_block(scenario, data, diagnosis, amended_table, limits, progress, engine)
    if output:
        _write(plan, scenario, make_folder(output))
    _show(plan, scenario.rig, output, as_json)
    return 0 if plan.proposal is not None else 1


def _write(plan: NextBlock, scenario: Scenario, folder: Path) -> None:
    write_json(folder / "next_block.json", plan.to_json())
    poses: list[Pose] = []
    if plan.proposal is not None:
        steps = plan.proposal.block.steps
        write_text(folder / "sequence.csv", sequence_text(steps, scenario.rig))
        poses = poses_of_steps(steps, scenario, "proposed block")
    table = table_in(poses, scenario)
    write_separating_block(plan, folder / "report.html", scenario, scenario.name, poses, table)


def _show(plan: NextBlock, rig: Rig, output: Path | None, as_json: bool) -> None:
    if as_json:
        print_json(plan.to_json())
        return
    if output:
        paragraph(plan.statement)
    else:
        print_note(plan.statement)
    if plan.proposal is not None and not output:
        print_line(sequence_text(plan.proposal.block.steps, rig).rstrip("\n"))


def _recordings_of(diagnosis: dict[str, Any], path: Path, given: Sequence[Path]) -> list[Path]:
    """The recordings that were diagnosed: the given ones, or those the diagnosis names.

    Raises:
        TiltcalError: neither names any.
    """
    if given:
        return list(given)
    named = [Path(p) for p in diagnosis.get("recordings", [])]
    if not named:
        raise TiltcalError(
            f"diagnosis {path.name}",
            found="no recordings in it",
            need="those that were diagnosed",
            do="add --recordings REC ...",
        )
    return named
