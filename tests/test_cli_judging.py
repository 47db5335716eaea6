"""Commands that judge, predict or explain: check, run, verify, demo, simulate --motion, methods, effects, help."""

import json
import subprocess
import sys
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from bench import BENCH, EFFECTS, HEAD, SEQUENCE, make_bench

from tiltcal.cli import main
from tiltcal.effects import CATALOGUE
from tiltcal.methods.registry import METHODS
from tiltcal.recording import Recording
from tiltcal.recording_files import read_recording, write_recording

COMMANDS = (
    "simulate", "init", "import", "calibrate", "correct", "check", "segments", "run", "verify", "demo", "methods", "effects",
)  # fmt: skip


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    return make_bench(tmp_path_factory.mktemp("good"))


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def answer(capsys, *words, status=0):
    """What a command says with --json."""
    capsys.readouterr()
    assert main([str(w) for w in (*words, "--json")]) == status
    return json.loads(capsys.readouterr().out)


# ---------------------------------------------------------------------------------------------------------------- check


def test_check_accepts_a_good_calibration_on_another_recording_and_rejects_it_under_a_tight_limit(good, here, capsys):
    main(["simulate", str(good / "bench.toml"), "--seed", "77", "-o", "other.csv"])
    words = ("check", good / "CAL.json", "other.csv", "--scenario", good / "bench.toml")
    found = answer(capsys, *words)
    assert found["judged_by"] == "tilt"
    assert len(found["poses"]) == 6
    rms = np.sqrt(np.mean([p["error_arcsec"] ** 2 for p in found["poses"]]))
    assert found["rms_arcsec"] == pytest.approx(rms)
    assert found["accepted"]
    assert not answer(capsys, *words, "--limit-arcsec", rms * 0.99, status=1)["accepted"]
    assert answer(capsys, *words, "--limit-arcsec", rms * 1.01)["accepted"]
    assert main([str(w) for w in (*words, "--limit-arcsec", rms * 0.99)]) == 1
    assert "not accepted" in capsys.readouterr().out


def test_check_rejects_a_sensor_that_has_changed(good, here, capsys):
    (here / "aged.toml").write_text(BENCH.replace("bias_x_ug = 3000", "bias_x_ug = 4000"))
    main(["simulate", "aged.toml", "-o", "aged.csv"])
    found = answer(capsys, "check", good / "CAL.json", "aged.csv", "--scenario", good / "bench.toml", status=1)
    faces = [p["error_arcsec"] for p in found["poses"]]
    assert max(faces) == pytest.approx(206.2648, rel=0.05)  # a milli-g of bias across up is a milliradian of tilt


def test_without_attitudes_check_judges_the_norm(good, here, capsys):
    told = read_recording(good / "run.csv")
    mute = {name: told.column(name) for name in told.column_names if not name.startswith("table_")}
    write_recording(Recording.from_columns(told.time, mute), here / "mute.csv")
    assert answer(capsys, "check", good / "CAL.json", "mute.csv", "--scenario", good / "bench.toml")["judged_by"] == "norm"


# ---------------------------------------------------------------------------------------------------------- run, verify


def test_run_judges_and_writes_a_report_and_junit(good, here, capsys):
    found = answer(capsys, "run", good / "bench.toml", "-o", "out")
    assert (found["schema"], found["accepted"]) == (1, True)
    (scenario,) = found["scenarios"]
    (method,) = scenario["methods"]
    assert (scenario["source"], method["method"], method["verdict"], method["runs"]) == ("bench.toml", "six_position", "good", 1)
    assert set(method["tilt_arcsec"]) == {"before", "after", "bound"}
    assert method["tilt_arcsec"]["before"] > 5 * method["tilt_arcsec"]["after"]
    assert method["truth"]["accel.bias_x"] == pytest.approx(3000e-6 * 9.80665)
    assert all(limit["passed"] for limit in method["limits"])
    suites = ElementTree.parse(here / "out" / "junit.xml").getroot()
    cases = suites.findall("testsuite/testcase")
    assert len(cases) == len(method["limits"]) == 3
    assert suites.findall(".//failure") == []
    page = (here / "out" / "report.html").read_text()
    assert "accel.bias_x" in page
    assert "<script src=" not in page  # offline


