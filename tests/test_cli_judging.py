"""Commands that judge, predict or explain: check, run, verify, demo, methods, effects, help."""

import json
from xml.etree import ElementTree

import numpy as np
import pytest
from scenario_files import BENCH_SCENARIO, EFFECTS, HEAD, SEQUENCE

from tiltcal.calibration.methods.registry import METHODS
from tiltcal.cli import main
from tiltcal.cli.commands import COMMANDS
from tiltcal.cli.demo import CONCEALABLE, bench, concealed
from tiltcal.effects import CATALOGUE
from tiltcal.laboratory.scenario import load_scenario, parse_scenario
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.recording_files import read_recording
from tiltcal.recordings.saving import write_recording


def answer(capsys, *words, status=0):
    """What a command says with --json."""
    capsys.readouterr()
    assert main([str(w) for w in (*words, "--json")]) == status
    return json.loads(capsys.readouterr().out)


# --------------------------------------------------------------------------------------------------
# -------------- check


@pytest.mark.usefixtures("here")
def test_check_accepts_a_good_calibration_on_another_recording_and_rejects_it_under_a_tight_limit(
    good, capsys
):
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
    (here / "aged.toml").write_text(BENCH_SCENARIO.replace("bias_x_ug = 3000", "bias_x_ug = 4000"))
    main(["simulate", "aged.toml", "-o", "aged.csv"])
    found = answer(
        capsys, "check", good / "CAL.json", "aged.csv", "--scenario", good / "bench.toml", status=1
    )
    faces = [p["error_arcsec"] for p in found["poses"]]
    # a milli-g of bias across up is a milliradian of tilt
    assert max(faces) == pytest.approx(206.2648, rel=0.05)


def test_without_attitudes_check_judges_the_norm(good, here, capsys):
    told = read_recording(good / "run.csv")
    mute = {name: told.column(name) for name in told.column_names if not name.startswith("table_")}
    write_recording(Recording.from_columns(told.time, mute), here / "mute.csv")
    assert (
        answer(capsys, "check", good / "CAL.json", "mute.csv", "--scenario", good / "bench.toml")[
            "judged_by"
        ]
        == "norm"
    )


# --------------------------------------------------------------------------------------------------
# -------- run, verify


def test_run_judges_and_writes_a_report_and_junit(good, here, capsys):
    found = answer(capsys, "run", good / "bench.toml", "-o", "out")
    assert (found["schema"], found["accepted"]) == (1, True)
    (scenario,) = found["scenarios"]
    (method,) = scenario["methods"]
    assert (scenario["source"], method["method"], method["verdict"], method["runs"]) == (
        "bench.toml",
        "six_position",
        "good",
        1,
    )
    assert set(method["tilt_arcsec"]) == {"before", "after", "bound"}
    assert method["tilt_arcsec"]["before"] > 5 * method["tilt_arcsec"]["after"]
    assert method["truth"]["accel.bias_x"] == pytest.approx(3000e-6 * 9.80665)
    assert all(limit["passed"] for limit in method["limits"])
    suites = ElementTree.parse(here / "out" / "junit.xml").getroot()
    cases = suites.findall("testsuite/testcase")
    assert len(cases) == len(method["limits"]) == 5
    assert suites.findall(".//failure") == []
    page = (here / "out" / "report.html").read_text()
    assert "accel.bias_x" in page
    assert "<script src=" not in page  # offline


def test_a_broken_limit_ends_with_one_and_is_named_everywhere(here, capsys):
    (here / "strict.toml").write_text(BENCH_SCENARIO.replace("better_by = 5", "better_by = 1e6"))
    assert main(["run", "strict.toml", "-o", "out"]) == 1
    said = capsys.readouterr().out
    assert "tilt error before over after: reached" in said
    assert "0 of 1 scenarios accepted" in said
    root = ElementTree.parse(here / "out" / "junit.xml").getroot()
    texts = [f.text for f in root.iter("failure")]
    assert all("allowed >= 1e+06" in text for text in texts)
    # reached, and expected by the covariance
    assert root.find("testsuite").get("failures") == str(len(texts)) == "2"


