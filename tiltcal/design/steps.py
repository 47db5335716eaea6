"""A plan as steps for a laboratory: CSV, scenario, printable list, and the dwells to calibrate
from.
"""

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.files import write_json, write_text
from tiltcal.core.units import DEG
from tiltcal.design.bound import Efficiency
from tiltcal.design.goals import Goal
from tiltcal.design.plan import Plan
from tiltcal.laboratory.scenario import Scenario
from tiltcal.setup.pose_schemes import label_of
from tiltcal.setup.reach import DECIMALS
from tiltcal.setup.schedule import move_time, require_allowed
from tiltcal.setup.sequence import Step
from tiltcal.setup.sequence_files import sequence_columns
from tiltcal.setup.tables import angle_key

# textbook plans whose moves have time are above 0.97, those on steps of 5 deg within 30 deg 0.91
TELLING = 0.9


def steps_of(plan: Plan, up: Array) -> list[Step]:
    """One step a pose: the move, then a dwell of settling and reading.

    The dwell is what is left of the plan's time once the drive has stopped: its ramps lie inside
    the settling.

    Args:
        plan: plan of a design.
        up: in the body frame, (n, 3).
    """
    clock = plan.problem.clock
    rate = clock.rate / DEG
    steps, position = [], clock.origin
    for angles, dwell, direction in zip(plan.angles, plan.dwell, up, strict=True):
        distance = float(np.abs(angles - position).max())
        taken = move_time(distance, clock.rate) if distance > 0 else 0.0
        stay = distance / clock.rate + clock.settle + float(dwell) - taken
        steps.append(
            Step(
                action="move",
                **_where(plan, angles),
                rate_deg_s=rate,
                dwell_s=round(stay, 6),
                label=label_of(direction),
            )
        )
        position = angles
    if clock.returns:
        steps.append(Step(action="move", **_where(plan, clock.origin), rate_deg_s=rate))
    return steps


def _where(plan: Plan, angles: Array) -> dict[str, float]:
    """Keys of a step for angles, rad, (axes,)."""
    return {
        angle_key(name): round(float(a) / DEG, DECIMALS) + 0.0
        for name, a in zip(plan.axes, angles, strict=True)
    }


