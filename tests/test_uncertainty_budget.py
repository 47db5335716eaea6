"""Uncertain references: sensitivities by hand, and the whole by Monte Carlo."""

import json
from dataclasses import replace

import numpy as np
import pytest
from statistics_helpers import rng_of

from tiltcal.calibration.methods import gyro_turns, norm, north_seeking
from tiltcal.calibration.methods.registry import METHODS, calibrate
from tiltcal.calibration.result import load_calibration
from tiltcal.cli import main
from tiltcal.core.assets import folder
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import ARCSEC, G0
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.reference_errors import with_reference_errors
from tiltcal.laboratory.scenario import Scenario, load_scenario
from tiltcal.setup.sources import SourceTable
from tiltcal.statistics.least_squares import CommonErrors, gauss_newton, linear_fit
from tiltcal.validation.cross_check import check
from tiltcal.validation.uncertainty_budget import budget_of, make_budget

LAB = SimulatedLaboratory()


def claim(name):
    return load_scenario(folder("scenarios") / f"{name}.toml")


SIX, LEVEL, NORTH = (
    claim("six_faces_dual"),
    claim("two_position_level"),
    claim("north_four_positions"),
)
FIELD = claim("fog_scale_by_hand").model_copy(update={"dynamics": None})


def tables(*entries):
    return [SourceTable.model_validate(e) for e in entries]


def stating(scenario, *entries):
    """The scenario with these sources instead of its own."""
    return scenario.model_copy(update={"budget": tuple(tables(*entries))})


def line(budget, words):
    return next(entry for entry in budget.lines if words in entry.name)


def test_gravity_is_scale_one_to_one_and_the_expanded_uncertainty_is_twice_the_rss():
    stated = stating(SIX, {"id": "gravity", "gravity_ppm": 10})
    found, budget = make_budget("six_position", LAB.record(SIX, 1), stated)
    gravity = line(budget, "gravity")
    for a in "xyz":
        assert gravity.contributions[f"accel.scale_{a}"] == pytest.approx(10e-6, rel=0.01)
        assert gravity.sensitivity(f"accel.scale_{a}") == pytest.approx(1e-6, rel=0.01)
    name = "accel.scale_x"
    alone = calibrate("six_position", LAB.record(SIX, 1), stating(SIX))
    combined = np.hypot(alone.parameters[name].sigma, 10e-6 * (1 + found.value(name)))
    assert budget.combined[name] == pytest.approx(combined, rel=1e-6)
    assert found.parameters[name].sigma == pytest.approx(combined, rel=1e-6)
    assert budget.expanded[name] == pytest.approx(2 * combined, rel=1e-6)
    assert budget.lines[0].kind == "A"
    assert json.loads(json.dumps(budget.to_json()))["coverage_factor"] == 2


def test_distributions_have_their_divisors():
    for distribution, divisor in (("normal", 1), ("rectangular", np.sqrt(3)), ("expanded", 2)):
        stated = stating(SIX, {"id": "gravity", "gravity_ppm": 12, "distribution": distribution})
        _, budget = make_budget("six_position", LAB.record(SIX, 1), stated)
        assert line(budget, "gravity").standard == pytest.approx(12 / divisor)


def test_by_hand_a_sensor_s_own_readings_stand_for_what_it_senses():
    hand = claim("norm_by_hand")
    biased = {"id": "acc_bias", "bias_x_ug": 10}
    stated = stating(hand, biased, {"id": "acc_scale", "scale_y_ppm": 7})
    _, budget = make_budget("norm", LAB.record(hand, 5), stated)
    assert line(budget, "bias_x").contributions["accel.bias_x"] == pytest.approx(
        10e-6 * G0, rel=1e-3
    )
    assert line(budget, "scale_y").contributions["accel.scale_y"] == pytest.approx(7e-6, rel=0.01)
    with pytest.raises(
        TiltcalError,
        match="table_levelling: found a hand-held instrument, need a table",
    ):
        make_budget(
            "norm",
            LAB.record(hand, 5),
            stating(hand, {"id": "table_levelling", "tilt_east_arcsec": 3}),
        )


def test_an_axis_error_of_the_fog_is_minus_du_over_u_in_the_scale():
    stated = stating(FIELD, {"id": "fog_axis", "axis_u_arcsec": 60, "axis_v_arcsec": 60})
    _, budget = make_budget("fog_scale", LAB.record(FIELD, 3), stated)
    # b1 over u = (1, 1, 1)/sqrt 3
    across = 60 * ARCSEC * np.array([1, -1, 0]) / np.sqrt(2) * np.sqrt(3)
    for a, size in zip("xyz", np.abs(across), strict=True):
        assert line(budget, "axis_u").contributions[f"gyro.scale_{a}"] == pytest.approx(
            size, rel=0.03, abs=1e-6
        )


