"""Placing tables from the command line: simulate, calibrate, correct, check, run with a report."""

import csv
import json

import numpy as np
import pytest
import tomli_w
from test_online import PLACING

from tiltcal.cli import main

METHOD = {"name": "placing_table", "options": {"harmonics": 2}, "accept": {"better_by": 20.0}}


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A scenario of both axes every 10 deg, its recording, and its calibration."""
    folder = tmp_path_factory.mktemp("placing")
    steps = [s for s in PLACING["sequence"] if s.get("mount") != "Rz(45)" and s["action"] != "move"]
    (folder / "level.toml").write_text(
        tomli_w.dumps(PLACING | {"sequence": steps, "method": [METHOD]})
    )
    at = {name: str(folder / name) for name in ("level.toml", "run.csv", "CAL.json")}
    assert main(["simulate", at["level.toml"], "--seed", "3", "-o", at["run.csv"]]) == 0
    words = [
        "calibrate",
        at["run.csv"],
        "--scenario",
        at["level.toml"],
        "--method",
        "placing_table",
        "-o",
        at["CAL.json"],
    ]
    assert main(words) == 0
    return folder


def test_cal_json_holds_an_entry_an_angle_with_its_uncertainty(bench):
    stated = json.loads((bench / "CAL.json").read_text())
    assert set(stated["bias_tables"]) == {"accel.x", "accel.y"}
    for entries in stated["bias_tables"].values():
        assert [e["angle_deg"] for e in entries] == list(range(0, 100, 10))
        assert all(e["unit"] == "m_s2" and 0 < e["sigma"] < 1e-4 for e in entries)
    assert stated["lookup"] == "interpolated"


def test_correct_streams_the_table_off_and_says_what_it_left_empty(bench, capsys):
    out = bench / "out.csv"
    assert (
        main(["correct", str(bench / "CAL.json"), str(bench / "run.csv"), "-o", str(out), "--json"])
        == 0
    )
    said, err = capsys.readouterr()
    assert (
        "readings of accel.x at placing angles that its table does not hold are left empty" in err
    )
    assert any("accel.x" in note for note in json.loads(said)["notes"])
    with out.open() as lines:
        rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    first = [r for r in rows[: len(rows) // 2] if abs(float(r["table_outer_deg"]) - 30) < 1e-6]
    y = np.array([float(r["accel_y_corrected_m_s2"]) for r in first])
    assert abs(y.mean()) < 1e-4
    assert abs(np.mean([float(r["accel_y_m_s2"]) for r in first])) > 5e-3
    assert abs(np.mean([float(r["tilt_y_deg"]) for r in first])) < 1e-3


def test_check_judges_a_table_where_its_axis_is_horizontal(bench, capsys):
    other = bench / "other.csv"
    assert main(["simulate", str(bench / "level.toml"), "--seed", "4", "-o", str(other)]) == 0
    words = [str(bench / "CAL.json"), str(other), "--scenario", str(bench / "level.toml"), "--json"]
    assert main(["check", *words]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["judged_by"] == "table"
    assert found["rms_arcsec"] < 3 * found["expected_arcsec"]
    wrong = json.loads((bench / "CAL.json").read_text())
    for entry in wrong["bias_tables"]["accel.y"]:
        entry["value"] += 1e-3
    (bench / "wrong.json").write_text(json.dumps(wrong))
    assert main(["check", str(bench / "wrong.json"), *words[1:]]) == 1


def test_check_without_a_horizontal_axis_is_refused(bench, capsys):
    tilted = PLACING | {
        "rig": {"table": "placing", "mount": "Rz(45)"},
        "sequence": [{"action": "move", "outer_deg": 20, "dwell_s": 3}],
    }
    (bench / "tilted.toml").write_text(tomli_w.dumps(tilted))
    assert main(["simulate", str(bench / "tilted.toml"), "-o", str(bench / "tilted.csv")]) == 0
    words = [
        "check",
        str(bench / "CAL.json"),
        str(bench / "tilted.csv"),
        "--scenario",
        str(bench / "tilted.toml"),
        "--segments",
    ]
    (bench / "SEG.csv").write_text("start_s,end_s,kind,label\n1.9,4,dwell,\n")
    assert main([*words, str(bench / "SEG.csv")]) == 2
    assert "found no dwell with a calibrated axis horizontal" in capsys.readouterr().err


def test_run_judges_the_table_and_writes_the_report(bench, capsys):
    assert main(["run", str(bench / "level.toml"), "-o", str(bench / "out")]) == 0
    assert "accepted" in capsys.readouterr().out
    assert "placing_table" in (bench / "out" / "report.html").read_text()