def test_verify_runs_a_folder_and_one_bad_scenario_rejects_it(here, capsys):
    (here / "claims").mkdir()
    for name, text in (
        ("a", BENCH_SCENARIO),
        ("b", BENCH_SCENARIO.replace("six_position", "norm")),
        ("model", HEAD + EFFECTS + SEQUENCE),
    ):
        (here / "claims" / f"{name}.toml").write_text(text)
    found = answer(capsys, "verify", "claims", "-o", "out", status=1)
    # the model claims nothing
    assert [s["source"] for s in found["scenarios"]] == [
        "a.toml",
        "b.toml",
    ]
    assert [s["accepted"] for s in found["scenarios"]] == [True, False]
    assert "6 dwells" in found["scenarios"][1]["methods"][0]["error"]
    assert (here / "out" / "report.html").exists()


def test_the_demo_accepts_its_scenarios_and_finds_what_it_has_concealed(here, capsys):
    assert main(["demo", "--seed", "5"]) == 0
    out, err = capsys.readouterr()
    assert out.splitlines()[-1] == "report of the diagnosis: demo-output/diagnosis/report.html"
    assert "report: demo-output/report.html" in out
    assert {p.name for p in (here / "demo-output" / "diagnosis").iterdir()} >= {
        "report.html",
        "diagnosis.json",
        "amended.toml",
    }
    assert "Simulating tables in MuJoCo" in err
    assert "seed 5" in err
    hidden = load_scenario("demo-output/concealed.toml").effects[-1].id
    shown = [
        line.split() for line in out.splitlines() if line.split()[:1] in (["concealed"], ["found"])
    ]
    assert shown[0][:2] == ["concealed", hidden]
    assert hidden in shown[1]
    assert load_scenario("demo-output/diagnosis/scenario.toml").effects == ()


def test_a_scenario_that_holds_the_truth_is_refused_by_the_diagnosis(good, here, capsys):
    (here / "concealed.toml").write_text('role = "concealed"\n' + (good / "bench.toml").read_text())
    assert (
        main(["diagnose", str(good / "run.csv"), "--scenario", "concealed.toml", "-o", "out"]) == 2
    )
    assert "it contains the truth" in capsys.readouterr().err
    assert not (here / "out").exists()


def test_every_effect_the_demo_can_conceal_makes_a_scenario():
    seen = set()
    for seed in range(300):
        table = concealed(np.random.default_rng(seed))
        parse_scenario({**bench(), "effect": [table]})
        seen.add(table["id"])
    assert seen == {cls.id for cls in CONCEALABLE}


# --------------------------------------------------------------------------------------------------
# ---- words and JSON


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
    (here / "map.toml").write_text(
        '[file]\nheader = false\n[time]\nrate_hz = 10\n[[column]]\nfrom = 1\nto = "accel_x_g"\n'
    )
    assert answer(capsys, "import", "log.txt", "--map", "map.toml", "-o", "log.csv")["rows"] == 2
    assert answer(capsys, "simulate", good / "bench.toml", "-o", "run.csv")["rows"] == len(
        read_recording(good / "run.csv")
    )
    assert (
        answer(capsys, "correct", good / "CAL.json", "run.csv", "-o", "out.csv")["output"]
        == "out.csv"
    )
    assert "[site]" in answer(capsys, "init")["scenario"]
    assert "properties" in answer(capsys, "init", "--json-schema")
    kinds = [s["kind"] for s in answer(capsys, "segments", "run.csv", "-o", "SEG.csv")]
    assert kinds.count("dwell") == 6
    assert (here / "SEG.csv").exists()


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command, capsys):
    assert main([command, "--help"]) == 0
    out = capsys.readouterr().out
    assert f"Usage: tiltcal {command}" in out
    assert "--json" in out
