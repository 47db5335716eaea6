"""Efficiency of plans by their certified bound: the eight textbook cells, robots of own models, a
dividing head, and short plans, with what the best classic sequence reaches in the same limits.

python -m tests.benchmarks efficiency
"""

import tempfile
import time
from pathlib import Path
from typing import Any

from tests.benchmarks import sized
from tests.benchmarks.designing import CELLS
from tests.model_rig import Mapped, scenario_text
from tests.model_trials import ROBOTS
from tiltcal.cli.design import TEXTBOOK
from tiltcal.core.units import DEG, G0
from tiltcal.design.bound import efficiencies
from tiltcal.design.gradient_search import Problem
from tiltcal.design.plan import design
from tiltcal.design.polynomial import textbook_model
from tiltcal.design.scenario_problem import clock_of, scenario_problem
from tiltcal.design.terms import Wanted
from tiltcal.design.time_budget import Clock
from tiltcal.laboratory.scenario import Scenario, load_scenario, parse_scenario
from tiltcal.setup.tables import DUAL, Table

OWN_MODELS = sized(("arm", "pusher", "pan-tilt head", "leg of a hexapod"), ("pan-tilt head",))
SHORT = sized((60, 77, 120), (60,))  # s
HEAD = {
    "schema": 1,
    "site": {"gravity_m_s2": 9.808368},
    "rig": {"table": "placing", "limits": {"outer": [-30, 30]}},
    "sensor": [{"name": "head", "kind": "accelerometer", "axes": ["x", "y"], "rate_hz": 10}],
}
TERMS = ("bias", "scale", "cross_axis")


def main() -> None:
    """Print all figures."""
    for kind, drift, budget in CELLS:
        problem = Problem(textbook_model(kind, drift, budget), Clock(budget))
        report(f"{kind}{'+drift' if drift else ''}, {budget} s", problem, DUAL, 0.97)
    for name in OWN_MODELS:
        scenario = robot(name)
        report(name, problem_of(scenario, 600), scenario.rig.kind, 0.95)
    for budget in sized((300, 900), (300,)):
        head = parse_scenario(HEAD)
        report(f"dividing head, {budget} s", problem_of(head, budget, step_deg=5), head.rig.kind)
    for budget in SHORT:
        report(f"new scenario, {budget} s", problem_of(parse_scenario(TEXTBOOK), budget), DUAL)


def robot(name: str) -> Scenario:
    """The scenario of a user's own model.

    Args:
        name: one of ``model_trials.ROBOTS``.
    """
    model = ROBOTS[name]
    axes = {f"j{k}": Mapped(joint) for k, joint in enumerate(model.joints)}
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, model.file).write_bytes(model.text)
        path = Path(folder, "bench.toml")
        path.write_text(scenario_text(model.file, axes, model.site))
        return load_scenario(path)


def problem_of(scenario: Scenario, budget: float, **clock: Any) -> Problem:
    """What `tiltcal design` makes of a scenario.

    Args:
        scenario: rig and sensor.
        budget: table time, s.
        clock: of ``clock_of``.
    """
    sensor = scenario.sensor[0]
    reach = 30 * DEG if scenario.rig.limits else 180 * DEG
    wanted = Wanted(TERMS, ("drift",), "mid_mems", None, 20e-6 * G0, reach)
    return scenario_problem(scenario, sensor, wanted, clock_of(scenario, budget, **clock))[0]


def report(name: str, problem: Problem, table: Table, least: float | None = None) -> None:
    """Print the efficiency of a design, and the most that a classic sequence reaches of each
    figure.
    """
    begun = time.process_time()
    plan = design(problem, table)
    designed = time.process_time()
    shares = efficiencies(problem, plan.angles, plan.dwell)
    took = designed - begun, time.process_time() - designed
    classics = plan.baselines.values()
    nats = max((f.nats for f in classics), default=0.0)
    tilt = min((f.tilt_arcsec for f in classics), default=float("inf"))
    print(
        f"efficiency {name}: {100 * shares.at_its_times:.1f} %"
        f"{'' if least is None else f' (at least {100 * least:.0f} %)'},"
        f" of all plans {100 * shares.of_all:.1f} %,"
        f" {plan.forecast.poses} poses, {plan.forecast.nats:.3f} nats (best classic {nats:.3f}),"
        f" {plan.forecast.tilt_arcsec:.4f} arcsec (best classic {tilt:.4f});"
        f" search {took[0]:.1f} s, bound {took[1]:.1f} s",
        flush=True,
    )
