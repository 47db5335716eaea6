"""Blind to nothing: shares against the formula worked by hand, the bounds, the gradient, the
order.
"""

import json
import re
from functools import cache

import numpy as np
import pytest
from statistics_helpers import rng_of

from tiltcal.cli import main
from tiltcal.cli.design import TEXTBOOK, summary
from tiltcal.core.units import DEG
from tiltcal.design.classic import classic
from tiltcal.design.maxmin import (
    REQUIRED,
    Goal,
    _falling,
    goal_of,
    grid_of_poses,
    maximise_least_visibility,
    most_log_det,
    most_visible,
)
from tiltcal.design.signatures import Field, catalogue_signatures
from tiltcal.design.static_instrument import Still
from tiltcal.design.time_budget import Clock
from tiltcal.design.visit_order import energies_in_order, visiting_order
from tiltcal.effects import CATALOGUE
from tiltcal.laboratory.scenario import parse_scenario

LISTED = (
    "acc_K2",
    "acc_K3",
    "acc_Kip",
    "acc_Kio",
    "acc_Kpo",
    "acc_scale_asym",
    "acc_bias_asym",
    "table_encoder_eccentricity",
    "table_encoder_2rev",
)
"""Second and third order, kinks, table harmonics: the effects of the table of classic schemes."""


@cache
def effects_of(table="dual", only=()):
    scenario = parse_scenario(TEXTBOOK | {"rig": {"table": table}})
    still = Still(scenario, 500.0)
    return catalogue_signatures(
        still, scenario.sensor[0], grid_of_poses(clock_of(still)), only=only
    )


def clock_of(still):
    return Clock(500.0, limits=(None,) * len(still.axes))


@cache
def goal(only=()):
    seen = effects_of("dual", only)
    return goal_of(seen, Field(seen, grid_of_poses(clock_of(seen.still))))[0]


def test_references_are_the_maxima_worked_by_hand_within_half_a_percent():
    """K2: sum of var(x_i^2) is at most 2/3, on the faces. |f| alike. Outer harmonic: cos^2 + sin^2
    of a unit turn, 1.
    """
    seen = effects_of("dual", LISTED)
    level = (Field(seen, np.zeros((1, 2))).E ** 2).sum(axis=1)[
        0
    ] @ seen.member  # z loaded alone: one coefficient's square
    for name, most in (
        ("acc_K2", 2 / 3),
        ("acc_scale_asym", 2 / 3),
        ("table_encoder_eccentricity outer", 1.0),
    ):
        k = seen.names.index(name)
        reached, upper = (
            e / level[k] for e in most_visible(Field(seen, grid_of_poses(Clock(500))).only(k))
        )
        assert reached <= most * (1 + 1e-6)
        assert most <= upper * (1 + 1e-6)
        assert upper / reached < 1.005


def test_six_faces_show_K2_and_none_of_the_products_and_cubes():
    seen = effects_of("dual", LISTED)
    left = Field(seen, classic("six")).left_over(np.full(6, 1 / 6)).mean(axis=0)
    whole = (Field(seen, np.ones((1, 2))).E ** 2).sum(axis=1)[0] @ seen.member
    assert (
        left[seen.names.index("acc_K2")] > 0.5 * goal(LISTED).references[seen.names.index("acc_K2")]
    )
    for name in ("acc_K3", "acc_Kip", "acc_Kio", "acc_Kpo"):
        assert left[seen.names.index(name)] < 1e-6 * whole[seen.names.index(name)]


def test_six_faces_have_all_of_the_linear_D_efficiency():
    """det(F'F / n)^(1/4) = 27^(-1/4) for 1, x, y, z with E x^2 = 1/3."""
    field = Field(effects_of(), grid_of_poses(Clock(500)))
    assert most_log_det(field) == pytest.approx(-np.log(27) / 4, abs=1e-3)
    assert goal().efficiency(classic("six")) == pytest.approx(1.0, abs=1e-3)


def test_every_effect_of_the_catalogue_is_in_one_of_the_lists():
    seen = effects_of()
    told = {name.split()[0] for name in (*seen.names, *seen.in_order, *seen.ordinary, *seen.unseen)}
    for id, cls in CATALOGUE.items():
        here = not cls.kinds or "accelerometer" in cls.kinds
        if (
            here
            and not cls.random
            and not cls.of_model
            and cls.stage not in ("data", "timing")
            and not id.startswith(("servo", "adc_stuck", "acc_sat"))
        ):
            assert id in told, id
    assert {"gravity_magnitude", "mount_misalignment"} <= set(seen.ordinary)
    assert {"lever_arm", "acc_bandwidth", "acc_vre"} <= set(seen.unseen)
    assert {"acc_hysteresis", "table_backlash outer", "acc_drift", "cable_torque inner"} <= set(
        seen.in_order
    )


