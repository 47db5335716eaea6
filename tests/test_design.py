"""Designed sequences: the founders' table of baselines and bars, bounds worked by hand, gradients,
files, the product's terms.
"""

import csv
import json
import tomllib

import numpy as np
import pytest
from statistics_helpers import rng_of

from tiltcal.cli import main
from tiltcal.core.frames import sphere
from tiltcal.core.tasks.engines import open_engine
from tiltcal.core.units import ARCSEC, DEG
from tiltcal.design.bounded_descent import minimise
from tiltcal.design.classic import CLASSIC, baseline, classic, planes
from tiltcal.design.criteria import CRITERIA, gain, tilt_rms
from tiltcal.design.gradient_search import Draft, Problem, _Climb
from tiltcal.design.plan import design, forecast
from tiltcal.design.polynomial import KINDS, dual_up, regressors, textbook_model
from tiltcal.design.search import Effort, folded, search
from tiltcal.design.steps import designed_table, steps_of
from tiltcal.design.terms import Wanted, scenario_model
from tiltcal.design.time_budget import Clock, unwound
from tiltcal.laboratory.scenario import parse_scenario
from tiltcal.setup.schedule import build_schedule
from tiltcal.setup.tables import find_table

BARS = {
    ("linear", False, 300): 92.64,
    ("linear", False, 900): 99.23,
    ("linear", True, 300): 90.42,
    ("linear", True, 900): 96.98,
    ("K2K3", True, 300): 130.47,
    ("K2K3", True, 900): 140.74,
    ("quadratic", True, 300): 196.79,
    ("quadratic", True, 900): 212.39,
}
"""nats that a local search reached (model, drift, budget)."""
TWENTY_FOUR = {
    ("linear", False, 300): 3.87,
    ("linear", False, 900): 2.17,
    ("linear", True, 300): 5.18,
    ("linear", True, 900): 2.87,
    ("K2K3", True, 300): 6.30,
    ("K2K3", True, 900): 3.27,
    ("quadratic", True, 300): 8.54,
    ("quadratic", True, 900): 3.98,
}
"""arcsec of 24 positions, the dwell the best of 5, 10, 20 s, cut where the budget ends."""


def efficiency(angles):
    """det(F'F / n)^(1/4) of 1, x, y, z over the bound 27^(-1/4), which six positions reach."""
    F = np.column_stack([np.ones(len(angles)), dual_up(angles)])
    return float(max(np.linalg.det(F.T @ F / len(F)), 0.0) ** 0.25 * 27**0.25)


def problem_of(kind, drift, budget, criterion="both", **clock):
    return Problem(textbook_model(kind, drift, budget), Clock(budget, **clock), criterion)


def worth(problem, draft):
    return gain(
        problem.information(draft.angles, problem.dwells(draft.angles, draft.z)),
        problem.model.interest,
    )


def scenario_of(table="dual", **more):
    return parse_scenario(
        {
            "schema": 1,
            "name": "bench",
            "site": {"gravity_m_s2": 9.80123},
            "rig": {"table": table},
            "sensor": [
                {
                    "name": "accel",
                    "kind": "accelerometer",
                    "rate_hz": 50,
                    "adjustable": ["bias", "scale", "cross_axis"],
                }
            ],
            "effect": [{"id": "acc_noise", "white_ug_rthz": 100}],
            **more,
        }
    )


@pytest.mark.parametrize("cell", TWENTY_FOUR, ids=str)
def test_the_model_reproduces_what_24_positions_are_known_to_reach(cell):
    kind, drift, budget = cell
    problem = problem_of(kind, drift, budget)
    tried = []
    for dwell in (5.0, 10.0, 20.0):
        angles = unwound(np.tile(planes(45), (4, 1)), problem.clock.limits)
        cost = np.cumsum(problem.clock.moves(angles) + problem.clock.settle + dwell)
        angles = angles[: np.searchsorted(cost, budget, side="right")]
        tried.append(
            tilt_rms(problem.information(angles, np.full(len(angles), dwell)), problem.model.loss)
            / ARCSEC
        )
    # the table's last digit, and 400 directions for all
    assert min(tried) == pytest.approx(TWENTY_FOUR[cell], abs=0.006)


