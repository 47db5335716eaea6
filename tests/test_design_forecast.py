"""What a design promises against what comes of it: instruments drawn from the prior, recorded through MuJoCo, estimated."""

import numpy as np
import pytest
from scipy.stats import chi2
from statistics_helpers import FALSE_ALARM, rng_of, seed_of

from tiltcal.design.ascent import Problem
from tiltcal.design.clock import Clock
from tiltcal.design.plan import Plan, design
from tiltcal.design.search import Effort
from tiltcal.design.steps import designed_table, steps_of
from tiltcal.design.still import Still
from tiltcal.design.terms import Wanted, scenario_model
from tiltcal.scenario import Scenario, parse_scenario
from tiltsim.laboratory import MujocoLaboratory

TRIALS, WHITE = 40, 200.0
CASES = {
    "bias, scale, cross-axis": (("bias", "scale", "cross_axis"), ()),
    "K2 and K3 with a drift": (("bias", "scale", "cross_axis", "K2", "K3"), ("drift",)),
    "with an eccentric encoder": (("bias", "scale", "cross_axis"), ("drift", "table_encoder_eccentricity")),
}


def scenario_of() -> Scenario:
    return parse_scenario(
        {
            "schema": 1, "name": "forecast", "site": {"gravity_m_s2": 9.80123}, "rig": {"table": "dual"},
            "sensor": [{"name": "accel", "kind": "accelerometer", "rate_hz": 20}],
            "effect": [{"id": "acc_noise", "white_ug_rthz": WHITE}],
        }
    )  # fmt: skip


def planned(case: str) -> tuple[Scenario, Plan, Scenario]:
    """A scenario, its design for 120 s, and the scenario that follows it."""
    scenario = scenario_of()
    interest, nuisance = CASES[case]
    model, _ = scenario_model(scenario, scenario.sensor[0], Wanted(interest, nuisance, "precision", floor=0.0), 120.0)
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
        "bias": "acc_bias", "scale": "acc_scale", "cross": "acc_cross_axis", "k2": "acc_K2", "k3": "acc_K3", "drift": "acc_drift"
    }  # fmt: skip
    for name, unit, size, value in zip(model.names, model.units, model.prior, truth, strict=True):
        owner, _, bare = name.partition(".")
        table_axis = owner.partition("[")[2].rstrip("]")
        id = owner.partition("[")[0] if table_axis else stems[bare.partition("_")[0]]
        assert id in CATALOGUE
        where = {"axis": table_axis} if table_axis else {"sensor": "accel"}
        tables.setdefault((id, table_axis), {"id": id, **where})[f"{bare}_{unit}"] = float(size * value)
    noise = {"id": "acc_noise", "sensor": "accel", "white_ug_rthz": WHITE}
    stated = designed.model_dump(exclude_none=True, exclude_defaults=True, by_alias=True, exclude={"effect"})
    return parse_scenario({"schema": 1, **stated, "effect": [noise, *tables.values()]})


def estimated(plan: Plan, scenario: Scenario, seed: int) -> np.ndarray:
    """Posterior mean of the parameters, in units of the prior, from the readings inside each dwell's window."""
    recording = MujocoLaboratory().record(scenario, seed)
    readings = np.column_stack([recording.column(f"accel_{a}_m_s2") for a in "xyz"])
    model, clock = plan.problem.model, plan.problem.clock
    middles = clock.middles(plan.angles, plan.dwell)
    ideal = scenario.site.gravity * Still(scenario, clock.budget).up(plan.angles)
    inside = [(recording.time >= m - d / 2) & (recording.time <= m + d / 2) for m, d in zip(middles, plan.dwell, strict=True)]
    means = np.array([readings[rows].mean(axis=0) for rows in inside]) - ideal
    root = np.sqrt(model.weights(plan.dwell))
    design_matrix = (model.rows(plan.angles, middles) * root[:, :, None]).reshape(-1, len(model.names))
    information = np.eye(len(model.names)) + design_matrix.T @ design_matrix
    return np.linalg.solve(information, design_matrix.T @ (means * root).ravel())


@pytest.mark.slow
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
