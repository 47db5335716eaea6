"""What a design promises against what comes of it: instruments drawn from the prior, recorded
through MuJoCo, estimated.
"""

import numpy as np
import pytest
from scipy.stats import chi2
from statistics_helpers import FALSE_ALARM, rng_of, seed_of

from tiltcal.calibration.methods.registry import calibrate
from tiltcal.core.units import G0
from tiltcal.design.gradient_search import Problem
from tiltcal.design.plan import Plan, design
from tiltcal.design.search import Effort
from tiltcal.design.static_instrument import Still
from tiltcal.design.steps import designed_table, segments_csv, steps_of
from tiltcal.design.terms import Wanted, scenario_model
from tiltcal.design.time_budget import Clock
from tiltcal.laboratory.scenario import Scenario, parse_scenario
from tiltcal.recordings.segment_files import read_segments
from tiltsim.laboratory import MujocoLaboratory

TRIALS, WHITE = 40, 200.0
CASES = {
    "bias, scale, cross-axis": (("bias", "scale", "cross_axis"), ()),
    "K2 and K3 with a drift": (("bias", "scale", "cross_axis", "K2", "K3"), ("drift",)),
    "with an eccentric encoder": (
        ("bias", "scale", "cross_axis"),
        ("drift", "table_encoder_eccentricity"),
    ),
}


def scenario_of() -> Scenario:
    return parse_scenario(
        {
            "schema": 1,
            "name": "forecast",
            "site": {"gravity_m_s2": 9.80123},
            "rig": {"table": "dual"},
            "sensor": [{"name": "accel", "kind": "accelerometer", "rate_hz": 20}],
            "effect": [{"id": "acc_noise", "white_ug_rthz": WHITE}],
        }
    )


def planned(case: str) -> tuple[Scenario, Plan, Scenario]:
    """A scenario, its design for 120 s, and the scenario that follows it."""
    scenario = scenario_of()
    interest, nuisance = CASES[case]
    model, _ = scenario_model(
        scenario, scenario.sensor[0], Wanted(interest, nuisance, "precision", floor=0.0), 120.0
    )
    clock = Clock(120.0, settle=2.0, shortest=2.0)
    plan = design(Problem(model, clock), effort=Effort(starts=6, rounds=1, trials=10))
    up = Still(scenario, 120.0).up(plan.angles)
    return scenario, plan, parse_scenario(designed_table(scenario, steps_of(plan, up), "designed"))


def drawn(plan: Plan, truth: np.ndarray, designed: Scenario) -> Scenario:
    """The designed scenario with an instrument of these parameters, in units of the prior."""
    tables: dict[tuple[str, str], dict[str, object]] = {}
    model = plan.problem.model
    from tiltcal.effects import CATALOGUE

    stems = {
        "bias": "acc_bias",
        "scale": "acc_scale",
        "cross": "acc_cross_axis",
        "k2": "acc_K2",
        "k3": "acc_K3",
        "drift": "acc_drift",
    }
    for name, unit, size, value in zip(model.names, model.units, model.prior, truth, strict=True):
        owner, _, bare = name.partition(".")
        table_axis = owner.partition("[")[2].rstrip("]")
        id = owner.partition("[")[0] if table_axis else stems[bare.partition("_")[0]]
        assert id in CATALOGUE
        where = {"axis": table_axis} if table_axis else {"sensor": "accel"}
        tables.setdefault((id, table_axis), {"id": id, **where})[f"{bare}_{unit}"] = float(
            size * value
        )
    noise = {"id": "acc_noise", "sensor": "accel", "white_ug_rthz": WHITE}
    stated = designed.model_dump(
        exclude_none=True, exclude_defaults=True, by_alias=True, exclude={"effect"}
    )
    return parse_scenario({"schema": 1, **stated, "effect": [noise, *tables.values()]})


