"""``tiltcal design``."""

import argparse
from pathlib import Path

import numpy as np

from tiltcal.cli.output import print_json, print_table, progress_line
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import make_folder, write_json, write_text
from tiltcal.core.units import DEG, G0
from tiltcal.design.feasibility import check_possible
from tiltcal.design.gradient_search import Problem
from tiltcal.design.plan import Plan, design
from tiltcal.design.polynomial import textbook_model
from tiltcal.design.static_instrument import Still
from tiltcal.design.steps import designed_table, printable, segments_csv, steps_csv, steps_of
from tiltcal.design.terms import Wanted, scenario_model
from tiltcal.design.time_budget import Clock
from tiltcal.effects.sensor.noise import AccNoise
from tiltcal.laboratory.scenario import Scenario, load_scenario, parse_scenario
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.tables import DUAL

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


def design_(args: argparse.Namespace) -> int:
    """The sequence with the most information for a table time, or the block that splits rivals."""
    if args.split is not None:
        from tiltcal.cli.investigating import split

        return split(args)
    if args.scenario is None and args.textbook is None:
        raise TiltcalError(
            "command line of `tiltcal design`",
            found="neither SCENARIO nor --textbook",
            need="what the sequence is for",
            do="name a scenario (`tiltcal init -o bench.toml` writes one)",
        )
    scenario = load_scenario(args.scenario) if args.scenario else parse_scenario(TEXTBOOK)
    clock = clock_of(args, scenario)
    if args.blind_to_nothing is not None:
        from tiltcal.cli.maxmin import blind_to_nothing_

        return blind_to_nothing_(args, scenario, clock)
    still = Still(scenario, clock.budget)
    problem, unseen = problem_of(args, scenario, clock)
    untold = check_possible(problem, still.axes, everything="all" in args.terms)
    with progress_line() as notice:
        plan = design(problem, scenario.rig.kind, args.seed, notice=notice)
    up = still.up(plan.angles)
    if args.output:
        write_plan(plan, scenario, up, make_folder(Path(args.output)))
    if args.json:
        print_json(plan.to_json() | {"unseen": list(unseen), "untold": list(untold)})
    else:
        show(plan, up, unseen)
        if untold:
            print("no set of these poses tells from the other terms: " + ", ".join(untold))
    return 0


def clock_of(args: argparse.Namespace, scenario: Scenario) -> Clock:
    """The table's speed and limits from the command line."""
    axes = Still(scenario, args.budget).axes
    limits: dict[str, tuple[float, float]] = {}
    for text in args.angles:
        name, equals, span = text.partition("=")
        low, colon, high = span.partition(":")
        try:
            limits[name] = (float(low) * DEG, float(high) * DEG)
        except ValueError:
            equals = ""
        if not equals or not colon or name not in axes:
            raise TiltcalError(
                f"--angles {text}",
                found="no AXIS=LOW:HIGH",
                need=f"for example {axes[0]}=-90:90, an axis among {', '.join(axes)}",
                do="correct it",
            )
    return Clock(
        args.budget,
        args.rate_deg_s * DEG,
        args.settle_s,
        args.dwell_s[0],
        args.dwell_s[1],
        tuple(limits.get(name) for name in axes),
        args.step_deg * DEG,
    )


def problem_of(
    args: argparse.Namespace, scenario: Scenario, clock: Clock
) -> tuple[Problem, tuple[str, ...]]:
    """What is to be designed, and the effects that poses cannot tell."""
    nuisance = tuple(n for n in args.nuisance if n != "none")
    if args.textbook is not None:
        return (
            Problem(
                textbook_model(args.textbook, "drift" in nuisance, clock.budget),
                clock,
                args.criterion,
            ),
            (),
        )
    sensor = sensor_of(args, scenario)
    terms = tuple(args.terms) or (
        *sensor.adjustable,
        *(t.id for t in scenario.effect if t.fit and t.sensor in (None, sensor.name)),
    )
    wanted = Wanted(
        terms or ("bias", "scale", "cross_axis"),
        nuisance,
        args.grade,
        args.prior,
        args.floor_ug * 1e-6 * G0,
        args.range_deg * DEG,
    )
    model, unseen = scenario_model(scenario, sensor, wanted, clock.budget)
    return Problem(model, clock, args.criterion), unseen


def sensor_of(args: argparse.Namespace, scenario: Scenario) -> Sensor:
    """The accelerometer or inclinometer to design for.

    Raises:
        TiltcalError: there is none.
    """
    fitting = [s for s in scenario.sensor if s.is_accelerometer and args.sensor in (None, s.name)]
    if not fitting:
        raise TiltcalError(
            f"scenario {scenario.name}",
            found=(
                f"no accelerometer or inclinometer{f' named {args.sensor}' if args.sensor else ''}"
            ),
            need="one: poses tell what follows gravity",
            do="add one, or correct --sensor (a gyro is calibrated by turns)",
        )
    return fitting[0]


def write_plan(
    plan: Plan,
    scenario: Scenario,
    up: "np.ndarray[tuple[int, int], np.dtype[np.float64]]",
    folder: Path,
) -> None:
    """design.toml, steps.csv, steps.txt, segments.csv and design.json in a folder."""
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
    """The list for people, and the classic sequences beside it."""
    print(printable(plan, up))
    what = plan.forecast
    rows = [["this design", f"{what.nats:.2f}", f"{what.tilt_arcsec:.3f}", str(what.poses)]]
    rows += [
        [name, f"{f.nats:.2f}", f"{f.tilt_arcsec:.3f}", str(f.poses)]
        for name, f in plan.baselines.items()
    ]
    print_table(["same table time", "nats", "tilt arcsec", "poses"], rows)
    if not plan.problem.model.interest.all():
        print(
            "the sigmas hold for a fit of all these terms, nuisances too: calibrate with terms that"
            " name the drift as well"
        )
    if unseen:
        print("no pose can see: " + ", ".join(unseen))