def test_classic_schemes_are_blind_to_something_and_the_designed_one_is_not():
    seen = effects_of()
    found = maximise_least_visibility(seen, Clock(500), 24, 0)
    judge = Goal(seen, found.references, goal().log_det)
    for name, most in (("six", 1e-6), ("12", 1e-6), ("24", 0.05)):
        assert judge.shares(classic(name)).min() < most, name
    assert found.efficiency >= REQUIRED
    assert found.reference_gap <= 0.005
    # nothing is left on the table
    assert 0.99 * found.bounds[1] <= found.shares.min() <= found.bounds[1] <= found.bounds[0]
    assert min(found.in_order.values()) >= 0.5
    said = json.loads(json.dumps(summary(found)))
    assert said["least_share"] == pytest.approx(min(said["shares"].values()))
    assert not set(said["unseen"]) & (set(said["shares"]) | set(said["in_order"]))


def test_second_and_third_order_kinks_and_harmonics_share_one_half():
    """K2 against products: E sum x_i^4 + 2 E sum_(i<j) x_i^2 x_j^2 = 1 for every design, so that no
    design passes 1/2.
    """
    fourth_power, product = 0.5 * 2 / 9 + 1 / 9, 0.5 / 9
    assert 3 * fourth_power + 6 * product == pytest.approx(1.0)
    found = maximise_least_visibility(effects_of("dual", LISTED), Clock(500), 24, 0)
    assert found.shares.min() >= 0.38
    assert found.efficiency >= REQUIRED
    assert found.shares.min() <= found.bounds[0] <= 0.51


@pytest.mark.parametrize("table", ["placing", "three"])
def test_other_tables_have_such_designs_too(table):
    seen = effects_of(table)
    found = maximise_least_visibility(seen, clock_of(seen.still), 24, 0, starts=2)
    assert found.shares.min() > 0.35
    assert found.efficiency >= REQUIRED
    assert found.angles.shape == (24, {"placing": 1, "three": 2}[table])


def test_the_gradient_of_the_soft_minimum_is_its_slope():
    rng = rng_of("gradient of the soft minimum")
    angles = rng.uniform(-3, 3, (24, 2))
    _, slope = _falling(angles, goal())
    for i in (0, 11, 30, 47):
        step = (1e-5 * np.eye(48)[i]).reshape(24, 2)
        numeric = (_falling(angles + step, goal())[0] - _falling(angles - step, goal())[0]) / 2e-5
        assert slope[i] == pytest.approx(numeric, rel=2e-3, abs=1e-3)


def test_the_order_hides_no_drift_and_no_direction_though_the_poses_are_the_same():
    seen = effects_of()
    rng = rng_of("the order hides no drift")
    sweep = np.column_stack([np.linspace(0, 90, 19), np.zeros(19)]) * DEG
    one_way = energies_in_order(seen, sweep, Clock(500))
    ordered, shares = visiting_order(seen, sweep, Clock(500), rng)
    either = energies_in_order(seen, ordered, Clock(500))
    assert np.sort(ordered[:, 0]) == pytest.approx(sweep[:, 0])
    assert one_way["acc_drift"] < 0.02 * either["acc_drift"]
    assert one_way["table_backlash outer"] < 0.1 * either["table_backlash outer"]
    assert shares["acc_drift"] > 0.8
    assert shares["table_backlash outer"] > 0.5


def test_the_command_prints_the_bounds_beside_the_least_share_and_what_is_out_of_reach(
    tmp_path, capsys
):
    words = [
        "design",
        "--textbook",
        "linear",
        "--budget-s",
        "500",
        "--all-effects-observable",
        "24",
        "-o",
        str(tmp_path / "out"),
    ]
    assert main(words) == 0
    printed = capsys.readouterr().out
    least, bound = (
        float(re.search(text + r" ([0-9.]+)", printed)[1])
        for text in ("least share", "linear D-efficiency")
    )
    assert least <= bound
    assert "absorbed by bias, scale and cross-axis terms: gravity_magnitude" in printed
    assert re.search(r"acc_bandwidth.*: needs moves", printed)
    plan = json.loads((tmp_path / "out" / "design.json").read_text())
    assert plan["total_s"] <= 500 + 1e-6
    assert len(plan["poses"]) == 24
    assert (tmp_path / "out" / "steps.csv").exists()
