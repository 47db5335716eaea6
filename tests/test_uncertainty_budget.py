"""The uncertainty budget: sensitivities by hand, and the whole by Monte Carlo."""

import json

import numpy as np
import pytest
from statistics_helpers import rng_of

from tiltcal.calibration.methods import gyro_turns, norm, north_seeking
from tiltcal.calibration.methods.registry import METHODS, calibrate
from tiltcal.cli import main
from tiltcal.core.assets import folder
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import ARCSEC, G0
from tiltcal.effects import make_effect
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import Scenario, load_scenario
from tiltcal.laboratory.scenario_tables import SourceTable
from tiltcal.validation.uncertainty_budget import make_budget

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


def line(budget, words):
    return next(entry for entry in budget.lines if words in entry.name)


def test_gravity_is_scale_one_to_one_and_the_expanded_uncertainty_is_twice_the_rss():
    found, budget = make_budget(
        "six_position", LAB.record(SIX, 1), SIX, tables({"id": "gravity", "gravity_ppm": 10})
    )
    gravity = line(budget, "gravity")
    for a in "xyz":
        assert gravity.contributions[f"accel.scale_{a}"] == pytest.approx(10e-6, rel=0.01)
        assert gravity.sensitivity(f"accel.scale_{a}") == pytest.approx(1e-6, rel=0.01)
    name = "accel.scale_x"
    combined = np.hypot(found.parameters[name].sigma, 10e-6 * (1 + found.value(name)))
    assert budget.combined[name] == pytest.approx(combined, rel=1e-6)
    assert budget.expanded[name] == pytest.approx(2 * combined, rel=1e-6)
    assert budget.lines[0].kind == "A"
    assert json.loads(json.dumps(budget.to_json()))["coverage_factor"] == 2


def test_distributions_have_their_divisors():
    for distribution, divisor in (("normal", 1), ("rectangular", np.sqrt(3)), ("expanded", 2)):
        stated = tables({"id": "gravity", "gravity_ppm": 12, "distribution": distribution})
        _, budget = make_budget("six_position", LAB.record(SIX, 1), SIX, stated)
        assert line(budget, "gravity").standard == pytest.approx(12 / divisor)


def test_by_hand_a_sensor_s_own_readings_stand_for_what_it_senses():
    hand = claim("norm_by_hand")
    stated = tables({"id": "acc_bias", "bias_x_ug": 10}, {"id": "acc_scale", "scale_y_ppm": 7})
    _, budget = make_budget("norm", LAB.record(hand, 5), hand, stated)
    assert line(budget, "bias_x").contributions["accel.bias_x"] == pytest.approx(
        10e-6 * G0, rel=1e-3
    )
    assert line(budget, "scale_y").contributions["accel.scale_y"] == pytest.approx(7e-6, rel=0.01)
    with pytest.raises(
        TiltcalError,
        match="gravity_magnitude: found a hand-held instrument, need an effect of a sensor",
    ):
        make_budget(
            "norm",
            LAB.record(hand, 5),
            hand,
            tables({"id": "gravity_magnitude", "gravity_error_ppm": 10}),
        )


def test_an_axis_error_of_the_fog_is_minus_du_over_u_in_the_scale():
    stated = tables({"id": "fog_axis", "axis_u_arcsec": 60, "axis_v_arcsec": 60})
    _, budget = make_budget("fog_scale", LAB.record(FIELD, 3), FIELD, stated)
    # b1 over u = (1, 1, 1)/sqrt 3
    across = 60 * ARCSEC * np.array([1, -1, 0]) / np.sqrt(2) * np.sqrt(3)
    for a, size in zip("xyz", np.abs(across), strict=True):
        assert line(budget, "axis_u").contributions[f"gyro.scale_{a}"] == pytest.approx(
            size, rel=0.03, abs=1e-6
        )


def drawn(scenario, table, rng):
    """The laboratory with an error of one source drawn from its distribution."""
    effects = []
    id = {"gravity": "gravity_magnitude", "fog_axis": "fog_axis_error"}.get(table.id, table.id)
    for key, size in table.model_extra.items():
        key = key.replace("gravity_ppm", "gravity_error_ppm")
        flat = table.distribution == "rectangular"
        value = rng.uniform(-size, size) if flat else rng.normal(0, size)
        if id == "table_index_error":  # the effect draws a normal one at each stop itself
            value = size / np.sqrt(3) if flat else size
        effects.append(
            make_effect(id, {key: value}, scenario, sensor=table.sensor, axis=table.axis)
        )
    return effects


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
        250,
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
        500,
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