def slower(scenario, rate_hz, without=()):
    """The claim at a lower sample rate, some effects left out: the budget's law is the same, its
    draws are cheaper.
    """
    sensors = [s.model_dump() | {"rate_hz": rate_hz} for s in scenario.sensor]
    effects = [e.model_dump() for e in scenario.effect if e.id not in without]
    return Scenario.model_validate(
        scenario.model_dump(by_alias=True) | {"sensor": sensors, "effect": effects}
    )


COARSE = [{"action": "rest", "dwell_s": 2}] + [
    {"action": "sweep", "outer_deg": end, "step_deg": 6, "dwell_s": 2, "rate_deg_s": 10}
    for end in (90, 0)
]
PLACING = Scenario.model_validate(
    claim("placing_table_one_axis").model_dump(by_alias=True) | {"sequence": COARSE}
)
QUICK = ("placing_table", "two_position")  # to draw
SOURCES = {
    "placing_table": (
        slower(PLACING, 10),
        tables(
            {"id": "table_levelling", "tilt_east_arcsec": 2},
            {
                "id": "table_axis_wobble",
                "axis": "outer",
                "p2c_arcsec": 1.5,
                "m1s_arcsec": 1.5,
                "distribution": "rectangular",
            },
            {"id": "table_index_error", "axis": "outer", "sigma_arcsec": 300},
        ),
        {"harmonics": 2},
        150,
    ),
    "norm": (
        slower(claim("norm_by_hand"), 25),
        tables(
            {"id": "gravity", "gravity_ppm": 10},
            {"id": "acc_K3", "k3_x_ug_g3": 20, "k3_z_ug_g3": 10},
        ),
        {"terms": 9},
        250,
    ),
    "gyro_turns": (
        slower(claim("gyro_turns_by_hand"), 25),
        tables({"id": "acc_cross_axis", "cross_xy_ppm": 400, "cross_zx_ppm": 400}),
        {},
        100,
    ),
    "gyro_rates": (
        slower(claim("gyro_rates_three"), 25, ["gyr_gsens"]),
        tables(
            {"id": "axis_nonorthogonality", "outer_middle_arcsec": 60, "middle_inner_arcsec": 60},
            {
                "id": "gyr_gsens",
                "gsens_xz_deg_h_g": 20,
                "gsens_zz_deg_h_g": 20,
                "distribution": "rectangular",
            },
        ),
        {},
        150,
    ),
    "six_position": (SIX, list(SIX.budget), {}, 250),
    "two_position": (
        LEVEL,
        tables(
            {
                "id": "table_axis_wobble",
                "axis": "outer",
                "p2c_arcsec": 3,
                "m1s_arcsec": 3,
                "distribution": "rectangular",
            },
            {"id": "gravity", "gravity_ppm": 100},
            {"id": "acc_K3", "k3_x_ug_g3": 20, "k3_y_ug_g3": 20},
        ),
        {},
        250,
    ),
    "north": (
        NORTH,
        tables({"id": "fog_axis", "axis_u_arcsec": 400}, {"id": "gravity", "gravity_ppm": 100}),
        {},
        250,
    ),
    "fog_scale": (
        FIELD,
        tables({"id": "fog_axis", "axis_u_arcsec": 30, "axis_v_arcsec": 30}),
        {},
        200,
    ),
}


@pytest.mark.parametrize("method", list(SOURCES))
def test_every_method_has_a_budget_of_the_usual_sources_that_leaves_the_fit_alone(method):
    assert method in METHODS
    scenario, _, options, _ = SOURCES[method]
    scenario = scenario.model_copy(update={"dynamics": None, "budget": ()})
    if method == "gyro_rates":
        options = {"terms": ["bias", "scale", "cross_axis", "gsens"]}
    log = LAB.record(scenario, 2)
    found, budget = make_budget(method, log, scenario, **options)
    alone = calibrate(method, log, scenario, **options)
    assert found.parameters.keys() == alone.parameters.keys()
    for name, e in found.parameters.items():
        assert e.value == pytest.approx(alone.value(name), rel=1e-9, abs=1e-15)
        assert e.sigma == pytest.approx(alone.parameters[name].sigma, rel=1e-9)
        assert np.isfinite(budget.combined[name])
        assert budget.combined[name] >= e.sigma * (1 - 1e-12)
    assert len(budget.lines) > 1
    assert all(r.assumed for r in found.references)


