"""``tiltcal design``."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Group, Parameter

from tiltcal.cli.axis_limits import axis_limits
from tiltcal.cli.design_options import Aim, BlindToNothing, Separation, Split, TableTime
from tiltcal.cli.options import SEED, EngineName, Jobs, Json
from tiltcal.cli.output import print_json, print_table, progress_line, say
from tiltcal.cli.stage import table_in
from tiltcal.core.claimed_folder import claimed
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import write_json, write_text
from tiltcal.core.tasks.engines import shared_engine
from tiltcal.core.units import DEG, G0
from tiltcal.design.feasibility import check_possible
from tiltcal.design.gradient_search import Problem
from tiltcal.design.plan import Plan
from tiltcal.design.plan import design as find_plan
from tiltcal.design.polynomial import textbook_model
from tiltcal.design.static_instrument import Still
from tiltcal.design.steps import designed_table, printable, segments_csv, steps_csv, steps_of
from tiltcal.design.terms import Wanted, scenario_model
from tiltcal.design.time_budget import Clock
from tiltcal.effects.sensor.noise import AccNoise
from tiltcal.laboratory.scenario import Scenario, load_scenario, parse_scenario
from tiltcal.report.design import poses_of_plan, write_design
from tiltcal.setup.sensor import Sensor
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
    blind_to_nothing: Annotated[BlindToNothing, Parameter(group=OTHER_DESIGN)] = None,
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
      tiltcal design --textbook quadratic --budget-s 300
      tiltcal design --split out/diagnosis.json --scenario bench.toml -o next

    The last one writes sequence.csv and next_block.json.
    """
    if split is not None:
        from tiltcal.cli.separating_block import design_separating_block

        return design_separating_block(split, scenario_file, separation, table, output, as_json)
    scenario = _scenario_of(scenario_file, aim)
    if blind_to_nothing is not None:
        from tiltcal.cli.maxmin_design import design_visible_poses

        wanted = (blind_to_nothing, aim, table, seed)
        with shared_engine(engine, jobs) as opened:
            return design_visible_poses(scenario, *wanted, opened, output, as_json)
    clock = clock_of(table, scenario)
    still = Still(scenario, clock.budget)
    problem, unseen = problem_of(aim, table, scenario, clock)
    untold = check_possible(problem, still.axes, everything="all" in aim.terms)
    with claimed(output):
        with progress_line() as notice, shared_engine(engine, jobs) as opened:
            plan = find_plan(problem, scenario.rig.kind, seed, notice=notice, engine=opened)
        up = still.up(plan.angles)
        if output:
            write_plan(plan, scenario, up, output)
            poses = poses_of_plan(plan, up, scenario)
            table_plot = table_in(poses, scenario)
            missing = _missing(unseen, untold)
            write_design(plan, output / "report.html", scenario.name, poses, table_plot, missing)
    if as_json:
        print_json(plan.to_json() | {"unseen": list(unseen), "untold": list(untold)})
    else:
        show(plan, up, unseen)
        if untold:
            say("not separable from the other terms by these poses: " + ", ".join(untold))
    return 0


def _missing(unseen: Sequence[str], untold: Sequence[str]) -> list[str]:
    """What no pose of a design shows or separates, a sentence each."""
    return [
        *(f"{name}: not visible in any pose." for name in unseen),
        *(f"{name}: not separable from the other terms by these poses." for name in untold),
    ]


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


def clock_of(table: TableTime, scenario: Scenario) -> Clock:
    """Speed, times and limits of the table."""
    axes = Still(scenario, table.budget_s).axes
    limits = {
        axis: (low * DEG, high * DEG)
        for axis, (low, high) in axis_limits(table.angles, axes).items()
    }
    return Clock(
        table.budget_s,
        table.rate_deg_s * DEG,
        table.settle_s,
        *table.dwell_s,
        tuple(limits.get(name) for name in axes),
        table.step_deg * DEG,
    )


def problem_of(
    aim: Aim, table: TableTime, scenario: Scenario, clock: Clock
) -> tuple[Problem, tuple[str, ...]]:
    """The design problem, and the effects that poses cannot show."""
    nuisance = tuple(n for n in aim.nuisance if n != "none")
    if aim.textbook is not None:
        model = textbook_model(aim.textbook, "drift" in nuisance, clock.budget)
        return Problem(model, clock, aim.criterion), ()
    sensor = sensor_of(scenario, aim.sensor)
    terms = aim.terms or (
        *sensor.adjustable,
        *(t.id for t in scenario.effect if t.fit and t.sensor in (None, sensor.name)),
    )
    wanted = Wanted(
        terms or ("bias", "scale", "cross_axis"),
        nuisance,
        aim.grade,
        aim.prior,
        table.floor_ug * 1e-6 * G0,
        aim.range_deg * DEG,
    )
    model, unseen = scenario_model(scenario, sensor, wanted, clock.budget)
    return Problem(model, clock, aim.criterion), unseen


def sensor_of(scenario: Scenario, wanted: str | None) -> Sensor:
    """The accelerometer or inclinometer to design for.

    Raises:
        TiltcalError: there is none.
    """
    fitting = [s for s in scenario.sensor if s.is_accelerometer and wanted in (None, s.name)]
    if not fitting:
        raise TiltcalError(
            f"scenario {scenario.name}",
            found=(f"no accelerometer or inclinometer{f' named {wanted}' if wanted else ''}"),
            need="an accelerometer or inclinometer: dwells measure only gravity",
            do="add one, or correct --sensor (a gyro is calibrated by turns)",
        )
    return fitting[0]


def write_plan(
    plan: Plan,
    scenario: Scenario,
    up: "np.ndarray[tuple[int, int], np.dtype[np.float64]]",
    folder: Path,
) -> None:
    """Write design.toml, steps.csv, steps.txt, segments.csv and design.json to a folder."""
    import tomli_w

    steps = steps_of(plan, up)
    write_text(
        folder / "design.toml",
        tomli_w.dumps(designed_table(scenario, steps, f"{scenario.name}, designed")),
    )
    write_text(folder / "steps.csv", steps_csv(steps))
    write_text(folder / "steps.txt", printable(plan, up))
    write_text(folder / "segments.csv", segments_csv(plan))
    write_json(folder / "design.json", plan.to_json())


def show(
    plan: Plan, up: "np.ndarray[tuple[int, int], np.dtype[np.float64]]", unseen: tuple[str, ...]
) -> None:
    """Print the steps, and the forecasts of this design and of classic sequences."""
    say(printable(plan, up))
    forecast = plan.forecast
    rows = [
        ["this design", f"{forecast.nats:.2f}", f"{forecast.tilt_arcsec:.3f}", str(forecast.poses)]
    ]
    rows += [
        [name, f"{f.nats:.2f}", f"{f.tilt_arcsec:.3f}", str(f.poses)]
        for name, f in plan.baselines.items()
    ]
    print_table(["same table time", "nats", "tilt arcsec", "poses"], rows)
    if not plan.problem.model.interest.all():
        say(
            "the sigmas hold for a fit of all these terms including nuisances: calibrate with terms"
            " that include the drift"
        )
    if unseen:
        say("not visible in any pose: " + ", ".join(unseen))
