"""The bound on what poses can give, and plans that come close to it."""

import json
from itertools import product

import numpy as np
import pytest
from scenario_files import BENCH_SCENARIO
from statistics_helpers import rng_of

from tiltcal.cli import main
from tiltcal.core.units import DEG, G0
from tiltcal.design.bound import efficiency, ideal, ideal_of_all
from tiltcal.design.classic import baseline, classic
from tiltcal.design.criteria import value
from tiltcal.design.gradient_search import Problem, merged
from tiltcal.design.plan import design, forecast
from tiltcal.design.polynomial import textbook_model
from tiltcal.design.scenario_problem import clock_of, scenario_problem
from tiltcal.design.search import Effort
from tiltcal.design.terms import Wanted
from tiltcal.design.time_budget import Clock
from tiltcal.laboratory.scenario import parse_scenario

HEAD = {
    "schema": 1,
    "site": {"gravity_m_s2": 9.808368},
    "rig": {"table": "placing", "readout": "command", "limits": {"outer": [-30, 30]}},
    "sensor": [
        {
            "name": "head",
            "kind": "accelerometer",
            "axes": ["x", "y"],
            "rate_hz": 10,
            "adjustable": ["bias", "scale", "cross_axis"],
        }
    ],
}


@pytest.mark.parametrize("criterion", ["D", "A", "tilt", "both"])
@pytest.mark.parametrize("kind", ["linear", "K2K3", "quadratic"])
def test_no_poses_pass_the_bound_at_the_same_times(kind, criterion):
    problem = Problem(textbook_model(kind, kind != "quadratic", 300), Clock(300), criterion)
    rng = rng_of(f"bound {kind} {criterion}")
    angles, dwell = rng.uniform(-np.pi, np.pi, (16, 2)), rng.uniform(5, 12, 16)
    bound = ideal(problem, angles, dwell).bound
    when = problem.clock.middles(angles, dwell)
    faces = np.resize(classic("six"), (16, 2))
    for poses in (faces, *rng.uniform(-np.pi, np.pi, (300, 16, 2))):
        assert (
            value(problem.model.information(poses, dwell, when), problem.model, criterion) < bound
        )


@pytest.mark.parametrize("kind", ["linear", "K2K3"])
@pytest.mark.parametrize("drift", [False, True])
def test_no_plan_passes_the_bound_on_all_of_a_table_time(kind, drift):
    """All plans of up to five of four poses, and random ones of other lengths and dwells."""
    problem = Problem(textbook_model(kind, drift, 60), Clock(60))
    bound = ideal_of_all(problem).bound
    poses = np.array([[0, 0], [40, 20], [-40, 60], [80, -30]]) * DEG
    plans = [poses[list(order)] for n in range(1, 6) for order in product(range(4), repeat=n)]
    rng = rng_of(f"all plans {kind} {drift}")
    steps = (rng.normal(0, 0.3, (rng.integers(1, 6), 2)) for _ in range(500))
    plans += [np.cumsum(step, axis=0) for step in steps]
    rated = [problem.rated(plan, rng.normal(0, 1, len(plan))) for plan in plans]
    reached = [draft.value for draft in rated if draft.value > -np.inf]
    assert len(reached) > 300
    assert max(reached) < bound


def test_the_bound_on_all_plans_is_reached_where_moves_and_settling_cost_next_to_nothing():
    clock = Clock(600.1, rate=1e6, settle=0.0, shortest=1.0, longest=1.0)
    problem = Problem(textbook_model("linear", False, 600), clock, "D")
    six = np.resize(classic("six"), (600, 2))
    reached = problem.rated(six, np.zeros(600)).value
    assert reached == pytest.approx(ideal_of_all(problem).bound, abs=0.01)


@pytest.mark.parametrize("budget", [60, 77])
def test_plans_of_few_poses_hardly_depend_on_the_seed(budget):
    problem = Problem(textbook_model("linear", True, budget), Clock(budget))
    few = Effort(starts=10, kept=2, rounds=1, hops=300)
    found = [design(problem, seed=seed, effort=few) for seed in range(2)]
    reached = [problem.rated(plan.angles, np.log(plan.dwell)).value for plan in found]
    assert reached[0] == pytest.approx(reached[1], abs=0.3)