def same_as_drawn(method, draws, monkeypatch):
    """Spread over new noise and new errors in every draw, over the combined uncertainty (of each
    draw itself: the noise is estimated), by parameter; and chi-square over its degrees of freedom.

    The allowance of `north` for a walk of the FOG's bias is left out: the draws have none
    (test_screen.py tests it). Held-out errors change no parameter.
    """
    monkeypatch.setattr(north_seeking, "walk_density", lambda *_: 0.0)
    monkeypatch.setattr(norm, "leave_directions_out", lambda *_: (0.0, 1.0))
    monkeypatch.setattr(gyro_turns, "_held_out", lambda *_: 0.0)
    scenario, stated, options, _ = SOURCES[method]
    scenario = Scenario.model_validate(scenario.model_dump(by_alias=True) | {"dynamics": None})
    scenario = scenario.model_copy(update={"budget": tuple(stated)})
    values, sigmas, ratios = [], [], []
    for k in range(10_000, 10_000 + draws):
        log = LAB.record(with_reference_errors(scenario, k), k)
        found = calibrate(method, log, scenario, **options)
        # the Earth's rate is a part of it
        names = [n for n in found.parameters if not (method == "fog_scale" and ".bias_" in n)]
        values.append([found.value(n) for n in names])
        sigmas.append([found.parameters[n].sigma for n in names])
        ratios.append(found.chi2_per_dof if found.dof else 1.0)
    U = np.sqrt(np.mean(np.square(sigmas), axis=0))
    return dict(zip(names, np.std(values, axis=0, ddof=1) / U, strict=True)), np.mean(ratios)


@pytest.mark.parametrize(
    "method",
    [m if m in QUICK else pytest.param(m, marks=pytest.mark.long) for m in SOURCES],
)
def test_the_uncertainty_is_the_spread_of_a_monte_carlo(method, monkeypatch):
    """To five per cent, plus 3.5 standard deviations of chance: 1 / sqrt(2 draws) each."""
    draws = SOURCES[method][3]
    ratio, chi2_per_dof = same_as_drawn(method, draws, monkeypatch)
    sizes = np.array(list(ratio.values()))
    assert np.all(np.abs(sizes - 1) < 0.05 + 3.5 / np.sqrt(2 * draws)), ratio
    assert chi2_per_dof == pytest.approx(1.0, abs=0.1)


@pytest.mark.long
@pytest.mark.parametrize("method", ["six_position", "two_position", "placing_table", "norm"])
def test_the_uncertainty_of_every_parameter_is_right_to_five_per_cent(method, monkeypatch):
    """4000 draws: the standard deviation of a ratio is 1.1 per cent."""
    ratio, _ = same_as_drawn(method, 4000, monkeypatch)
    assert all(abs(r - 1) < 0.05 for r in ratio.values()), ratio


HEAD = stating(
    SIX,
    *({"id": "table_index_error", "axis": a, "sigma_arcsec": 10} for a in ("outer", "inner")),
)


def test_a_dividing_head_that_is_stated_fits():
    """Ten arcsec of index error are 48 ug at one stop, thirty times the noise of its mean."""
    logs = [LAB.record(with_reference_errors(HEAD, k), 500 + k) for k in range(20)]
    fits = [calibrate("six_position", log, HEAD) for log in logs]
    alone = [calibrate("six_position", log, stating(SIX)) for log in logs]
    assert sum(f.verdict == "suspect" for f in alone) >= 18
    assert sum(f.verdict == "good" for f in fits) >= 19
    dof = sum(f.dof for f in fits)
    assert np.mean([f.chi2_per_dof for f in fits]) == pytest.approx(1.0, abs=4 * np.sqrt(2 / dof))


def test_over_temperature_a_stated_head_fits_too():
    """Blocks that are left out lie at stops of their own: the held-out test counts with both."""
    head = {"id": "table_index_error", "axis": "outer", "sigma_arcsec": 60}
    scenario = Scenario.model_validate(
        claim("thermal_six_faces").model_dump(by_alias=True) | {"dynamics": None, "budget": [head]}
    )
    log = LAB.record(with_reference_errors(scenario, 1), 1)
    found = calibrate("thermal", log, scenario)
    assert found.verdict == "good"
    assert found.chi2_per_dof == pytest.approx(1.0, abs=0.1)
    assert calibrate("thermal", log, stating(scenario)).verdict == "suspect"
    wide = found.parameters["accel.cross_yz"].sigma
    assert found.references[0].contributions["accel.cross_yz"] > 0.5 * wide


def test_check_counts_with_the_same_references():
    """Of a calibration on a perfect table, on recordings with a dividing head of 10 arcsec."""
    found = calibrate("six_position", LAB.record(SIX, 1), stating(SIX))
    logs = [LAB.record(with_reference_errors(HEAD, k), 700 + k) for k in range(10)]
    again = [check(found, log, HEAD) for log in logs]
    assert sum(c.accepted for c in again) >= 9
    rms = np.sqrt(np.mean([c.rms**2 for c in again]))
    expected = np.sqrt(np.mean([c.expected**2 for c in again]))
    assert rms == pytest.approx(expected, rel=3.5 / np.sqrt(2 * 120))  # 12 directions each


