"""Goals of a design: how they read, and the least time that reaches them."""

import numpy as np
import pytest

import tiltcal as tc
from tiltcal.core.errors import TiltcalError
from tiltcal.design.goals import NEAR, goals_of, least_time
from tiltcal.design.model import Model

NAMES = ("bias_x", "bias_y", "bias_z", "scale_x", "drift_x")
MODEL = Model(
    names=NAMES,
    units=("ug", "ug", "ug", "ppm", "ug"),
    prior=np.ones(5),
    interest=np.array([True] * 4 + [False]),
    rows=lambda angles, _time: np.zeros((len(angles), 1, 5)),
    white=np.ones(1),
    floor=np.zeros(1),
    loss=np.eye(5),
    timed=False,
)


def test_a_goal_for_all_axes_in_another_unit():
    goals = goals_of(["bias=0.03mg", "tilt=0.01deg", "U=7"], MODEL)
    assert [g.name for g in goals] == ["tilt", "U", "bias_x", "bias_y", "bias_z"]
    assert [g.limit for g in goals] == pytest.approx([36.0, 7.0, 30.0, 30.0, 30.0])
    assert {g.unit for g in goals[2:]} == {"ug"}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("bias", "no KIND=SIGMA"),
        ("bias=-3", "need a positive number"),
        ("bias=0ug", "need a positive number"),
        ("bias=3arcsec", "unit arcsec"),
        ("bais=3", "did you mean"),
        ("drift=3", "a nuisance"),
        ("xyz=3", "need tilt, U, bias, scale; correct it"),
        ("bias=3furlong", "need one of .*; state it in ug"),
    ],
)
def test_what_is_no_goal_is_refused(text, said):
    with pytest.raises(TiltcalError, match=said):
        goals_of([text], MODEL)


@pytest.mark.parametrize("exponent", [0.3, 0.5, 2.0])
@pytest.mark.parametrize("needed", [31.0, 470.0, 990.0])
def test_the_least_time_is_found_to_three_percent(needed, exponent):
    tried = []

    def found_in(time):
        tried.append(time)
        if time < 30:
            raise TiltcalError("design", found="no time", need="more", do="wait")
        return (needed / time) ** exponent, time

    best = least_time(1000.0, 10.0, found_in)
    assert needed <= best <= NEAR * needed
    assert len(tried) <= (13 if needed < 100 else 8)  # below 30 s the law ends


def test_a_budget_that_reaches_nothing_is_used_whole_and_tried_once():
    tried = []
    assert least_time(100.0, 10.0, lambda time: (tried.append(time) or 1.1, time)) == 100.0
    assert tried == [100.0]


def test_a_design_for_a_goal_takes_the_least_time_that_reaches_it():
    scenario = tc.parse_scenario(
        {
            "schema": 1,
            "name": "goal",
            "site": {"gravity_m_s2": 9.81},
            "rig": {"table": "dual"},
            "sensor": [
                {
                    "name": "accel",
                    "kind": "accelerometer",
                    "rate_hz": 50,
                    "adjustable": ["bias", "scale"],
                }
            ],
            "effect": [{"id": "acc_noise", "white_ug_rthz": 60}],
        }
    )
    found = scenario.design(400, nuisance=(), goals=["accel.bias=16ug"], step_deg=45)
    assert found.reaches_goals
    reached = [goal["expected"] for goal in found.to_json()["goals"]]
    assert max(reached) <= 16
    assert "goal accel.bias_x 16 ug" in str(found)
    total = found.plan.problem.clock.budget
    assert total < 400
    shorter = scenario.design(total / 1.1, nuisance=(), goals=["accel.bias=16ug"], step_deg=45)
    assert not shorter.reaches_goals
    sigma = dict(zip(shorter.plan.problem.model.names, shorter.plan.forecast.sigma, strict=True))
    assert max(sigma[f"accel.bias_{axis}"] for axis in "xyz") > 16
    assert np.isclose(shorter.plan.problem.clock.budget, total / 1.1)