def test_a_broken_limit_ends_with_one_and_is_named_everywhere(here, capsys):
    (here / "strict.toml").write_text(BENCH.replace("better_by = 5", "better_by = 1e6"))
    assert main(["run", "strict.toml", "-o", "out"]) == 1
    said = capsys.readouterr().out
    assert "tilt error before over after: reached" in said
    assert "0 of 1 scenarios accepted" in said
    root = ElementTree.parse(here / "out" / "junit.xml").getroot()
    assert [f.text for f in root.iter("failure")][0].endswith("allowed >= 1e+06")
    assert root.find("testsuite").get("failures") == "1"


def test_verify_runs_a_folder_and_one_bad_scenario_rejects_it(good, here, capsys):
    (here / "claims").mkdir()
    for name, text in (("a", BENCH), ("b", BENCH.replace("six_position", "norm")), ("model", HEAD + EFFECTS + SEQUENCE)):
        (here / "claims" / f"{name}.toml").write_text(text)
    found = answer(capsys, "verify", "claims", "-o", "out", status=1)
    assert [s["source"] for s in found["scenarios"]] == ["a.toml", "b.toml"]  # the model claims nothing
    assert [s["accepted"] for s in found["scenarios"]] == [True, False]
    assert "6 dwells" in found["scenarios"][1]["methods"][0]["error"]
    assert (here / "out" / "report.html").exists()


def test_the_demo_accepts_its_scenarios_and_ends_with_the_path_of_its_report(here, capsys):
    assert main(["demo"]) == 0
    out, err = capsys.readouterr()
    assert out.splitlines()[-1] == "report: demo-output/report.html"
    assert (here / "demo-output" / "report.html").exists()
    assert "Simulating tables in MuJoCo" in err


# --------------------------------------------------------------------------------------------------- simulate --motion


def predicted(toml, motion):
    assert main(["simulate", str(toml), "--motion", str(motion), "--noise", "off", "-o", "predicted.csv"]) == 0
    return read_recording("predicted.csv")


def test_a_noiseless_recording_is_predicted_at_rest_in_its_own_columns_and_units(good, here):
    assert main(["simulate", str(good / "bench.toml"), "--noise", "off", "-o", "clean.csv"]) == 0
    clean = read_recording("clean.csv")
    columns = {name: clean.column(name) for name in clean.column_names}
    columns["accel_y_ug"] = columns.pop("accel_y_m_s2") / 9.80665e-6
    columns["table_outer_arcsec"] = columns.pop("table_outer_deg") * 3600
    write_recording(Recording.from_columns(clean.time + 1e4, columns, labels=clean.labels), here / "other.npz")
    told = read_recording("other.npz")
    model = predicted(good / "bench.toml", "other.npz")
    assert set(model.column_names) == set(columns)
    np.testing.assert_array_equal(model.time, told.time)
    np.testing.assert_array_equal(model.column("table_outer_arcsec"), told.column("table_outer_arcsec"))
    still = np.abs(np.gradient(columns["table_outer_arcsec"])) + np.abs(np.gradient(columns["table_inner_deg"])) == 0
    edge = np.convolve(~still, np.ones(51), mode="same") == 0  # half a second from every move
    assert edge.sum() > 300
    for name, unit in (("accel_x_m_s2", 1.0), ("accel_y_ug", 9.80665e-6), ("accel_z_m_s2", 1.0)):
        assert np.abs(model.column(name) - told.column(name))[edge].max() * unit < 1e-9


