"""``tiltcal design --blind-to-nothing``."""

import argparse
from pathlib import Path

import numpy as np

from tiltcal.cli.designing import write_plan
from tiltcal.cli.output import print_json, print_table
from tiltcal.design.ascent import Problem
from tiltcal.design.clock import Clock, unwound
from tiltcal.design.maxmin import MaxMin, blind_to_nothing
from tiltcal.design.plan import Plan
from tiltcal.design.polynomial import textbook_model
from tiltcal.design.signatures import EFFECTS
from tiltcal.design.steps import printable
from tiltcal.design.still import Still
from tiltcal.errors import TiltcalError
from tiltcal.files import make_folder
from tiltcal.scenario import Scenario

FEWEST = 13  # poses: the linear terms take four of each channel, and eleven effects share what is left


def blind_to_nothing_(args: argparse.Namespace, scenario: Scenario, clock: Clock) -> int:
    """Poses that leave no effect unseen."""
    count = args.blind_to_nothing
    if scenario.rig.table != "dual" or any(pair is not None for pair in clock.limits):
        raise TiltcalError(
            "design --blind-to-nothing", found=f"table {scenario.rig.table}{' with limits' if any(clock.limits) else ''}",
            need="a dual table that turns freely", do="use --terms with the effects that matter instead",
        )  # fmt: skip
    if count < FEWEST:
        raise TiltcalError(
            "design --blind-to-nothing", found=f"{count} poses", need=f"{FEWEST} or more: fewer leave {EFFECTS[1]} or another "
            "effect unseen", do="allow more",
        )  # fmt: skip
    _hold(clock, count * (clock.settle + clock.shortest), count)
    found = blind_to_nothing(count, args.seed)
    plan = timed(found, clock)
    up = Still(scenario, clock.budget).up(plan.angles)
    if args.output:
        write_plan(plan, scenario, up, make_folder(Path(args.output)))
    if args.json:
        print_json(plan.to_json() | summary(found))
        return 0
    print(printable(plan, up))
    seen = [*zip(EFFECTS, found.shares, strict=True), ("linear drift", found.drift), ("warm-up", found.warmup)]
    print_table(["effect", "share of the most any design sees"], [[name, f"{share:.3f}"] for name, share in seen])
    print(
        f"least share {found.shares.min():.4f}; no design can pass {found.bound:.4f} (convex bound on a 10 deg grid; references "
        f"within {100 * found.reference_gap:.2f} %); D-efficiency of the linear terms {100 * found.efficiency:.2f} %"
    )
    return 0


def timed(found: MaxMin, clock: Clock) -> Plan:
    """The poses with equal dwells that fill the budget.

    Raises:
        TiltcalError: it does not hold them.
    """
    angles = unwound(found.angles, clock.limits)
    problem = Problem(textbook_model("linear", True, clock.budget), clock)
    _hold(clock, clock.budget - float(clock.spare(angles)), len(angles))
    return Plan(problem, angles, problem.dwells(angles, np.zeros(len(angles))), ("outer", "inner"), {})


def _hold(clock: Clock, needed: float, count: int) -> None:
    """Refuse a budget that does not hold the poses."""
    if needed > clock.budget:
        raise TiltcalError(
            "design, budget", found=f"{clock.budget:g} s", need=f"{needed:.0f} s or more for {count} poses", do="raise --budget-s"
        )


def summary(found: MaxMin) -> dict[str, object]:
    """The shares for machines."""
    return {
        "shares": dict(zip(EFFECTS, map(float, found.shares), strict=True)) | {"drift": found.drift, "warm-up": found.warmup},
        "least_share": float(found.shares.min()), "bound": found.bound, "reference_gap": found.reference_gap,
        "d_efficiency": found.efficiency,
    }  # fmt: skip