@pytest.mark.parametrize("cell", BARS, ids=str)
def test_the_default_design_passes_the_bar_of_the_local_search_and_every_classic_sequence(cell):
    problem = problem_of(*cell)
    plan = design(problem)
    assert plan.forecast.nats >= BARS[cell]
    assert plan.forecast.total_s <= cell[2] + 1e-6
    assert problem.clock.shortest - 1e-9 <= plan.dwell.min()
    assert plan.dwell.max() <= problem.clock.longest + 1e-9
    for name, other in plan.baselines.items():
        assert plan.forecast.nats >= other.nats, name
        assert plan.forecast.tilt_arcsec <= other.tilt_arcsec, name


def test_six_positions_are_at_the_bound_of_the_linear_terms_and_no_design_claims_more():
    assert efficiency(classic("six")) == pytest.approx(1.0, abs=1e-12)
    up = dual_up(classic("six"))
    F = np.column_stack([np.ones(6), up])
    # worked by hand: diag(1, 1/3, 1/3, 1/3)
    assert np.linalg.det(F.T @ F / 6) ** 0.25 == pytest.approx((1 / 27) ** 0.25, rel=1e-12)
    rng = rng_of("no design claims more")
    for n in (6, 12, 24):
        assert efficiency(rng.uniform(-np.pi, np.pi, (n, 2))) <= 1 + 1e-12
    quiet = problem_of("linear", False, 1e4, "D", rate=1e9, settle=0.0, shortest=60.0, longest=60.0)
    best = search(
        quiet, [Draft(classic("six"), np.zeros(6))], 0, Effort(starts=3, rounds=1, trials=10)
    )
    assert 0.99 <= efficiency(best.angles) <= 1 + 1e-12


@pytest.mark.parametrize("criterion", ["both", "I", "D", "A"])
@pytest.mark.parametrize("kind", ["K2K3", "quadratic"])
def test_the_gradient_is_the_slope_of_the_value(criterion, kind):
    problem = problem_of(kind, True, 300, criterion)
    climb = _Climb(problem, 12, 2)
    rng = rng_of(f"gradient {criterion} {kind}")
    x = np.concatenate(
        [np.cumsum(rng.uniform(0.1, 0.6, (12, 2)), axis=0).ravel(), rng.normal(0, 0.3, 12)]
    )
    _, slope = climb(x)
    for i in (0, 7, 23, 25, 35):
        step = 1e-5 * np.eye(len(x))[i]
        assert slope[i] == pytest.approx(
            (climb(x + step)[0] - climb(x - step)[0]) / 2e-5, rel=2e-3, abs=2e-3
        )


def test_moves_that_alone_overrun_are_led_back_inside():
    climb = _Climb(problem_of("linear", False, 60), 5, 2)
    x = np.concatenate([np.array([[0, 0], [9, 0], [0, 9], [9, 0], [0, 9.0]]).ravel(), np.zeros(5)])
    value, slope = climb(x)
    assert value > 1e4
    assert climb(x - 1e-3 * slope)[0] < value
    assert problem_of("linear", False, 60).rated(x[:10].reshape(5, 2), x[10:]).value == -np.inf


def test_the_descent_finds_a_minimum_at_its_bounds():
    def bowl(x):
        d = x - np.array([3.0, -2.0, 0.5])
        return float(d @ (np.array([1, 10, 100]) * d)), 2 * np.array([1, 10, 100]) * d

    found = minimise(bowl, np.zeros(3), np.full(3, -1.0), np.full(3, 1.0), 60)
    assert found == pytest.approx([1.0, -1.0, 0.5], abs=1e-5)


def test_dwells_fill_the_budget_and_none_is_longer_than_allowed():
    problem = problem_of("linear", False, 300, longest=20.0)
    angles = np.arange(14)[:, None] * np.array([0.5, 0.3])
    z = np.linspace(-3, 3, 14)
    dwell = problem.dwells(angles, z)
    assert dwell.max() <= 20 + 1e-9
    assert dwell.min() >= 5
    assert problem.clock.total(angles, dwell) == pytest.approx(300, abs=1e-6)
    few = problem.dwells(angles[:2], z[:2])
    assert few == pytest.approx([20, 20])  # the rest of the time stays unused