def estimated(plan: Plan, scenario: Scenario, seed: int) -> np.ndarray:
    """Posterior mean of the parameters, in units of the prior, from the readings inside each
    dwell's window.
    """
    recording = MujocoLaboratory().record(scenario, seed)
    readings = np.column_stack([recording.column(f"accel_{a}_m_s2") for a in "xyz"])
    model, clock = plan.problem.model, plan.problem.clock
    middles = clock.middles(plan.angles, plan.dwell)
    ideal = scenario.site.gravity * Still(scenario, clock.budget).up(plan.angles)
    inside = [
        (recording.time >= m - d / 2) & (recording.time <= m + d / 2)
        for m, d in zip(middles, plan.dwell, strict=True)
    ]
    means = np.array([readings[rows].mean(axis=0) for rows in inside]) - ideal
    root = np.sqrt(model.weights(plan.dwell))
    design_matrix = (model.rows(plan.angles, middles) * root[:, :, None]).reshape(
        -1, len(model.names)
    )
    information = np.eye(len(model.names)) + design_matrix.T @ design_matrix
    return np.linalg.solve(information, design_matrix.T @ (means * root).ravel())


@pytest.mark.parametrize("case", CASES)
def test_the_forecast_covariance_is_the_one_that_instruments_in_mujoco_scatter_with(case):
    _, plan, designed = planned(case)
    rng = rng_of(f"forecast {case}")
    model = plan.problem.model
    information = plan.problem.information(plan.angles, plan.dwell)
    p, squares, separate = len(model.names), 0.0, np.zeros(len(model.names))
    sigma = plan.forecast.sigma / model.prior
    for k in range(TRIALS):
        truth = rng.standard_normal(p)
        error = estimated(plan, drawn(plan, truth, designed), seed_of(f"{case} {k}")) - truth
        squares += float(error @ information @ error)
        separate += (error / sigma) ** 2
    tail = FALSE_ALARM / 2
    assert chi2.ppf(tail, TRIALS * p) <= squares <= chi2.isf(tail, TRIALS * p)
    tail /= p
    assert separate.min() >= chi2.ppf(tail, TRIALS)
    assert separate.max() <= chi2.isf(tail, TRIALS)


def test_a_calibration_that_fits_a_drift_reaches_what_a_design_with_drift_promises(tmp_path):
    scenario = scenario_of()
    model, _ = scenario_model(
        scenario,
        scenario.sensor[0],
        Wanted(("bias", "scale", "cross_axis"), ("drift",), prior=0.03, floor=0.0),
        120.0,
    )
    plan = design(
        Problem(model, Clock(120.0, settle=2.0, shortest=2.0)),
        effort=Effort(starts=6, rounds=1, trials=10),
    )
    designed = parse_scenario(
        designed_table(scenario, steps_of(plan, Still(scenario, 120.0).up(plan.angles)), "designed")
    )
    rng = rng_of("a calibration that fits a drift")
    squares, trials, sigma = (
        0.0,
        6,
        dict(
            zip(
                model.names,
                plan.forecast.sigma * np.array([_SI[u] for u in model.units]),
                strict=True,
            )
        ),
    )
    for k in range(trials):
        # 600 ug of drift
        truth = np.where(model.interest, 0.1 * rng.standard_normal(len(model.names)), 0.02)
        recording = MujocoLaboratory().record(
            drawn(plan, truth, designed), seed_of(f"fitted drift {k}")
        )
        windows = tmp_path / "segments.csv"
        windows.write_text(segments_csv(plan))
        found = calibrate(
            "six_position",
            recording,
            scenario,
            segments=read_segments(windows, recording),
            terms=["bias", "scale", "cross_axis", "drift"],
        )
        assert found.verdict == "good"
        true = {
            n: t * p * _SI[u]
            for n, t, p, u in zip(model.names, truth, model.prior, model.units, strict=True)
        }
        error = np.array([e.value - true[n] for n, e in found.parameters.items()])
        squares += float(error @ np.linalg.solve(found.covariance, error))
        assert not any("drift" in n for n in found.parameters)
        for name, estimate in found.parameters.items():
            assert estimate.sigma == pytest.approx(sigma[name], rel=0.15), name
    tail, p = FALSE_ALARM / 2, len(found.parameters)
    assert chi2.ppf(tail, trials * p) <= squares <= chi2.isf(tail, trials * p)
    without = calibrate(
        "six_position", recording, scenario, segments=read_segments(windows, recording)
    )
    assert without.verdict == "suspect"


_SI = {"ug": 1e-6 * G0, "ppm": 1e-6}
