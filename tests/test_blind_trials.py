"""Blind trials: fair, resumable, counted rightly; and the small proof."""

import json
import sys
from pathlib import Path

import pytest
from blind import spread
from blind.cases import make
from blind.judge import judge
from blind.spread import Count
from blind.table import Line, lines, show, wilson
from blind.trial import trial
from scipy.stats import binom
from statistics_helpers import FALSE_ALARM

from tiltcal.cli import main

SPY = """\
import json, pathlib, sys
words = sys.argv[1:]
out = pathlib.Path(words[words.index("-o") + 1])
trace = pathlib.Path({trace!r})
if words[0] == "diagnose":
    desk, folder = pathlib.Path(words[1]).parent, pathlib.Path({folder!r})
    seen = sorted(p.name for p in desk.iterdir())
    trace.write_text(json.dumps([seen, sorted(str(p) for p in folder.rglob("truth.json"))]))
    out.mkdir()
    (out / "diagnosis.json").write_text(json.dumps({{"verdict": "match", "findings": []}}))
else:
    sys.exit(2)
"""


def spied(tmp_path: Path):
    """One trial with a diagnosis that only looks around."""
    (tmp_path / "spy.py").write_text(
        SPY.format(trace=str(tmp_path / "trace.json"), folder=str(tmp_path / "out"))
    )
    result = trial(
        tmp_path / "out",
        "vertical_turn",
        "data",
        0,
        3,
        [sys.executable, str(tmp_path / "spy.py")],
        60.0,
    )
    return result, json.loads((tmp_path / "trace.json").read_text())


# --------------------------------------------------------------------------------------------------
# ------------ fairness


def test_the_diagnosis_gets_two_files_and_the_truth_is_written_when_its_answer_is_in(tmp_path):
    result, (desk, truths) = spied(tmp_path)
    assert desk == ["recording.csv", "scenario.toml"]
    assert truths == []
    assert (tmp_path / "out" / "truth" / result["name"] / "truth.json").exists()
    assert not list((tmp_path / "out" / "cases").rglob("truth*"))


def test_a_finished_trial_is_not_run_again(tmp_path):
    first, _ = spied(tmp_path)
    again = trial(tmp_path / "out", "vertical_turn", "data", 0, 3, ["no-such-command"], 60.0)
    assert again == json.loads(json.dumps(first))


def test_an_answer_that_does_not_come_is_counted_as_none(tmp_path):
    (tmp_path / "slow.py").write_text("import time; time.sleep(60)")
    late = trial(
        tmp_path / "a", "six_faces", "null", 0, 3, [sys.executable, str(tmp_path / "slow.py")], 0.5
    )
    assert (late["crashed"], late["note"]) == (True, "exit -1: took more than 0 s")
    (tmp_path / "bad.py").write_text("import sys; sys.exit('no such thing')")
    bad = trial(
        tmp_path / "b", "six_faces", "null", 0, 3, [sys.executable, str(tmp_path / "bad.py")], 60
    )
    assert (bad["crashed"], bad["note"]) == (True, "exit 1: no such thing")


def test_a_trial_that_somebody_stopped_is_run_again(tmp_path):
    (tmp_path / "stopped.py").write_text("import os, signal; os.kill(os.getpid(), signal.SIGTERM)")
    result = trial(
        tmp_path / "a",
        "six_faces",
        "null",
        0,
        3,
        [sys.executable, str(tmp_path / "stopped.py")],
        60,
    )
    assert (result["crashed"], result["note"]) == (True, "exit -15: ")
    assert not list((tmp_path / "a").rglob("result.json"))


# --------------------------------------------------------------------------------------------------
# ------------- judging


def effect(**more):
    return {
        "id": "acc_K2",
        "listed": True,
        "textbook": True,
        "stage": "sensor",
        "where": ["tilt"],
        "sensors": ["accel"],
        "lambda": 900.0,
        "parameters": {"k2_x_ug_g2": 500.0},
        "inseparable": [],
        "tolerated": [],
        "energy": {"accel.x": 1.0},
        **more,
    }


def truth_of(type_, *effects):
    return {
        "kind": "dual_tumble",
        "type": type_,
        "walk": 1,
        "flicker": False,
        "effects": list(effects),
    }


def finding(name, *others, **more):
    return {
        "effect": name,
        "class": [name, *others] if name else [],
        "stage": "sensor",
        "sensors": ["accel"],
        "axes": ["x"],
        "where": {"coordinate": "tilt"},
        "parameters": {"k2_x_ug_g2": {"value": 510.0, "sigma": 5.0}},
        **more,
    }