@pytest.mark.parametrize("kind", KINDS)
def test_textbook_models_have_the_parameters_they_are_known_for(kind):
    counts = {"linear": 12, "K2": 15, "K2K3": 18, "quadratic": 27, "cubic": 48}
    model = textbook_model(kind, True, 300)
    assert (model.interest.sum(), len(model.names)) == (counts[kind], counts[kind] + 3)
    flat = regressors(sphere(500), kind)
    for channel in range(3):
        assert np.linalg.matrix_rank(flat[:, channel]) == counts[kind] // 3


@pytest.mark.parametrize("name", CLASSIC)
@pytest.mark.parametrize("table", ["dual", "three", "placing"])
def test_every_classic_sequence_is_there_for_every_table_that_turns_gravity(name, table):
    angles = classic(name, find_table(table))
    assert angles.shape[1] == (1 if table == "placing" else 2)
    assert len(angles) >= 2


def test_classic_sequences_go_where_their_names_say():
    assert len(classic("24")) == 24
    assert len(classic("tumble")) == 36
    up = dual_up(classic("8"))
    assert np.abs(up) == pytest.approx(np.full((8, 3), 1 / np.sqrt(3)))
    assert dual_up(classic("two_position")).sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-12)
    sweep = classic("sweep")[:, 0] / DEG
    assert sweep == pytest.approx(sweep[::-1])  # up and down: a linear drift is orthogonal to it
    assert classic("spiral").shape == (24, 2)


def test_one_setting_of_the_search_repeats_itself():
    problem = problem_of("linear", True, 120)
    few = Effort(starts=4, rounds=1, trials=10)
    first, second = (search(problem, [], 7, few) for _ in range(2))
    assert np.array_equal(first.angles, second.angles)
    assert np.array_equal(first.z, second.z)


def test_any_number_of_processes_gives_the_same_design():
    problem = problem_of("K2", False, 90)
    few = Effort(starts=3, first=8, then=8, rounds=1, trials=6)
    here = design(problem, effort=few)
    with open_engine("processes", 2) as engine:
        apart = design(problem, effort=few, engine=engine)
    np.testing.assert_array_equal(apart.angles, here.angles)
    np.testing.assert_array_equal(apart.dwell, here.dwell)


def test_limits_and_steps_of_the_table_are_kept():
    limits = ((-60 * DEG, 90 * DEG), (0.0, 180 * DEG))
    problem = problem_of("linear", False, 200, limits=limits, step=5 * DEG)
    plan = design(problem, effort=Effort(starts=4, rounds=1, trials=10))
    assert plan.angles[:, 0].min() >= limits[0][0] - 1e-9
    assert plan.angles[:, 0].max() <= limits[0][1] + 1e-9
    assert plan.angles[:, 1].min() >= -1e-9
    assert plan.angles[:, 1].max() <= limits[1][1] + 1e-9
    assert plan.angles / (5 * DEG) == pytest.approx(np.round(plan.angles / (5 * DEG)), abs=1e-6)
    assert folded(np.array([[2.0, -0.1]]), problem.clock)[0] == pytest.approx([np.pi - 2.0, 0.1])


@pytest.mark.parametrize("criterion", [c for c in CRITERIA if c != "tilt"])
def test_what_a_criterion_asks_for_is_what_it_gets(criterion):
    plans = {
        c: design(problem_of("K2K3", True, 200, c), effort=Effort(starts=6, rounds=1, trials=20))
        for c in {criterion, "D", "I"}
    }
    mine = plans[criterion]
    for other in plans.values():
        assert mine.problem.rated(mine.angles, np.log(mine.dwell - 4.99)).value > -np.inf
        if criterion == "D":
            assert mine.forecast.nats >= other.forecast.nats - 0.05
        if criterion == "I":
            assert mine.forecast.tilt_arcsec <= other.forecast.tilt_arcsec * 1.01


def test_the_products_own_terms_give_the_textbook_forecast():
    """bias, scale and cross-axis of the catalogue are 1, x, y, z: same sigmas, in their own
    units.
    """
    scenario = scenario_of(site={"gravity_m_s2": 9.80665})
    mine, _ = scenario_model(
        scenario,
        scenario.sensor[0],
        Wanted(("bias", "scale", "cross_axis"), ("drift",), prior=0.03),
        300,
    )
    clock = Clock(300)
    angles, dwell = classic("six"), np.full(6, 20.0)
    product = forecast(Problem(mine, clock), angles, dwell)
    book = forecast(problem_of("linear", True, 300), angles, dwell)
    assert product.nats == pytest.approx(book.nats, abs=1e-6)
    assert product.tilt_arcsec == pytest.approx(book.tilt_arcsec, rel=1e-6)
    sigma = dict(zip(mine.names, product.sigma, strict=True))
    textbook = dict(zip(problem_of("linear", True, 300).model.names, book.sigma, strict=True))
    assert sigma["accel.bias_x"] == pytest.approx(textbook["x.bias"] * 1e6, rel=1e-6)
    assert sigma["accel.scale_y"] == pytest.approx(textbook["y.y"] * 1e6, rel=1e-6)
    assert sigma["accel.cross_zx"] == pytest.approx(textbook["z.x"] * 1e6, rel=1e-6)