@pytest.mark.parametrize("method", [m for m in SOURCES if m != "placing_table"])
def test_every_method_has_a_budget_of_the_usual_sources(method):
    """The placing table has an index error at each stop: its budget is in the Monte Carlo."""
    assert method in METHODS
    scenario, _, options, _ = SOURCES[method]
    scenario = scenario.model_copy(update={"dynamics": None})
    if method == "gyro_rates":
        options = {"terms": ["bias", "scale", "cross_axis", "gsens"]}
    # a long log: one source will do
    few = tables({"id": "gravity", "gravity_ppm": 10}) if method == "gyro_turns" else ()
    found, budget = make_budget(method, LAB.record(scenario, 2), scenario, few, **options)
    assert all(
        np.isfinite(u) and u >= found.parameters[n].sigma for n, u in budget.combined.items()
    )
    assert len(budget.lines) > 1


@pytest.mark.parametrize(
    "method",
    [m if m == "placing_table" else pytest.param(m, marks=pytest.mark.long) for m in SOURCES],
)
def test_the_combined_uncertainty_is_the_spread_of_a_monte_carlo_to_five_per_cent(
    method, monkeypatch
):
    """New noise and new errors in every draw; rms over the parameters, whose own chance is some
    three per cent each. The allowance of `north` for a walk of the FOG's bias is left out: the
    draws have none (test_screen.py tests it). Held-out errors change no parameter.
    """
    monkeypatch.setattr(north_seeking, "walk_density", lambda *_: 0.0)
    monkeypatch.setattr(norm, "leave_directions_out", lambda *_: (0.0, 1.0))
    monkeypatch.setattr(gyro_turns, "_held_out", lambda *_: 0.0)
    scenario, stated, options, draws = SOURCES[method]
    scenario = Scenario.model_validate(scenario.model_dump(by_alias=True) | {"dynamics": None})
    rng, values = rng_of(f"budget {method}"), []
    _, budget = make_budget(method, LAB.record(scenario, 5), scenario, stated, **options)
    # the Earth's rate is a part of it
    names = [n for n in budget.units if not (method == "fog_scale" and ".bias_" in n)]
    ordinary = scenario.effects
    for k in range(draws):
        copy = scenario.model_copy()
        copy.__dict__["effects"] = (
            *ordinary,
            *(e for t in stated for e in drawn(scenario, t, rng)),
        )
        found = calibrate(method, LAB.record(copy, 10_000 + k), scenario, **options)
        values.append([found.value(n) for n in names])
    ratio = np.std(values, axis=0, ddof=1) / np.array([budget.combined[n] for n in names])
    assert np.sqrt(np.mean(ratio**2)) == pytest.approx(1.0, abs=0.05), dict(
        zip(names, ratio.round(3), strict=True)
    )
    assert np.all(np.abs(ratio - 1) < 0.05 + 3.5 / np.sqrt(2 * draws)), dict(
        zip(names, ratio.round(3), strict=True)
    )


def test_unknown_sources_are_refused_in_words():
    log = LAB.record(SIX, 1)
    with pytest.raises(
        TiltcalError,
        match=(
            r"budget 1: found source 'gravty', need an effect, or one of .*; did you mean 'gravity'"
        ),
    ):
        make_budget("six_position", log, SIX, tables({"id": "gravty", "gravity_ppm": 1}))
    with pytest.raises(TiltcalError, match="need axis_u or axis_v"):
        make_budget(
            "fog_scale", LAB.record(FIELD, 1), FIELD, tables({"id": "fog_axis", "axis_w_arcsec": 1})
        )
    with pytest.raises(TiltcalError, match="found a hand-held instrument"):
        make_budget(
            "fog_scale",
            LAB.record(FIELD, 1),
            FIELD,
            tables({"id": "table_levelling", "tilt_east_arcsec": 3}),
        )
    with pytest.raises(TiltcalError, match="budget 1 table_levelling"):
        make_budget(
            "six_position", log, SIX, tables({"id": "table_levelling", "tilt_up_arcsec": 3})
        )


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
