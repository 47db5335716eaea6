"""Calibrations compared over the range, and joined: agreement at its stated probability, by hand,
and files that every command takes.
"""

import json

import numpy as np
import pytest
from builders import ACCEL, FOG, GYRO, G, setup_of
from scipy.stats import kstest
from statistics_helpers import rng_of

import tiltcal as tc
from tiltcal.calibration.result import Calibration, Estimate
from tiltcal.cli import main
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import ARCSEC, DEG

SETUP = setup_of("dual", ACCEL, GYRO, FOG)
TERMS = [
    *(f"accel.{t}_{a}" for t in ("bias", "scale") for a in "xyz"),
    *(f"accel.cross_{a}{b}" for a in "xyz" for b in "xyz" if a != b),
]
SIGMA = 2e-5


def calibration(values, covariance, **more) -> Calibration:
    units = {"bias": "m_s2", "roll": "rad", "pitch": "rad"}
    unit = {n: units.get(n.partition(".")[2].partition("_")[0], "1") for n in values}
    sigmas = np.sqrt(np.diag(covariance))
    found = {
        n: Estimate(v, float(s), unit[n]) for (n, v), s in zip(values.items(), sigmas, strict=True)
    }
    provenance = {"setup": json.loads(SETUP.model_dump_json(exclude_none=True))}
    return Calibration("six_position", "good", found, covariance, provenance=provenance, **more)


def drawn(rng, terms=TERMS, sigma=SIGMA) -> Calibration:
    root = np.tril(rng.normal(size=(len(terms),) * 2)) * sigma
    covariance = root @ root.T + 1e-2 * sigma**2 * np.eye(len(terms))
    values = rng.multivariate_normal(np.zeros(len(terms)), covariance)
    return calibration(dict(zip(terms, values.tolist(), strict=True)), covariance)


def test_calibrations_of_one_instrument_agree_at_the_stated_probability():
    rng = rng_of("compare")
    p = [tc.compare(drawn(rng), drawn(rng)).tests[0].p_value for _ in range(100)]
    assert kstest(p, "uniform").pvalue > 1e-3


def test_the_difference_by_hand():
    covariance = np.diag([1e-12, 1e-12])
    one = calibration({"accel.bias_x": 0.0, "accel.scale_z": 0.0}, covariance)
    other = calibration({"accel.bias_x": 1e-3, "accel.scale_z": 0.0}, covariance)
    found = tc.compare(one, other, within=["tilt=1"])
    tilt, norm = found.curves
    # corrected by -1 mm/s2 along x: nearly level, all of it is tilt
    assert tilt.rms[0] == pytest.approx(1e-3 / G / ARCSEC, rel=1e-3)
    assert np.abs(norm.difference).max() < 0.02 * 1e-3 / G * 1e6
    # of both biases along x, and next to nothing of the scale along z
    assert tilt.sigma[0] == pytest.approx(np.sqrt(2) * 1e-6 / G / ARCSEC, rel=1e-2)
    assert norm.sigma[0] == pytest.approx(np.sqrt(2) * 1e-6 * 1e6, rel=1e-2)
    assert not found.agree


def test_rates_are_compared_over_the_rate():
    covariance = np.diag([1e-14])
    one = calibration({"gyro.scale_x": 0.0}, covariance)
    other = calibration({"gyro.scale_x": 1e-4}, covariance)
    found = tc.compare(one, other, within=["rate=10"])
    x = next(c for c in found.curves if c.quantity == "x")
    slope = x.difference[0] / x.at[:, 0]
    assert slope[x.at[:, 0] != 0] == pytest.approx(-1e-4 * DEG / (DEG / 3600), rel=1e-3)


def test_the_joint_estimate_is_that_of_generalised_least_squares():
    rng = rng_of("combine")
    parts = [drawn(rng) for _ in range(3)]
    joint = tc.combine(*parts)
    weights = [np.linalg.inv(p.covariance) for p in parts]
    covariance = np.linalg.inv(sum(weights))
    values = covariance @ sum(
        w @ [e.value for e in p.parameters.values()] for w, p in zip(weights, parts, strict=True)
    )
    assert joint.agrees
    found = joint.calibration
    np.testing.assert_allclose([found.value(n) for n in TERMS], values, atol=1e-6 * SIGMA)
    np.testing.assert_allclose(found.covariance, covariance, atol=1e-6 * SIGMA**2)