def judged(truth, verdict, *findings):
    said = judge(truth, {"verdict": verdict, "findings": list(findings)}, None)
    return said, (said["effects"] or [None])[0]


def test_the_true_name_alone_is_right():
    _, e = judged(truth_of("single", effect()), "explained", finding("acc_K2"))
    assert (e["good"], e["wrong_certain"], e["stage_right"], e["pulls"]) == (
        True,
        False,
        True,
        [2.0],
    )


def test_another_name_alone_is_wrong_and_certain():
    _, e = judged(truth_of("single", effect()), "explained", finding("acc_K3"))
    assert (e["good"], e["wrong_certain"], e["stage_right"]) == (False, True, False)


def test_a_class_is_honest_only_if_every_member_could_be_it():
    twins = effect(inseparable=["adc_inl"], tolerated=["adc_inl"])
    _, honest = judged(truth_of("single", twins), "ambiguous", finding("adc_inl", "acc_K2"))
    _, padded = judged(
        truth_of("single", twins), "ambiguous", finding("adc_inl", "acc_K2", "acc_K3")
    )
    _, certain = judged(truth_of("single", twins), "explained", finding("acc_K2"))
    assert (honest["good"], honest["named"]) == (True, False)
    assert (padded["good"], padded["in_class"], padded["padded"]) == (False, True, ["acc_K3"])
    assert (certain["good"], certain["false_certainty"], certain["wrong_certain"]) == (
        True,
        True,
        False,
    )


def test_a_law_that_contains_the_truth_may_stand_in_its_class_and_not_in_its_place():
    tilt = effect(id="mount_thermal_tilt", stage="mount")
    _, named = judged(
        truth_of("single", tilt), "ambiguous", finding("acc_temp_misalign", "mount_thermal_tilt")
    )
    _, other = judged(truth_of("single", tilt), "explained", finding("acc_temp_misalign"))
    assert (named["good"], named["padded"]) == (True, [])
    assert (other["good"], other["wrong_certain"]) == (False, True)


def test_a_second_wrong_finding_beside_the_true_one_is_a_wrong_name():
    _, e = judged(
        truth_of("single", effect()), "explained", finding("acc_K2"), finding("acc_warmup")
    )
    assert e["good"]
    assert e["wrong_certain"]


def test_an_unlisted_effect_is_judged_by_saying_so_and_by_where():
    new = effect(id="u_bump", listed=False, where=["table_outer", "tilt"])
    _, right = judged(
        truth_of("unlisted", new), "unlisted", finding(None, where={"coordinate": "table_outer"})
    )
    _, elsewhere = judged(
        truth_of("unlisted", new),
        "unlisted",
        finding(None, axes=["y"], where={"coordinate": "time"}),
    )
    _, named = judged(truth_of("unlisted", new), "explained", finding("acc_K2"))
    assert (right["said"], right["channel"], right["coordinate"]) == (True, True, True)
    assert (elsewhere["channel"], elsewhere["coordinate"]) == (False, False)
    assert (named["said"], named["wrong_certain"]) == (False, True)


def test_both_of_a_pair_have_to_be_found():
    both = truth_of("pair", effect(), effect(id="table_levelling", stage="table"))
    said, _ = judged(
        both, "explained", finding("table_levelling", stage="table"), finding("acc_K2")
    )
    assert [e["good"] for e in said["effects"]] == [True, True]
    said, _ = judged(both, "explained", finding("acc_K2"))
    assert [e["good"] for e in said["effects"]] == [True, False]


def test_a_flipped_channel_and_a_reversed_angle_are_one_to_a_single_axis():
    flipped = effect(id="data_sign", stage="data", **{"lambda": None})
    for kind, right in (("placing_sweep", True), ("three_rates", False)):
        said, e = judged(
            {**truth_of("data", flipped), "kind": kind},
            "explained",
            finding("data_rotation_sense", stage="data"),
        )
        assert e["good"] is right, said


def test_expected_verdicts_follow_the_classes():
    for type_, effects, verdict, right in (
        ("null", [], "match", True),
        ("null", [], "ambiguous", False),
        ("single", [effect()], "explained", True),
        ("single", [effect()], "ambiguous", False),
        ("single", [effect(inseparable=["x"], tolerated=["x"])], "ambiguous", True),
        ("single", [effect(tolerated=["x"])], "ambiguous", True),
    ):
        assert judged(truth_of(type_, *effects), verdict)[0]["verdict_right"] is right


# --------------------------------------------------------------------------------------------------
# --------------- table


def test_wilsons_interval_is_the_published_one():
    assert wilson(0, 10) == pytest.approx((0, 0.2775), abs=1e-4)
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=1e-4)  # Newcombe 1998, Table I
    assert wilson(0, 0) == (0, 1)
    assert all(wilson(0, n)[0] == 0 and wilson(n, n)[1] == 1 for n in range(1, 1000))