def test_the_mounting_of_the_recording_overrides_the_scenario_s(good, here):
    told = read_recording(good / "run.csv")
    write_recording(replace(told, metadata={"mount": "Rz(180)"}), here / "turned.csv")
    plain, turned = predicted(good / "bench.toml", good / "run.csv"), predicted(good / "bench.toml", "turned.csv")
    true = {axis: (plain.column(f"accel_{axis}_m_s2") - b) for axis, b in (("x", 3e-3 * 9.80665), ("y", -1.5e-3 * 9.80665))}
    for axis, value in true.items():
        b = plain.column(f"accel_{axis}_m_s2") - value
        rest = slice(10, 140)
        np.testing.assert_allclose(turned.column(f"accel_{axis}_m_s2")[rest], (b - value)[rest], atol=1e-9)
    faces = slice(300, 420)  # +y up: turned by half a turn about z it reads -g
    assert turned.column("accel_y_m_s2")[faces].mean() == pytest.approx(-9.80123 - 1.5e-3 * 9.80665, abs=1e-6)
    assert turned.metadata["mount"] == "Rz(180)"


def test_where_the_table_was_not_read_nothing_is_predicted(good, here):
    told = read_recording(good / "run.csv")
    columns = {name: told.column(name).copy() for name in told.column_names}
    columns["table_inner_deg"][200:300] = np.nan
    write_recording(Recording.from_columns(told.time, columns, labels=told.labels), here / "gap.csv")
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
    columns = {f"gyro_{a}_deg_s": rate[:, i] for i, a in enumerate("xyz")} | {"fog_a_deg_h": np.zeros(500)}
    write_recording(Recording.from_columns(time, columns), here / "hand.csv")
    model = predicted("hand.toml", "hand.csv")
    expected = 1.001 * rate @ [1 / 3, 2 / 3, 2 / 3] * 3600
    np.testing.assert_allclose(model.column("fog_a_deg_h"), expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(model.column("gyro_x_deg_s"), rate[:, 0])


# ------------------------------------------------------------------------------------------------------ words and JSON


def test_methods_and_effects_are_listed_and_explained(capsys):
    assert {m["method"] for m in answer(capsys, "methods")} >= set(METHODS)
    assert [e["id"] for e in answer(capsys, "effects")] == list(CATALOGUE)
    one = answer(capsys, "effects", "acc_K2")
    assert (one["id"], one["stage"]) == ("acc_K2", "sensor")
    assert {e["id"] for e in answer(capsys, "effects", "backlash")} >= {"table_backlash"}
    for words in (["methods"], ["effects"], ["effects", "acc_K2"]):
        assert main(words) == 0
        assert ("six_position" if words == ["methods"] else "acc_K2") in capsys.readouterr().out


def test_every_command_speaks_json(good, here, capsys):
    (here / "log.txt").write_text("1\n2\n")
    (here / "map.toml").write_text('[file]\nheader = false\n[time]\nrate_hz = 10\n[[column]]\nfrom = 1\nto = "accel_x_g"\n')
    assert answer(capsys, "import", "log.txt", "--map", "map.toml", "-o", "log.csv")["rows"] == 2
    assert answer(capsys, "simulate", good / "bench.toml", "-o", "run.csv")["rows"] == len(read_recording(good / "run.csv"))
    assert answer(capsys, "correct", good / "CAL.json", "run.csv", "-o", "out.csv")["output"] == "out.csv"
    assert "[site]" in answer(capsys, "init")["scenario"]
    assert "properties" in answer(capsys, "init", "--json-schema")
    kinds = [s["kind"] for s in answer(capsys, "segments", "run.csv", "-o", "SEG.csv")]
    assert kinds.count("dwell") == 6
    assert (here / "SEG.csv").exists()


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command, capsys):
    with pytest.raises(SystemExit) as stop:
        main([command, "--help"])
    out = capsys.readouterr().out
    assert stop.value.code == 0
    assert f"usage: tiltcal {command}" in out
    assert "--json" in out


def test_the_help_lists_every_command_and_imports_nothing_heavy():
    code = "import sys; from tiltcal.cli import main\ntry: main(['--help'])\nexcept SystemExit: pass\nprint(sorted(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    text, _, modules = done.stdout.rpartition("[")
    assert all(f"    {command}" in text for command in COMMANDS)
    loaded = {m.strip(" '\n]").split(".")[0] for m in modules.split(",")}
    assert "tiltcal" in loaded
    assert not loaded & {"numpy", "mujoco", "scipy", "pydantic", "pyarrow", "rich", "plotly"}