def test_parameters_that_one_calibration_has_are_added():
    room = calibration({"accel.bias_x": 1e-3, "accel.scale_x": 2e-4}, np.diag([1e-10, 1e-10]))
    values = {
        "temperature.T0": 33.0,
        "accel.bias_x": 3e-3,
        "accel.temp1_bias_x": 2e-4,
    }
    chamber = calibration(values, np.diag([0.0, 1e-10, 1e-14]))
    joint = tc.combine(room, chamber).calibration
    # the room is at 23 degC: its bias is that of the chamber less 10 degC of the slope
    assert joint.value("accel.bias_x") == pytest.approx(3e-3, abs=2e-5)
    assert joint.value("accel.scale_x") == pytest.approx(2e-4)
    assert joint.value("temperature.T0") == 33.0
    assert "temp" in joint.equation or "T0" in joint.equation


def test_parameters_that_differ_are_named_and_nothing_is_written(tmp_path, capsys):
    covariance = np.diag([1e-12, 1e-12])
    calibration({"accel.bias_x": 0.0, "accel.scale_x": 0.0}, covariance).save(tmp_path / "a.json")
    calibration({"accel.bias_x": 1e-3, "accel.scale_x": 0.0}, covariance).save(tmp_path / "b.json")
    words = ["combine", str(tmp_path / "a.json"), str(tmp_path / "b.json")]
    assert main([*words, "-o", str(tmp_path / "c.json")]) == 1
    assert "accel.bias_x by 707 sigma" in capsys.readouterr().err
    assert not (tmp_path / "c.json").exists()


def test_a_parameter_that_differs_is_named_where_it_is_carried_over_temperature():
    room = calibration({"accel.scale_x": 2e-4}, np.diag([1e-12]))
    values = {"temperature.T0": 33.0, "accel.scale_x": 5e-3, "accel.temp1_scale_x": 1e-4}
    chamber = calibration(values, np.diag([0.0, 1e-12, 1e-20]))
    found = tc.combine(room, chamber)
    assert not found.agrees
    # the room, at 23 degC, carried to 33 degC: 2e-4 + 10 * 1e-4, 3.8e-3 off
    assert found.differing == {"accel.scale_x": pytest.approx(3.8e-3 / 1.414e-6, rel=1e-3)}


def test_calibrations_of_other_instruments_are_not_combined():
    rng = rng_of("others")
    with pytest.raises(TiltcalError, match="found 1 calibration, need two or more"):
        tc.combine(drawn(rng))
    own = calibration({"accel.bias_x": 0.0}, np.eye(1), own_frame=True)
    with pytest.raises(TiltcalError, match="axes in the table's frame and in the sensor's own"):
        tc.combine(drawn(rng), own)


def test_the_report_opens_offline_and_the_exit_status_says_whether_they_agree(tmp_path, capsys):
    rng = rng_of("report")
    one, other = drawn(rng), drawn(rng)
    one.save(tmp_path / "a.json")
    other.save(tmp_path / "b.json")
    words = [str(tmp_path / name) for name in ("a.json", "b.json")]
    agree = tc.compare(one, other).agree
    status = main(["compare", *words, "--range", "tilt=30", "-o", str(tmp_path / "out")])
    assert status == (0 if agree else 1)
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Comparison" in page
    assert 'src="http' not in page
    stored = json.loads((tmp_path / "out" / "comparison.json").read_text())
    assert {c["quantity"] for c in stored["curves"]} == {"tilt", "norm"}
    assert main(["compare", *words, "--range", "tilt=x"]) == 2
    assert "need tilt=DEG" in capsys.readouterr().err


