"""The scenarios of the project are claims: each is accepted, and together they cover what is
promised.
"""

import numpy as np
import pytest

from tiltcal.api.simulating import simulator
from tiltcal.calibration.methods.registry import METHODS
from tiltcal.core.assets import folder
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.validation.acceptance import run_scenario

PATHS = sorted(folder("scenarios").glob("*.toml"))
SCENARIOS = {path.stem: load_scenario(path) for path in PATHS}
CLAIMS = [name for name, s in SCENARIOS.items() if s.method or s.estimator]


def by_algebra(scenario):
    """Whether nothing of it is left to mechanics: no time steps and no effect that MuJoCo's model
    takes on.
    """
    return scenario.dynamics is None and not any(
        getattr(e, "mechanised", False) for e in scenario.effects
    )


def test_there_are_claims_about_every_method():
    assert len(CLAIMS) >= 10
    named = {m.name for s in SCENARIOS.values() for m in s.method}
    assert named >= set(METHODS)
    assert {m.expect for s in SCENARIOS.values() for m in s.method} == {
        "good",
        "suspect",
        "cannot_tell",
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", CLAIMS)
def test_the_claim_holds_in_mujoco(name):
    result = run_scenario(SCENARIOS[name], simulator(), source=f"{name}.toml")
    broken = [
        f"{m.title}: {m.error or limit}"
        for m in result.methods
        for limit in (m.limits or [None])
        if m.error or limit is None or not limit.passed
    ]
    assert result.accepted, broken
    assert all(m.limits for m in result.methods)


@pytest.mark.parametrize("name", [name for name, s in SCENARIOS.items() if by_algebra(s)])
def test_the_closed_form_gives_the_recording_of_mujoco(name):
    scenario = SCENARIOS[name]
    mechanics, algebra = simulator().record(scenario), SimulatedLaboratory().record(scenario)
    np.testing.assert_array_equal(mechanics.time, algebra.time)
    assert mechanics.column_names == algebra.column_names
    for sensor in scenario.sensor:
        a, b = mechanics.sensor(sensor), algebra.sensor(sensor)
        # an angle, as a force
        size = scenario.site.gravity if sensor.kind == "inclinometer" else 1.0
        assert np.abs(a.values - b.values).max() * size < 1e-9, sensor.name


def test_most_scenarios_are_compared_with_the_closed_form():
    assert sum(map(by_algebra, SCENARIOS.values())) >= 10