def test_the_whole_catalogue_can_be_asked_for_and_a_design_sees_more_of_it_than_six_positions():
    scenario = scenario_of()
    model, unseen = scenario_model(
        scenario, scenario.sensor[0], Wanted(("all",), ("drift", "table_levelling")), 300
    )
    assert len(model.names) > 90
    assert {"acc_hysteresis", "table_backlash", "lever_arm"} <= set(unseen)
    assert not any(
        n.startswith("accel.drift") and i for n, i in zip(model.names, model.interest, strict=True)
    )
    problem = Problem(model, Clock(300), "D")
    six = baseline(problem, "six")
    best = search(problem, [six], 0, Effort(starts=2, first=10, then=15, kept=1, rounds=0))
    assert worth(problem, best) > worth(problem, six) + 50


def test_table_effects_at_a_pose_are_the_closed_form_differenced():
    from tiltcal.design.static_instrument import Still, watch
    from tiltcal.effects import make_effect

    scenario = scenario_of()
    sensor = scenario.sensor[0]
    model, _ = scenario_model(
        scenario, sensor, Wanted(("table_sag", "table_encoder_eccentricity", "K3"), ()), 300
    )
    rng = rng_of("table effects at a pose")
    angles = rng.uniform(-np.pi, np.pi, (20, 2))
    rows = model.rows(angles, np.zeros(20))
    index = model.names.index("table_encoder_eccentricity[outer].cos")
    small = make_effect("table_encoder_eccentricity", {"cos_arcsec": 1.0}, scenario, axis="outer")
    change = watch(Still(scenario, 300.0), angles).changes(small)["accel"]
    # an arcsecond's own square
    assert rows[:, :, index] == pytest.approx(
        change * model.prior[index], abs=5e-6 * np.abs(rows).max()
    )
    k3 = rows[:, 0, model.names.index("accel.k3_x")]
    assert k3 == pytest.approx(
        dual_up(angles)[:, 0] ** 3 * 9.80123**3 / 9.80665**2 * 200e-6, rel=1e-6
    )


def test_an_inclinometer_reads_angles_and_its_steep_end_is_not_exploited():
    """Its rows are those of the force over g cos(tilt), and beyond 60 deg no steeper than there."""
    sensor = {"name": "incl", "kind": "inclinometer", "axes": ["x", "y"], "rate_hz": 20}
    scenario = scenario_of(sensor=[sensor], effect=[])
    terms = ("bias", "table_levelling", "table_sag")
    model, unseen = scenario_model(scenario, scenario.sensor[0], Wanted(terms, ()), 100)
    assert not any("levelling" in name for name in unseen)
    tilts = np.array([0.0, 30.0, 60.0, 80.0, 90.0]) * DEG  # about the outer axis: tilt of y
    rows = model.rows(np.column_stack([tilts, 0 * tilts]), np.zeros(5))
    bias = (
        rows[:, 1, model.names.index("incl.bias_y")] / model.prior[model.names.index("incl.bias_y")]
    )
    slope = 1e-6 * 9.80665 / 9.80123
    assert bias == pytest.approx(slope / np.cos(np.minimum(tilts, 60 * DEG)), rel=1e-9)
    east = rows[:, 1, model.names.index("table_levelling.tilt_east")]
    # an angle is an angle, whatever the tilt
    assert east[:3] == pytest.approx(np.full(3, east[0]), rel=1e-3)