def test_six_positions_are_as_good_as_any_weights_for_the_linear_terms():
    """Their determinant is the most that any design has; a seventh pose spoils the balance."""
    problem = Problem(textbook_model("linear", False, 300), Clock(300), "D")
    six, dwell = classic("six"), np.full(6, 20.0)
    assert 0.9995 < efficiency(problem, six, dwell) <= 1
    tilted = np.vstack([six[:-1], six[:1] + 0.5])
    assert efficiency(problem, tilted, dwell) < 0.95


@pytest.mark.parametrize(
    ("kind", "drift"), [("linear", False), ("linear", True), ("K2K3", True), ("quadratic", True)]
)
def test_a_design_has_at_least_97_percent_of_the_bound(kind, drift):
    problem = Problem(textbook_model(kind, drift, 300), Clock(300))
    plan = design(problem)
    assert efficiency(problem, plan.angles, plan.dwell) >= 0.97


def test_a_dividing_head_within_30_deg_visits_both_ends_and_beats_its_three_positions():
    scenario = parse_scenario(HEAD)
    wanted = Wanted((), ("drift",), "mid_mems", None, 20e-6 * G0, 30 * DEG)
    clock = clock_of(scenario, 300, step_deg=5)
    problem, _ = scenario_problem(scenario, scenario.sensor[0], wanted, clock)
    plan = design(problem, scenario.rig.kind)
    for name, other in plan.baselines.items():
        assert plan.forecast.nats >= other.nats, name
        assert plan.forecast.tilt_arcsec <= other.tilt_arcsec, name
    visited = set(np.round(plan.angles[:, 0] / DEG).astype(int).tolist())
    assert {-30, 30} <= visited <= set(range(-30, 31, 5))
    assert (np.abs(np.diff(plan.angles[:, 0])) > 1 * DEG).all()  # repeats are one longer dwell
    threes = [np.resize([-30.0, 0.0, 30.0], (n, 1)) * DEG for n in range(3, 40)]
    best = max((problem.rated(t, np.zeros(len(t))) for t in threes), key=lambda d: d.value)
    found = problem.rated(plan.angles, np.log(plan.dwell))
    assert found.value >= best.value
    three = forecast(problem, best.angles, problem.dwells(best.angles, best.z))
    assert plan.forecast.nats >= three.nats
    assert plan.forecast.tilt_arcsec <= three.tilt_arcsec
    assert efficiency(problem, plan.angles, plan.dwell) > 0.95
    # classics obey the same limits: of every 45 deg only level is left
    assert plan.allowed["8"] == (1, 8)
    assert plan.allowed["12"] == (3, 12)
    for name in plan.baselines:
        assert baseline(problem, name, scenario.rig.kind).value <= found.value + 1e-6, name


def test_neighbouring_poses_that_are_the_same_are_one_with_both_dwells():
    angles = np.array([[0.0], [0.0], [1.0], [0.0]])
    found, z = merged(angles, np.log([1.0, 2.0, 3.0, 4.0]))
    np.testing.assert_array_equal(found, [[0.0], [1.0], [0.0]])
    np.testing.assert_allclose(np.exp(z), [3.0, 3.0, 4.0])


def test_a_plan_that_keeps_to_its_limits_is_good_in_the_fit_that_is_recommended(tmp_path, capsys):
    bench, plan = tmp_path / "bench.toml", tmp_path / "plan"
    bench.write_text(BENCH_SCENARIO)
    limits = ["--angles", "outer=-90:90", "--from", "outer=10", "--home"]
    main(["design", str(bench), "--budget-s", "200", *limits, "-o", str(plan)])
    text = capsys.readouterr().out
    assert "starts at outer 10 deg, inner 0 deg; ends there" in text
    assert "efficiency at least 9" in text
    assert main(["simulate", str(plan / "design.toml"), "-o", str(tmp_path / "rec.csv")]) == 0
    terms = "terms=['bias', 'scale', 'cross_axis', 'drift']".replace("'", '"')
    fit = ["--method", "six_position", "--segments", str(plan / "segments.csv"), "--option", terms]
    capsys.readouterr()
    command = ["calibrate", str(tmp_path / "rec.csv"), "--scenario", str(bench), *fit, "--json"]
    assert main(command) == 0
    assert json.loads(capsys.readouterr().out)["verdict"] == "good"