def test_a_figure_fails_only_when_its_whole_interval_does():
    assert not Line("x", 1, 20, ("<=", 0.02)).failed
    assert Line("x", 5, 20, ("<=", 0.02)).failed
    assert Line("x", 10, 100, (">=", 0.9)).failed
    assert not Line("x", 0, 0, (">=", 0.9)).failed


def test_a_cheat_reaches_every_figure_and_a_fool_misses_them():
    truths = [
        truth_of("null"),
        truth_of("single", effect()),
        truth_of("unlisted", effect(id="u_x", listed=False)),
    ]
    perfect = ("match", []), ("explained", [finding("acc_K2")]), ("unlisted", [finding(None)])
    wrong = (
        ("explained", [finding("acc_K3")]),
        ("explained", [finding("acc_K3")]),
        ("explained", [finding("acc_K3")]),
    )
    silent = [("match", [])] * 3
    missed = []
    for answers in (perfect, wrong, silent):
        results = [
            {**judge(t, {"verdict": v, "findings": f}, None), "seconds": 1.0}
            for t, (v, f) in zip(truths, answers, strict=True)
        ] * 50
        missed.append({line.name for line in lines(results) if line.failed})
    assert not missed[0]
    assert missed[1] >= {
        "false alarms",
        "a wrong name stated with certainty, singles",
        "stage right, singles",
        "unlisted: said so",
        "unlisted: a wrong name stated with certainty",
        "truth named first or in an honest class, textbook",
    }
    assert missed[2] >= {
        "detected, lambda >= 100",
        "unlisted: detected in any form",
        "truth named first or in an honest class, textbook",
    }
    assert "false alarms" not in missed[2]
    assert "NOT REACHED" in show(lines(results))


# --------------------------------------------------------------------------------------------------
# --------- the command


@pytest.mark.usefixtures("here")
def test_without_the_trials_the_command_says_where_they_are(capsys):
    assert main(["prove", "--trials", "nowhere"]) == 2
    assert "tests/blind of a source checkout" in capsys.readouterr().err


def most(n, rate):
    """More hits than this of n have a chance below FALSE_ALARM if each has at most ``rate``."""
    return int(binom.isf(FALSE_ALARM, n, rate))


PROOF = [
    *(("placing_sweep", t) for t in ("null", "single", "data", "unlisted")),
    *(("vertical_turn", t) for t in ("null", "single")),
    *(("six_faces", t) for t in ("null", "impossible")),
    ("six_any", "impossible"),
]


@pytest.mark.long
def test_a_few_blind_trials_hold_what_is_promised(tmp_path):
    """Rates as promised leave these many failures at most; one in ten thousand correct products
    would break a line.
    """
    command = [sys.executable, "-m", "tiltcal"]
    results = [
        trial(tmp_path, kind, type_, k, 20, command, 120.0) for k, (kind, type_) in enumerate(PROOF)
    ]
    assert not [r["note"] for r in results if r["crashed"]]
    alarms = [r["claims"] for r in results if r["type"] in ("null", "impossible")]
    assert sum(alarms) <= most(len(alarms), 0.01)
    strong = [r for r in results if r["type"] in ("single", "unlisted") and max(r["lambda"]) >= 100]
    assert sum(not r["claims"] for r in strong) <= most(len(strong), 0.02)
    named = [e for r in results if r["type"] in ("single", "data") for e in r["effects"]]
    assert sum(e["wrong_certain"] for e in named) <= most(len(named), 0.01)
    # of few effects no number is improbable: each answer of any kind is right or wrong
    wrong = [*alarms, *(not r["claims"] for r in strong), *(not e["good"] for e in named)]
    assert sum(wrong) <= most(len(wrong), 0.05) < len(wrong) / 2


def test_every_trial_can_be_drawn_again_from_its_name():
    assert (
        make("six_any", "impossible", 1, [0, 6, 6, 0]).truth
        == make("six_any", "impossible", 1, [0, 6, 6, 0]).truth
    )


def test_trials_tell_the_time_that_is_left(monkeypatch):
    """Two of five in 80 s: three take 120 s."""
    clock = iter([100.0, 150.0, 180.0])
    monkeypatch.setattr(spread.time, "monotonic", lambda: next(clock))
    count = Count(5)
    assert count.after_one() == "1/5, about 3 min left:"
    assert count.after_one() == "2/5, about 2 min left:"
    monkeypatch.setattr(spread.time, "monotonic", lambda: 300.0)
    assert [count.after_one() for _ in range(3)][-1] == "5/5:"