@pytest.mark.parametrize("table", ["dual", "three", "placing"])
def test_the_scenario_takes_the_table_time_that_was_planned(table):
    scenario = scenario_of(table)
    terms = ("bias", "scale", "cross_axis") if table != "placing" else ("bias", "K2")
    from tiltcal.design.static_instrument import Still

    still = Still(scenario, 150.0)
    clock = Clock(150.0, limits=(None,) * len(still.axes))
    model, _ = scenario_model(scenario, scenario.sensor[0], Wanted(terms), 150.0)
    plan = design(
        Problem(model, clock), scenario.rig.kind, effort=Effort(starts=3, rounds=1, trials=10)
    )
    steps = steps_of(plan, still.up(plan.angles))
    again = parse_scenario(designed_table(scenario, steps, "designed"))
    schedule = again.schedule
    assert schedule.times[1] == pytest.approx(plan.forecast.total_s, abs=0.01)
    middles = clock.middles(plan.angles, plan.dwell)
    drive = schedule.drive(middles)
    for k, axis in enumerate(still.axes):
        assert np.asarray(drive.axes[axis].x) == pytest.approx(plan.angles[:, k], abs=1e-6)
        assert np.asarray(drive.axes[axis].v) == pytest.approx(0.0, abs=1e-12)
    begin = schedule.drive(middles - plan.dwell / 2 - clock.settle + 1.0)
    # ramps end inside the settling
    assert all(np.asarray(jet.v) == pytest.approx(0.0, abs=1e-12) for jet in begin.axes.values())


def test_the_command_writes_what_a_laboratory_a_calibration_and_a_person_can_follow(
    tmp_path, capsys
):
    out = tmp_path / "out"
    assert main(["design", "--textbook", "linear", "--budget-s", "120", "-o", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "the sigmas hold for a fit of all these terms" in printed
    assert "this design" in printed
    assert "x.bias" in printed
    plan = json.loads((out / "design.json").read_text())
    with (out / "steps.csv").open() as lines:
        rows = list(csv.DictReader(lines))
    assert list(rows[0]) == [
        "step",
        "action",
        "outer_deg",
        "middle_deg",
        "inner_deg",
        "rate_deg_s",
        "dwell_s",
        "mount",
        "label",
    ]
    assert {r["action"] for r in rows} == {"move"}
    assert (
        len(rows)
        == len(plan["poses"])
        == len(tomllib.loads((out / "design.toml").read_text())["sequence"])
    )
    assert float(rows[3]["outer_deg"]) == pytest.approx(plan["poses"][3]["outer_deg"], abs=1e-6)
    assert plan["total_s"] <= 120 + 1e-6
    assert "expected rms tilt error" in (out / "steps.txt").read_text()
    assert main(["simulate", str(out / "design.toml"), "-o", str(tmp_path / "run.csv")]) == 0
    words = [
        "calibrate",
        str(tmp_path / "run.csv"),
        "--scenario",
        str(out / "design.toml"),
        "--method",
        "six_position",
    ]
    assert main([*words, "--segments", str(out / "segments.csv"), "--json"]) == 0
    calibrated = json.loads(capsys.readouterr().out)
    assert len(calibrated["poses"]) == len(rows)


def test_terms_come_from_the_scenario_unless_they_are_named(tmp_path, capsys):
    table = scenario_of(
        effect=[{"id": "acc_K2", "sensor": "accel", "k2_x_ug_g2": 10.0, "fit": True}]
    )
    (tmp_path / "s.toml").write_text(_toml(table))
    assert (
        main(
            [
                "design",
                str(tmp_path / "s.toml"),
                "--budget-s",
                "100",
                "--nuisance",
                "none",
                "--json",
            ]
        )
        == 0
    )
    names = [p["name"] for p in json.loads(capsys.readouterr().out)["parameters"]]
    assert {"accel.bias_x", "accel.cross_zy", "accel.k2_z"} <= set(names)
    assert not any("drift" in n for n in names)


def _toml(scenario):
    import tomli_w

    return tomli_w.dumps(
        {"schema": 1}
        | json.loads(
            scenario.model_dump_json(exclude_none=True, exclude_defaults=True, by_alias=True)
        )
    )


def test_a_schedule_of_the_steps_is_what_build_schedule_makes_of_them():
    scenario = scenario_of()
    plan = design(problem_of("linear", False, 60), effort=Effort(starts=2, rounds=0))
    steps = steps_of(plan, dual_up(plan.angles))
    assert build_schedule(steps, scenario.rig).times[1] == pytest.approx(
        plan.forecast.total_s, abs=0.01
    )