def test_the_effects_of_a_scenario_are_corrected_like_a_calibration(tmp_path):
    path = tmp_path / "amended.toml"
    path.write_text(AMENDED)
    scenario = tc.load_scenario(path)
    recording = scenario.simulate(noise=False)
    fixed = tc.correct(tc.load_instrument(path), recording)
    ideal = tc.parse_scenario({k: v for k, v in tc_table(path).items() if k != "effect"}).simulate(
        noise=False
    )
    for axis in "xyz":
        column = fixed.column(f"accel_{axis}_corrected_m_s2")
        np.testing.assert_allclose(column, ideal.column(f"accel_{axis}_m_s2"), atol=2e-8)


def test_a_calibration_comes_back_from_its_file_with_terms_and_effects(tmp_path):
    path = tmp_path / "amended.toml"
    path.write_text(AMENDED)
    found = tc.load_instrument(path)
    found.save(tmp_path / "CAL.json")
    again = tc.load_calibration(tmp_path / "CAL.json")
    assert again.effects == found.effects
    table = json.loads((tmp_path / "CAL.json").read_text())
    assert table["schema"] == 2
    terms = {t["effect"]: t["parameters"] for t in table["terms"]}
    assert terms["acc_K2"]["k2_z_ug_g2"]["value"] == pytest.approx(300)
    recording = tc.load_scenario(path).simulate(noise=False)
    one, other = (tc.correct(c, recording).column("accel_x_corrected_m_s2") for c in (found, again))
    np.testing.assert_array_equal(one, other)


def test_a_calibration_of_the_first_schema_is_read(tmp_path):
    covariance = np.diag([1e-10])
    calibration({"accel.bias_x": 0.01}, covariance).save(tmp_path / "CAL.json")
    table = json.loads((tmp_path / "CAL.json").read_text()) | {"schema": 1, "method": "norm"}
    del table["terms"]
    (tmp_path / "old.json").write_text(json.dumps(table))
    old = tc.load_calibration(tmp_path / "old.json")
    assert old.value("accel.bias_x") == 0.01
    assert old.own_frame  # as all calibrations by the norm alone


def tc_table(path):
    import tomllib

    return tomllib.loads(path.read_text())


AMENDED = """
schema = 1
name = "amended"
[site]
gravity_m_s2 = 9.81
[rig]
table = "dual"
[[sensor]]
name = "accel"
kind = "accelerometer"
rate_hz = 10
[[sequence]]
action = "scheme"
scheme = "12"
dwell_s = 2
[[effect]]
id = "acc_bias"
bias_x_ug = 3000
[[effect]]
id = "acc_scale"
scale_y_ppm = -900
[[effect]]
id = "acc_K2"
k2_z_ug_g2 = 300
[[effect]]
id = "learned"
on = "reading"
sensor = "accel"
axis = "x"
coordinate = "force_y"
power = 2
coefficients = [1e-5]
"""


SAGGING = (
    AMENDED
    + """
[[effect]]
id = "table_levelling"
tilt_east_arcsec = 300
"""
)


def test_effects_of_the_table_are_in_what_a_check_expects(tmp_path):
    path = tmp_path / "amended.toml"
    path.write_text(SAGGING)
    nominal = {k: v for k, v in tc_table(path).items() if k != "effect"}
    recording = tc.load_scenario(path).simulate(noise=False)
    setup = tc.parse_scenario(nominal)
    found = setup.check(tc.load_instrument(path), recording, limit_arcsec=0.5)
    assert found.accepted, found.statement
    path.write_text(AMENDED)
    other = setup.check(tc.load_instrument(path), recording, limit_arcsec=0.5)
    assert other.rms / ARCSEC == pytest.approx(300, rel=1e-2)


def test_what_follows_a_table_is_not_compared_without_its_angle(tmp_path):
    curve = 'coordinate = "force_y"\npower = 2\n'
    harmonics = 'coordinate = "table_outer"\n'
    path = tmp_path / "amended.toml"
    path.write_text(AMENDED.replace(curve, harmonics))
    one = tc.load_instrument(path)
    with pytest.raises(TiltcalError, match="follows the table's axis 'outer', which is not known"):
        tc.compare(one, one)
    recording = tc.load_scenario(path).simulate(noise=False)
    assert np.isfinite(tc.correct(one, recording).column("accel_x_corrected_m_s2")).all()
