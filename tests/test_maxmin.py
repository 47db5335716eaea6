"""Blind to nothing: shares against the formula worked by hand, the bound, the gradient, the order."""

import json
import re

import numpy as np
import pytest
from statistics_helpers import rng_of

from tiltcal.cli import main
from tiltcal.cli.maxmin import summary
from tiltcal.design.classic import classic
from tiltcal.design.maxmin import (
    _falling,
    blind_to_nothing,
    grid_of_poses,
    merit,
    most_visible,
    shares,
    visible_in_time,
    visiting_order,
)  # fmt: skip
from tiltcal.design.signatures import EFFECTS, efficiency, left_over
from tiltcal.units import DEG


def reference(name):
    return most_visible(grid_of_poses(), np.eye(len(EFFECTS))[EFFECTS.index(name)])


def test_references_are_the_maxima_worked_by_hand_within_half_a_percent():
    """K2: sum of var(x_i^2) is at most 2/3, on the faces. |f| alike. Outer harmonic: cos^2 + sin^2 of a unit turn, 1."""
    for name, most in (("K2", 2 / 3), ("|f|", 2 / 3), ("outer 1st harmonic", 1.0)):
        _, reached, upper = reference(name)
        assert reached <= most * (1 + 1e-9)
        assert most <= upper * (1 + 1e-9)
        assert upper / reached < 1.005


def test_six_faces_are_blind_to_products_and_the_energy_of_K2_there_is_two_thirds():
    energy, _ = left_over(classic("six"), np.full(6, 1 / 6))
    mean = energy.mean(axis=0)
    assert mean[EFFECTS.index("K2")] == pytest.approx(2 / 3, abs=1e-6)
    assert mean[[EFFECTS.index(n) for n in ("K3", "Kip", "Kio", "Kpo")]] == pytest.approx(np.zeros(4), abs=1e-6)


def test_classic_schemes_are_blind_to_something_and_the_designed_one_is_not():
    found = blind_to_nothing(24, 0)
    for name, most in (("six", 1e-6), ("12", 1e-6), ("24", 0.05)):
        assert shares(classic(name), found.references).min() < most, name
    assert found.shares.min() >= 0.38
    assert found.efficiency >= 0.985
    assert found.reference_gap <= 0.005
    assert found.shares.min() <= found.bound <= 0.52  # K2 and the products of axes share: one half is the most for both
    assert min(found.drift, found.warmup) >= 0.9
    said = json.loads(json.dumps(summary(found)))
    assert said["least_share"] == pytest.approx(min(said["shares"][name] for name in EFFECTS))
    assert merit(found.angles, found.references) == pytest.approx(found.shares.min())


def test_the_bound_of_one_half_is_the_trade_of_K2_against_products():
    """E sum x_i^4 + 2 E sum_(i<j) x_i^2 x_j^2 = 1 for every design: as products want 1/9 each and K2 1/9 + 2/9, s = 1/2."""
    fourth_power, product = 0.5 * 2 / 9 + 1 / 9, 0.5 / 9
    assert 3 * fourth_power + 6 * product == pytest.approx(1.0)


def test_the_gradient_of_the_soft_minimum_is_its_slope():
    rng = rng_of("gradient of the soft minimum")
    angles = rng.uniform(-3, 3, (24, 2))
    references = np.ones(len(EFFECTS)) * 0.3
    _, slope = _falling(angles, references)
    for i in (0, 11, 30, 47):
        step = (1e-5 * np.eye(48)[i]).reshape(24, 2)
        numeric = (_falling(angles + step, references)[0] - _falling(angles - step, references)[0]) / 2e-5
        assert slope[i] == pytest.approx(numeric, rel=1e-3, abs=1e-4)


def test_the_order_hides_no_drift_though_the_poses_are_the_same():
    rng = rng_of("the order hides no drift")
    sweep = np.column_stack([np.linspace(0, 90, 19), np.zeros(19)]) * DEG
    assert visible_in_time(sweep)[0] < 0.01  # one way: hidden
    ordered, drift, warmup = visiting_order(sweep, rng)
    assert min(drift, warmup) > 0.8
    assert np.sort(ordered[:, 0]) == pytest.approx(sweep[:, 0])
    assert efficiency(ordered) == pytest.approx(efficiency(sweep))


def test_the_command_prints_the_bound_beside_the_least_share(tmp_path, capsys):
    words = ["design", "--textbook", "linear", "--budget-s", "500", "--blind-to-nothing", "24", "-o", str(tmp_path / "out")]
    assert main(words) == 0
    printed = capsys.readouterr().out
    least, bound = (float(re.search(text + r" ([0-9.]+)", printed)[1]) for text in ("least share", "no design can pass"))
    assert 0.38 <= least <= bound
    plan = json.loads((tmp_path / "out" / "design.json").read_text())
    assert plan["total_s"] <= 500 + 1e-6
    assert len(plan["poses"]) == 24
    assert (tmp_path / "out" / "steps.csv").exists()
