"""The scenarios of the project are claims: each is accepted, and together they cover what is
promised.
"""

import re

import numpy as np
import pytest
from docs_examples import BLOCK, PAGES, commands_of

from tiltcal.api.simulating import simulator
from tiltcal.calibration.methods.registry import METHODS
from tiltcal.core.assets import folder
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.validation.acceptance import run_scenario

PATHS = sorted(folder("scenarios").glob("*.toml"))
SCENARIOS = {path.stem: load_scenario(path) for path in PATHS}
CLAIMS = [name for name, s in SCENARIOS.items() if s.method or s.estimator]


def shown_on_pages():
    """Claims that an example of a page runs and shows as accepted, a row a method: test_docs.py
    compares these.
    """
    found = set()
    for page in PAGES:
        for language, _, body in BLOCK.findall(page.read_text(encoding="utf-8")):
            for command, stated in commands_of(body) if language == "console" else ():
                names = re.findall(r"scenarios/(\w+)\.toml", command)
                methods = [m for name in names for m in SCENARIOS[name].method]
                words = [line.split()[-1] for line in stated.splitlines() if line.strip()]
                if command.startswith("tiltcal run ") and methods:
                    found |= set(names) if words.count("accepted") == len(methods) else set()
    return found


SHOWN = shown_on_pages()


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


@pytest.mark.parametrize("name", [name for name in CLAIMS if name not in SHOWN])
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


def test_a_claim_that_a_page_shows_has_limits():
    assert set(CLAIMS) > SHOWN
    for name in SHOWN:
        for method in SCENARIOS[name].method:
            stated = method.accept.model_fields_set - {"parameters"}
            assert method.accept.parameters or stated or method.expect != "good", name


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
