"""``tiltcal design``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Group, Parameter

from tiltcal.api.designing import DesignedSequence, designed
from tiltcal.cli.axis_limits import axis_limits
from tiltcal.cli.design_options import Aim, BlindToNothing, Separation, Split, TableTime
from tiltcal.cli.options import SEED, EngineName, Jobs, Json
from tiltcal.cli.output import paragraph, print_json, print_table, progress_line, say
from tiltcal.core.claimed_folder import claimed
from tiltcal.core.errors import TiltcalError
from tiltcal.core.tasks.engines import shared_engine
from tiltcal.core.units import DEG, G0
from tiltcal.design.gradient_search import Problem
from tiltcal.design.polynomial import textbook_model
from tiltcal.design.scenario_problem import clock_of, scenario_problem, sensor_of
from tiltcal.design.static_instrument import Still
from tiltcal.design.terms import Wanted
from tiltcal.design.time_budget import Clock
from tiltcal.effects.sensor.noise import AccNoise
from tiltcal.laboratory.scenario import Scenario, load_scenario, parse_scenario
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

    The last one writes sequence.csv, next_block.json and report.html.
    """
    if split is not None:
        from tiltcal.cli.separating_block import design_separating_block

        asked = (split, scenario_file, separation, table)
        with shared_engine(engine, jobs) as opened:
            return design_separating_block(*asked, opened, output, as_json)
    scenario = _scenario_of(scenario_file, aim)
    if blind_to_nothing is not None:
        from tiltcal.cli.maxmin_design import design_visible_poses

        wanted = (blind_to_nothing, aim, table, seed)
        with shared_engine(engine, jobs) as opened:
            return design_visible_poses(scenario, *wanted, opened, output, as_json)
    sensor = sensor_of(scenario, aim.sensor)
    seen = scenario.seen_by(sensor)
    problem, unseen = problem_of(aim, table, seen, clock_given(table, seen))
    with claimed(output):
        with progress_line() as notice, shared_engine(engine, jobs) as opened:
            everything = "all" in aim.terms
            found = designed(scenario, sensor, problem, unseen, everything, seed, notice, opened)
        if output:
            found.save(output)
    if as_json:
        untold = list(found.inseparable)
        print_json(found.plan.to_json() | {"unseen": list(unseen), "untold": untold})
    else:
        show(found)
    return 0


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
    axes = Still(scenario, table.budget_s).axes
    return clock_of(
        scenario,
        table.budget_s,
        table.rate_deg_s,
        table.settle_s,
        table.dwell_s,
        axis_limits(table.angles, axes),
        table.step_deg,
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
    say(str(found))
    forecast = found.plan.forecast
    rows = [
        ["this design", f"{forecast.nats:.2f}", f"{forecast.tilt_arcsec:.3f}", str(forecast.poses)]
    ]
    rows += [
        [name, f"{f.nats:.2f}", f"{f.tilt_arcsec:.3f}", str(f.poses)]
        for name, f in found.plan.baselines.items()
    ]
    print_table(["same table time", "nats", "tilt arcsec", "poses"], rows)
    if not found.plan.problem.model.interest.all():
        paragraph(
            "the sigmas hold for a fit of all these terms including nuisances: calibrate with terms"
            " that include the drift"
        )
    if found.unseen:
        paragraph("not visible in any pose: " + ", ".join(found.unseen))
    if found.inseparable:
        names = ", ".join(found.inseparable)
        paragraph(f"not separable from the other terms by these poses: {names}")