def steps_csv(steps: list[Step]) -> str:
    """The steps in the columns that a laboratory reads; empty cells mean unchanged."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    columns = sequence_columns([axis for step in steps for axis in step.angles_deg])
    writer.writerow(columns)
    for number, step in enumerate(steps, start=1):
        values = {"step": number, **step.model_dump(exclude_none=True)}
        writer.writerow([values.get(name, "") for name in columns])
    return text.getvalue()


def segments_csv(plan: Plan) -> str:
    """What is read of each dwell, as `calibrate --segments` takes it."""
    middles = plan.problem.clock.middles(plan.angles, plan.dwell)
    lines = [
        f"{m - d / 2:.6f},{m + d / 2:.6f},dwell" for m, d in zip(middles, plan.dwell, strict=True)
    ]
    return "\n".join(["start_s,end_s,kind", *lines]) + "\n"


def designed_table(scenario: Scenario, steps: list[Step], name: str) -> dict[str, Any]:
    """The scenario's table with the designed sequence instead of its own; acceptance limits of its
    own sequence are left out.
    """
    stated = json.loads(
        scenario.model_dump_json(
            exclude_none=True,
            exclude_defaults=True,
            by_alias=True,
            exclude={"sequence", "method", "estimator", "about"},
        )
    )
    sequence = [s.model_dump(exclude_none=True, exclude_unset=True) for s in steps]
    return {"schema": 1} | stated | {"name": name, "sequence": sequence}


def _start_and_end(plan: Plan) -> list[str]:
    """Where the table stands before and after, where that is not zero or is asked for."""
    clock = plan.problem.clock
    if not (clock.origin.any() or clock.returns):
        return []
    where = ", ".join(f"{n} {a / DEG:g} deg" for n, a in zip(plan.axes, clock.origin, strict=True))
    return [f"starts at {where}{'; ends there' if clock.returns else ''}"]


def printable(
    plan: Plan,
    up: Array,
    efficiencies: Efficiency | None = None,
    goals: Sequence[tuple[Goal, float]] = (),
) -> str:
    """The printed list for the table: poses, then the expected standard uncertainty of each
    parameter.

    Args:
        plan: plan of a design.
        up: in the body frame, (n, 3).
        efficiencies: of the plan, where they are known.
        goals: with what is expected, in their units.
    """
    clock, model, what = plan.problem.clock, plan.problem.model, plan.forecast
    head = "".join(f"{name + ' deg':>12}" for name in plan.axes)
    lines = [
        (
            f"{what.poses} poses in {what.total_s:.1f} s of {clock.budget:g} s; moves at"
            f" {clock.rate / DEG:g} deg/s, then {clock.settle:g} s to settle, then read"
        ),
        *_start_and_end(plan),
        "",
        f"{'step':>4}{head}{'read from s':>13}{'read s':>9}   up in the body frame",
    ]
    middles = clock.middles(plan.angles, plan.dwell)
    for k, (angles, dwell, m, u) in enumerate(
        zip(plan.angles, plan.dwell, middles, up, strict=True), start=1
    ):
        turned = "".join(f"{a / DEG:12.3f}" for a in angles)
        lines.append(
            f"{k:4d}{turned}{m - dwell / 2:13.2f}{dwell:9.2f}   {label_of(np.round(u, 3))}"
        )
    lines += ["", f"{'parameter':<36}{'before':>12}{'expected':>12}  unit"]
    for n, unit, prior, sigma, wanted in zip(
        model.names, model.units, model.prior, what.sigma, model.interest, strict=True
    ):
        lines.append(
            f"{n:<36}{prior:12.4g}{sigma:12.4g}  {unit}{'' if wanted else '   (nuisance)'}"
        )
    lines += [
        "",
        (
            f"expected rms tilt error per axis {what.tilt_arcsec:.3f} arcsec; information gained"
            f" {what.nats:.2f} nats"
        ),
    ]
    if efficiencies is not None:
        lines += _of_bounds(efficiencies)
    lines += [_of_goal(goal, expected) for goal, expected in goals]
    return "\n".join(lines) + "\n"


def _of_bounds(found: Efficiency) -> list[str]:
    lines = [
        f"efficiency at least {100 * found.at_its_times:.1f} % of any poses read at these times",
        f"efficiency at least {100 * found.of_all:.1f} % of any plan of this table time",
    ]
    if found.at_its_times < TELLING:
        lines.append(
            "both bounds let every move reach any pose; here the time for moves limits them"
        )
    return lines


def _of_goal(goal: Goal, expected: float) -> str:
    word = "reached" if expected <= goal.limit else "not reached in this table time"
    return f"goal {goal.name} {goal.limit:.4g} {goal.unit}: {expected:.4g} expected, {word}"


def write_plan(
    plan: Plan, scenario: Scenario, up: Array, folder: Path, text: str, result: dict[str, Any]
) -> None:
    """Write design.toml, steps.csv, steps.txt, segments.csv and design.json to a folder.

    Args:
        plan: to write.
        scenario: that it was designed for.
        up: the up direction of each pose in the body frame, (n, 3).
        folder: where.
        text: that is printed.
        result: for machines.
    """
    import tomli_w

    steps = steps_of(plan, up)
    require_allowed(steps, scenario.rig)
    write_text(
        folder / "design.toml",
        tomli_w.dumps(designed_table(scenario, steps, f"{scenario.name}, designed")),
    )
    write_text(folder / "steps.csv", steps_csv(steps))
    write_text(folder / "steps.txt", text)
    write_text(folder / "segments.csv", segments_csv(plan))
    write_json(folder / "design.json", result)