def test_the_split_is_written_and_read_back(tmp_path):
    found = calibrate("six_position", LAB.record(SIX, 1), SIX)
    found.save(tmp_path / "CAL.json")
    table = json.loads((tmp_path / "CAL.json").read_text(encoding="utf-8"))
    assert table["references"][0]["name"] == found.references[0].name
    again = load_calibration(tmp_path / "CAL.json")
    assert again.references == found.references
    assert budget_of(again).combined == pytest.approx(
        {n: e.sigma for n, e in found.parameters.items()}, rel=1e-9
    )
    del table["references"], table["provenance"]["setup"]["budget"]
    (tmp_path / "CAL.json").write_text(json.dumps(table), encoding="utf-8")
    older = load_calibration(tmp_path / "CAL.json")
    assert older.references == []
    with pytest.raises(TiltcalError, match="no uncertain references"):
        budget_of(older)


def test_unknown_sources_are_refused_in_words():
    log = LAB.record(SIX, 1)
    with pytest.raises(
        TiltcalError,
        match=(
            r"budget 1: found source 'gravty', need an effect, or one of .*; did you mean 'gravity'"
        ),
    ):
        calibrate("six_position", log, stating(SIX, {"id": "gravty", "gravity_ppm": 1}))
    field = LAB.record(FIELD, 1)
    with pytest.raises(TiltcalError, match=r"axis_w_arcsec.*axis_v"):
        calibrate("fog_scale", field, stating(FIELD, {"id": "fog_axis", "axis_w_arcsec": 1}))
    level = stating(FIELD, {"id": "table_levelling", "tilt_east_arcsec": 3})
    with pytest.raises(TiltcalError, match="found a hand-held instrument"):
        calibrate("fog_scale", field, level)
    level = stating(SIX, {"id": "table_levelling", "tilt_up_arcsec": 3})
    with pytest.raises(TiltcalError, match="budget 1 table_levelling"):
        calibrate("six_position", log, level)


def test_the_command_prints_the_budget_and_puts_it_into_json(tmp_path, capsys):
    path = folder("scenarios") / "six_faces_dual.toml"
    assert main(["simulate", str(path), "-o", str(tmp_path / "run.csv")]) == 0
    words = [
        "calibrate",
        str(tmp_path / "run.csv"),
        "--scenario",
        str(path),
        "--method",
        "six_position",
        "--budget",
    ]
    capsys.readouterr()
    assert main(words) == 0
    shown = capsys.readouterr().out
    assert "uncertainty budget (GUM)" in shown
    assert "expanded, k = 2" in shown
    assert main([*words, "--json"]) == 0
    table = json.loads(capsys.readouterr().out)["budget"]
    assert [entry["kind"] for entry in table["lines"]][:2] == ["A", "B"]


def test_the_report_holds_the_budget_of_a_scenario_that_names_sources(tmp_path):
    text = (folder("scenarios") / "six_faces_dual.toml").read_text(encoding="utf-8")
    (tmp_path / "one.toml").write_text(text.replace("runs = 50", "runs = 1"), encoding="utf-8")
    main(["run", str(tmp_path / "one.toml"), "-o", str(tmp_path / "out")])
    report = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "uncertainty budget: parameter" in report
    assert "table_index_error[outer] sigma" in report


@pytest.mark.parametrize("nonlinear", [False, True])
def test_the_posterior_of_a_common_error_is_that_of_a_parameter_with_a_prior(nonlinear):
    """A common error as one more column with a row for its prior, solved by hand."""
    rng = rng_of("posterior of common errors")
    A, U = rng.normal(size=(20, 3)), rng.normal(size=(20, 2))
    y = A @ [1.0, -2.0, 0.5] + U @ [0.7, -1.2] + rng.normal(size=20)
    names, common = ["a", "b", "c"], CommonErrors(U, np.array([True, True]))
    if nonlinear:
        fit, _ = gauss_newton(names, np.zeros(3), lambda x: (A @ x - y, A), common=common)
        fit = replace(fit, posterior=fit.posterior * [[-1.0], [1.0]])  # of the residuals
    else:
        fit = linear_fit(names, A, y, common)
    whole = np.vstack([np.hstack([A, U]), np.hstack([np.zeros((2, 3)), np.eye(2)])])
    covariance = np.linalg.inv(whole.T @ whole)
    expected = covariance @ whole.T @ np.append(y, [0.0, 0.0])
    np.testing.assert_allclose(fit.values, expected[:3], rtol=1e-6)
    np.testing.assert_allclose(fit.posterior[0], expected[3:], rtol=1e-6)
    np.testing.assert_allclose(fit.posterior[1], np.sqrt(np.diag(covariance)[3:]), rtol=1e-6)
