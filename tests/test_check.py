"""check: every method accepts its own and another recording of the same instrument, and refuses one
that has changed, naming what; slow noise is in its expectation.
"""

import tomllib
from pathlib import Path

import numpy as np
import pytest

import tiltcal as tc
from tiltcal.cli import main

SCENARIOS = Path(__file__).parents[1] / "scenarios"
CASES = {
    "six_faces_dual": ("six_position", "tilt", ("acc_scale", "scale_x_ppm", 10000)),
    "norm_by_hand": ("norm", "tilt", ("acc_scale", "scale_x_ppm", 10000)),
    "tumble_inclinometer": ("six_position", "tilt", ("acc_bias", "bias_x_ug", 2000)),
    "thermal_six_faces": ("thermal", "tilt", ("acc_bias", "bias_y_ug", 2000)),
    "placing_table_both_axes": ("placing_table", "table", ("acc_bias", "bias_y_ug", 3000)),
    "gyro_rates_three": ("gyro_rates", "rate", ("gyr_scale", "scale_z_ppm", 3000)),
    "two_position_level": ("two_position", "base", ("acc_bias", "bias_x_ug", 2000)),
    "fog_scale_by_hand": ("fog_scale", "parameters", ("gyr_scale", "scale_x_ppm", 20000)),
}


def changed(table, effect, key, by):
    """The table of a scenario with one size of an effect larger by so much."""
    effects = [dict(e) for e in table.get("effect", [])]
    sensor = "gyro" if effect.startswith("gyr") else None
    for e in effects:
        if e["id"] == effect and e.get("sensor", sensor) == sensor:
            e[key] = e.get(key, 0.0) + by
            return table | {"effect": effects}
    added = {"id": effect, key: by} | ({"sensor": sensor} if sensor else {})
    return table | {"effect": [*effects, added]}


@pytest.mark.parametrize("name", CASES)
def test_the_same_instrument_is_accepted_and_a_changed_one_is_refused(name):
    method, judged_by, change = CASES[name]
    table = tomllib.loads((SCENARIOS / f"{name}.toml").read_text())
    scenario = tc.parse_scenario(table)
    options = next(m.options for m in scenario.method if m.name == method)
    own = scenario.simulate(seed=21)
    found = scenario.calibrate(own, method, **options)
    for recording in (own, scenario.simulate(seed=22)):
        result = scenario.check(found, recording)
        assert result.accepted, result.statement
        assert result.judged_by == judged_by
    aged = tc.parse_scenario(changed(table, *change)).simulate(seed=23)
    result = scenario.check(found, aged)
    assert not result.accepted
    assert result.quantities


def test_a_scale_factor_that_moved_is_named_with_its_size():
    table = tomllib.loads((SCENARIOS / "six_faces_dual.toml").read_text())
    scenario = tc.parse_scenario(table)
    found = scenario.calibrate(scenario.simulate(seed=1), "six_position")
    aged = tc.parse_scenario(changed(table, "acc_scale", "scale_x_ppm", 10000)).simulate(seed=2)
    statement = scenario.check(found, aged).statement
    assert "most likely accel.scale_x has changed, by" in statement
    size = float(statement.split("changed, by ")[1].split(" +-")[0])
    assert size == pytest.approx(10000, rel=0.02)


def test_slow_noise_is_expected_and_a_change_beyond_it_is_not():
    table = tomllib.loads((SCENARIOS / "norm_by_hand.toml").read_text())
    for effect in table["effect"]:
        if effect["id"] == "acc_noise":
            effect["flicker_ug"] = 15
    scenario = tc.parse_scenario(table)
    accepted = []
    for seed in range(8):
        own = scenario.simulate(seed=40 + seed)
        found = scenario.calibrate(own, "norm")
        accepted.append(scenario.check(found, own).accepted)
    assert all(accepted)
    aged = tc.parse_scenario(changed(table, "acc_scale", "scale_x_ppm", 5000)).simulate(seed=60)
    assert not scenario.check(found, aged).accepted


