"""``simulate --motion``: what a recording of this set-up should have read."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tiltcal.cli import main
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.recording_files import read_recording
from tiltcal.recordings.saving import write_recording
from tiltcal.statistics.splines import DEGREE


def predicted(toml, motion):
    assert (
        main(
            [
                "simulate",
                str(toml),
                "--motion",
                str(motion),
                "--noise",
                "off",
                "-o",
                "predicted.csv",
            ]
        )
        == 0
    )
    return read_recording("predicted.csv")


@pytest.mark.usefixtures("here")
def test_a_noiseless_recording_is_predicted_at_rest_in_its_own_columns_and_units(good):
    assert main(["simulate", str(good / "bench.toml"), "--noise", "off", "-o", "clean.csv"]) == 0
    clean = read_recording("clean.csv")
    columns = {name: clean.column(name) for name in clean.column_names}
    columns["accel_y_ug"] = columns.pop("accel_y_m_s2") / 9.80665e-6
    columns["table_outer_arcsec"] = columns.pop("table_outer_deg") * 3600
    write_recording(
        Recording.from_columns(clean.time + 1e4, columns, labels=clean.labels), "other.npz"
    )
    told = read_recording("other.npz")
    model = predicted(good / "bench.toml", "other.npz")
    assert set(model.column_names) == set(columns)
    np.testing.assert_array_equal(model.time, told.time)
    np.testing.assert_array_equal(
        model.column("table_outer_arcsec"), told.column("table_outer_arcsec")
    )
    rest = at_rest(good)
    assert rest.sum() == pytest.approx(6 * 2 * 50, abs=12)
    for name, unit in (("accel_x_m_s2", 1.0), ("accel_y_ug", 9.80665e-6), ("accel_z_m_s2", 1.0)):
        assert np.abs(model.column(name) - told.column(name))[rest].max() * unit < 1e-9


@pytest.mark.usefixtures("here")
def test_what_follows_a_temperature_that_was_not_recorded_is_told(good, capsys):
    bench = (good / "bench.toml").read_text()
    heated = '[[effect]]\nid = "acc_temp_bias"\nsensor = "accel"\ntemp_bias_x_ug_degC = 20.0\n'
    Path("heated.toml").write_text(bench + heated)
    told = read_recording(good / "run.csv")
    kept = {n: told.column(n) for n in told.column_names if not n.startswith("temperature")}
    write_recording(Recording.from_columns(told.time, kept), "cold.csv")
    predicted("heated.toml", "cold.csv")
    assert "cold.csv: no column temperature_degC, so nothing" in capsys.readouterr().err
    predicted(good / "bench.toml", "cold.csv")
    assert "temperature" not in capsys.readouterr().err


def at_rest(good):
    """Rows well inside the dwells of run.csv."""
    time = read_recording(good / "run.csv").time
    poses = json.loads((good / "truth.json").read_text())["poses"]
    return np.any([(time > p["start_s"] + 0.5) & (time < p["end_s"] - 0.5) for p in poses], axis=0)


@pytest.mark.usefixtures("here")
def test_the_mounting_of_the_recording_overrides_the_scenario_s(good):
    told = read_recording(good / "run.csv")
    write_recording(replace(told, metadata={"mount": "Rz(180)"}), "turned.csv")
    plain, turned = (
        predicted(good / "bench.toml", good / "run.csv"),
        predicted(good / "bench.toml", "turned.csv"),
    )
    rest = at_rest(good)
    # what is sensed turns over, the bias stays
    for name, bias_ug in (
        ("accel_x_m_s2", 3000),
        ("accel_y_m_s2", -1500),
    ):
        bias = bias_ug * 9.80665e-6
        expected = bias - (plain.column(name) - bias)
        np.testing.assert_allclose(turned.column(name)[rest], expected[rest], atol=1e-9)
    np.testing.assert_allclose(
        turned.column("accel_z_m_s2")[rest], plain.column("accel_z_m_s2")[rest], atol=1e-9
    )
    assert np.ptp(plain.column("accel_y_m_s2")[rest]) > 19
    assert turned.metadata["mount"] == "Rz(180)"


@pytest.mark.usefixtures("here")
def test_where_the_table_was_not_read_nothing_is_predicted(good):
    told = read_recording(good / "run.csv")
    columns = {name: told.column(name).copy() for name in told.column_names}
    columns["table_inner_deg"][200:300] = np.nan
    write_recording(Recording.from_columns(told.time, columns, labels=told.labels), "gap.csv")
    model = predicted(good / "bench.toml", "gap.csv")
    empty = np.isnan(model.column("accel_z_m_s2"))
    assert empty[200:300].all()
    assert empty.sum() == 100


HANDHELD = """\
schema = 1
[site]
gravity_m_s2 = 9.80123
[rig]
table = "handheld"
[[sensor]]
name = "gyro"
kind = "gyro"
rate_hz = 50
[[sensor]]
name = "fog"
kind = "fog"
axes = ["a"]
input_axis = [1, 2, 2]
rate_hz = 50
[[effect]]
id = "fog_scale"
scale_a_ppm = 1000
"""


def test_a_fog_turned_by_hand_is_predicted_from_the_gyro(here):
    (here / "hand.toml").write_text(HANDHELD)
    time = np.arange(500) / 50
    rate = np.column_stack([np.sin(time), np.cos(2 * time), 0.3 * time])
    columns = {f"gyro_{a}_deg_s": rate[:, i] for i, a in enumerate("xyz")} | {
        "fog_a_deg_h": np.zeros(500)
    }
    write_recording(Recording.from_columns(time, columns), here / "hand.csv")
    model = predicted("hand.toml", "hand.csv")
    expected = 1.001 * rate @ [1 / 3, 2 / 3, 2 / 3] * 3600
    found = model.column("fog_a_deg_h")  # from a spline through the rates, a knot a sample
    inside = slice((DEGREE + 1) // 2, -(DEGREE + 1) // 2)
    np.testing.assert_allclose(
        found[inside], expected[inside], rtol=0, atol=1e-6 * np.abs(expected).max()
    )
    # within half a spline's support of the ends there is one side only
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-4 * np.abs(expected).max())
    np.testing.assert_allclose(model.column("gyro_x_deg_s"), rate[:, 0], rtol=0, atol=1e-6)


@pytest.mark.usefixtures("here")
def test_no_file_is_written_over_another_of_the_same_command(good, capsys):
    bench = str(good / "bench.toml")
    assert main(["simulate", bench, "-o", "run.csv"]) == 0
    before = Path("run.csv").read_bytes()
    for option in ("--motion", "--truth"):
        assert main(["simulate", bench, option, "run.csv", "-o", "./run.csv"]) == 2
        assert f"the file of {option} as well" in capsys.readouterr().err
    assert Path("run.csv").read_bytes() == before


@pytest.mark.usefixtures("here")
def test_a_mounting_that_is_none_is_refused_by_the_name_of_its_recording(good, capsys):
    bench = str(good / "bench.toml")
    assert main(["simulate", bench, "-o", "run.csv"]) == 0
    text = Path("run.csv").read_text(encoding="utf-8")
    Path("bad.csv").write_text(f"# mount: upside down\n{text}", encoding="utf-8")
    assert main(["simulate", bench, "--motion", "bad.csv", "-o", "predicted.csv"]) == 2
    assert "bad.csv, mount 'upside down'" in capsys.readouterr().err