def test_every_limit_is_judged_in_its_unit(tmp_path, capsys):
    table = tomllib.loads((SCENARIOS / "six_faces_dual.toml").read_text())
    scenario = tc.parse_scenario(table)
    found = scenario.calibrate(scenario.simulate(seed=1), "six_position")
    other = scenario.simulate(seed=2)
    sizes = {q.quantity: q.rms for q in scenario.check(found, other).quantities}
    channels = max(sizes[a] for a in "xyz")
    for option, size in (
        ("limit_arcsec", sizes["tilt"]),
        ("limit_ug", channels),
        ("limit_ppm", sizes["norm"]),
    ):
        assert scenario.check(found, other, **{option: 1.01 * size}).accepted
        refused = scenario.check(found, other, **{option: 0.99 * size})
        assert not refused.accepted
        assert "beyond the limit" in refused.statement
    found.save(tmp_path / "CAL.json")
    other.save(tmp_path / "other.csv")
    words = ["check", str(tmp_path / "CAL.json"), str(tmp_path / "other.csv")]
    words += ["--scenario", str(SCENARIOS / "six_faces_dual.toml"), "--limit-ppm", "0.001"]
    assert main(words) == 1
    assert "limit 0.001" in capsys.readouterr().out


def test_parameters_that_a_recording_does_not_show_are_named():
    scenario = tc.load_scenario(SCENARIOS / "six_faces_dual.toml")
    found = scenario.calibrate(scenario.simulate(seed=1), "six_position")
    log = scenario.simulate(seed=2)
    level = np.flatnonzero(log.column("accel_z_m_s2") > 9.0)[:200]
    columns = {name: log.column(name)[level] for name in log.column_names}
    part = tc.Recording.from_columns(log.time[level], columns)
    result = scenario.check(found, part)
    # level: nothing along x and y
    hidden = {f"accel.{t}" for t in ("scale_x", "scale_y", "cross_xy", "cross_yx", "cross_zx")}
    assert set(result.not_shown) == hidden | {"accel.cross_zy"}
    assert "not shown by this recording: accel.scale_x" in result.statement


def test_the_axis_that_two_axes_lack_is_said_where_it_points_down():
    table = tomllib.loads((SCENARIOS / "six_faces_dual.toml").read_text())
    accel = table["sensor"][0] | {"axes": ["x", "y"]}
    effects = [
        {k: v for k, v in e.items() if "_z" not in k and "_zx" not in k and "_zy" not in k}
        for e in table["effect"]
    ]
    scenario = tc.parse_scenario(table | {"sensor": [accel], "effect": effects})
    found = scenario.calibrate(scenario.simulate(seed=1), "six_position")
    result = scenario.check(found, scenario.simulate(seed=2))
    assert result.accepted
    assert "in 1 of 6 dwells z points down, which two axes do not show" in result.statement


def test_a_gyro_at_standstill_is_refused_beyond_the_earths_rate():
    table = tomllib.loads((SCENARIOS / "gyro_turns_by_hand.toml").read_text())
    scenario = tc.parse_scenario(table)
    estimates = {
        f"gyro.bias_{a}": tc.Estimate(np.radians(v), 1e-6, "rad_s")
        for a, v in zip("xyz", (0.3, -0.2, 0.1), strict=True)
    }
    found = tc.Calibration("stated", "good", estimates, 1e-12 * np.eye(3))
    recording = scenario.simulate(seed=5)
    assert scenario.check(found, recording).accepted
    aged = tc.parse_scenario(changed(table, "gyr_bias", "bias_x_deg_s", 0.05)).simulate(seed=6)
    result = scenario.check(found, aged)
    assert not result.accepted
    assert "most likely gyro.bias_x has changed" in result.statement


def test_a_limit_of_another_quantity_replaces_no_test():
    table = tomllib.loads((SCENARIOS / "six_faces_dual.toml").read_text())
    scenario = tc.parse_scenario(table)
    found = scenario.calibrate(scenario.simulate(seed=1), "six_position")
    aged = tc.parse_scenario(changed(table, "acc_scale", "scale_x_ppm", 10000)).simulate(seed=2)
    assert not scenario.check(found, aged, limit_deg_h=1.0).accepted


def test_a_function_that_a_file_names_is_not_run(tmp_path, monkeypatch):
    (tmp_path / "trap.py").write_text("raise SystemExit('run')\n")
    monkeypatch.chdir(tmp_path)
    scenario = tc.load_scenario(SCENARIOS / "gyro_turns_by_hand.toml")
    estimates = {"gyro.scale_x": tc.Estimate(0.0, 1e-3, "1")}
    found = tc.Calibration("trap:method", "good", estimates, 1e-6 * np.eye(1))
    with pytest.raises(tc.TiltcalError, match="need steady turns of a table with a readout"):
        scenario.check(found, scenario.simulate(seed=1))
