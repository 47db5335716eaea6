"""Scores by author, three effects at once, probabilities that are to hold, the frozen set, and
another program in the place of this one.
"""

import hashlib
import json
import shlex
import sys

import numpy as np
import pytest
from blind.cases import KINDS, TYPES, make, possible
from blind.judge import judge
from blind.oracle import space
from blind.plans import benchmark, plan
from blind.reliability import reliability, show, summary, which_bin
from blind.table import lines
from test_blind_trials import effect, finding, judged, truth_of

from tiltcal.cli import main

FAKE = """\
import json, pathlib, sys
words = sys.argv[1:]
if words[0] != "diagnose":
    sys.exit(2)
out = pathlib.Path(words[words.index("-o") + 1])
out.mkdir()
finding = {"effect": "acc_K2", "class": ["acc_K2"], "stage": "sensor", "sensors": [], "axes": [],
           "where": {}, "parameters": {}, "probability": 0.95, "names": {"acc_K2": 0.6}}
(out / "diagnosis.json").write_text(json.dumps({"verdict": "explained", "findings": [finding]}))
"""


# --------------------------------------------------------------------------------------------------
# cases


def test_three_effects_are_three_names_that_can_be_told_apart():
    case = make("field_turns", "triple", 1, [7, 4, 7, 0])
    ids = {e["id"] for e in case.truth["effects"]}
    assert len(ids) == len(case.truth["effects"]) == 3
    for e in case.truth["effects"]:
        assert e["lambda"] >= 100
        assert not (ids - {e["id"]}) & set(e["inseparable"])


def test_cases_of_the_first_author_are_those_they_always_were():
    """Drawn before there was a second one."""
    for kind, type_, ids, lam, reading in (
        ("dual_tumble", "null", [], [], 1.3176582230588376),
        ("field_turns", "unlisted", ["u_leaky_turns"], [114.42205751], -0.00114067005609),
        (
            "field_turns",
            "pair",
            ["data_latency", "fog_shupe"],
            [649.122098046, 55848.431240895],
            -0.00285674037666,
        ),
    ):
        case = make(kind, type_, 1, [5, KINDS.index(kind), TYPES.index(type_), 1])
        assert [e["id"] for e in case.truth["effects"]] == ids
        assert [e["lambda"] for e in case.truth["effects"]] == pytest.approx(lam, rel=1e-6)
        assert case.rows.y[100, 0] == pytest.approx(reading, rel=1e-6)


def test_columns_that_others_make_up_take_nothing_from_a_signal():
    """By hand the adjustable terms are not independent: a basis of arbitrary directions in their
    place took some 1e-4 of every non-centrality, another part on every processor.
    """
    rng = np.random.default_rng(3)
    columns = rng.normal(size=(200, 4))
    signal = rng.normal(size=200)
    more = np.column_stack([columns, columns @ rng.normal(size=(4, 3)), np.zeros(200)])
    expected = signal - columns @ np.linalg.lstsq(columns, signal, rcond=None)[0]
    for own in (columns, more, more * 10.0 ** rng.uniform(-6, 6, more.shape[1])):
        Q = space(own)
        assert Q.shape[1] == 4
        np.testing.assert_allclose(signal - Q @ (Q.T @ signal), expected, atol=1e-9)


def test_the_authors_draw_differently_and_each_the_same_every_time():
    first, second, again = (
        make("field_turns", "unlisted", 1, [7, 4, 5, 0], author)
        for author in ("first", "second", "second")
    )
    assert first.truth["effects"][0]["id"].startswith("u_")
    assert second.truth["effects"][0]["id"].startswith("s_")
    assert (second.rows.y == again.rows.y).all()
    assert second.truth["effects"][0]["lambda"] >= 60


def test_a_plan_asks_every_author_for_what_has_authors():
    jobs = plan(2, ["dual_tumble"], ["null", "single"], ["first", "second"])
    assert [(j.type_, j.author) for j in jobs[:3]] == [
        ("null", "first"),
        ("null", "second"),
        ("single", "first"),
    ]
    assert len(jobs) == 6
    assert {j.author for j in plan(3, types=["null"], authors=["second"])} == {"second"}


def test_the_frozen_set_stays_as_it_is():
    jobs = benchmark()
    assert len(jobs) == len(set(jobs)) == 200
    assert {j.kind for j in jobs} == set(KINDS)
    assert {j.type_ for j in jobs} == set(TYPES)
    assert all(possible(j.kind, j.type_) for j in jobs)
    listing = "\n".join(f"{j.kind} {j.type_} {j.k} {j.author}" for j in jobs)
    assert hashlib.sha256(listing.encode()).hexdigest()[:16] == "dde6563af2510a6c"


# --------------------------------------------------------------------------------------------------
# judging


def test_each_of_three_has_to_be_found():
    three = [effect(), effect(id="table_levelling", stage="table"), effect(id="acc_warmup")]
    said, _ = judged(
        truth_of("triple", *three), "explained", finding("acc_K2"), finding("acc_warmup")
    )
    assert [e["good"] for e in said["effects"]] == [True, False, True]
    rates = {x.name: (x.hits, x.n) for x in lines([said | {"seconds": 1.0}])}
    assert rates["triples: all three found"] == (0, 1)
    every = [finding(e["id"], stage=e["stage"]) for e in three]
    said, _ = judged(truth_of("triple", *three), "explained", *every)
    rates = {x.name: (x.hits, x.n) for x in lines([said | {"seconds": 1.0}])}
    assert rates["triples: all three named or in honest classes"] == (1, 1)


def unlisted_answer(author, verdict, *findings, lam=900.0):
    new = effect(id="s_x", listed=False, where=["tilt"], **{"lambda": lam})
    truth = {**truth_of("unlisted", new), "author": author, "nuisance": None}
    truth["heldout"] = {"nominal": 10.0, "oracle": 0.5}
    return {**judge(truth, {"verdict": verdict, "findings": list(findings)}, 2.0), "seconds": 1.0}


def test_every_author_has_rates_of_its_own():
    results = [
        unlisted_answer("second", "unlisted", finding(None)),
        unlisted_answer("second", "unlisted", finding(None, where={"coordinate": "time"})),
        unlisted_answer("second", "ambiguous", finding("acc_K2", "acc_K3")),
        unlisted_answer("second", "unlisted", finding(None), finding("acc_K2")),
        unlisted_answer("second", "match", lam=80.0),
    ]
    table = lines(results)
    start = next(k for k, x in enumerate(table) if x.name.startswith("second author"))
    own = {x.name.strip(): (x.hits, x.n) for x in table[start : start + 8]}
    assert own["unlisted said so, lambda >= 100"] == (3, 4)
    assert own["unlisted given a certain wrong name"] == (1, 5)
    assert own["coordinate plausible, of those said so"] == (2, 3)
    assert own["detected at lambda >= 100"] == (4, 4)
    assert own["detected at lambda 40 to 100"] == (0, 1)
    assert own["unlisted: rms over the oracle's (median)"] == (4.0, 5)
    assert own["unlisted: rms over the nominal model's (median)"] == (0.2, 5)
    assert not [x for x in table if x.name.startswith("first author")]


def test_a_stated_name_is_right_when_it_is_the_true_one_or_leaves_its_trace():
    def said(truth, **names):
        told = finding("acc_K2", probability=0.9, names=names)
        return judged(truth, "explained", told)[0].get("stated")

    single = truth_of("single", effect(inseparable=["acc_K3"]))
    assert said(single, acc_K2=0.7, unlisted=0.3) == {
        "exists": [[0.9, True]],
        "name": [[0.7, True]],
    }
    assert said(single, acc_K3=0.8, acc_K2=0.2)["name"] == [[0.8, False]]
    assert said(truth_of("null"), acc_K2=0.7) == {"exists": [[0.9, False]], "name": [[0.7, False]]}
    new = truth_of("unlisted", effect(id="s_x", listed=False))
    assert said(new, unlisted=0.6, acc_K2=0.4)["name"] == [[0.6, True]]
    spikes = truth_of("data", effect(id="emi_spike", stage="data"))
    assert said(spikes, data_outlier=0.6)["name"] == [[0.6, True]]
    assert said(truth_of("impossible", effect()), acc_K2=0.7) is None


def test_reliability_is_the_one_worked_by_hand():
    """Four statements. Brier: (0.4^2 + 0.6^2 + 0.2^2 + 0) / 4. Calibration error: two of 0.6 of
    which one is so (0.1 each), one of 0.8 that is (0.2), one of 1 that is (0): 0.4 / 4.
    """
    cases = [np.array([[0.6, 1.0], [0.6, 0.0]]), np.array([[0.8, 1.0]]), np.array([[1.0, 1.0]])]
    told = summary(cases)
    assert told["brier"]["value"] == pytest.approx(0.14)
    assert told["calibration_error"]["value"] == pytest.approx(0.1)
    assert [(b["right"], b["n"]) for b in told["bins"]] == [(0, 0), (1, 2), (1, 1), (0, 0), (1, 1)]
    low, high = told["brier"]["interval"]
    # all resampled from the case that is certain and right, or from the first one
    assert low == pytest.approx(0, abs=0.02)
    assert high == pytest.approx(0.26, abs=0.02)
    assert summary(cases[:1])["brier"]["interval"] == pytest.approx((0.26, 0.26))
    assert which_bin(np.array([0, 0.5, 0.75, 0.9, 0.99, 1.0])).tolist() == [0, 1, 2, 3, 4, 4]


def test_without_stated_probabilities_the_section_is_left_out():
    plain, _ = judged(truth_of("single", effect()), "explained", finding("acc_K2"))
    assert reliability([plain]) == {}
    assert show({}) == ""
    told, _ = judged(
        truth_of("single", effect()), "explained", finding("acc_K2", names={"acc_K2": 0.97})
    )
    text = show(reliability([plain, told]))
    assert "likeliest name" in text
    assert "0.90 .. 0.99" in text
    assert "something is there" not in text


# --------------------------------------------------------------------------------------------------
# the command


@pytest.mark.usefixtures("here")
def test_another_program_may_be_judged(tmp_path, capfd):
    (tmp_path / "fake.py").write_text(FAKE)
    fake = shlex.join([sys.executable, str(tmp_path / "fake.py")])
    words = ["prove", "--n", "2", "--kinds", "six_faces", "--types", "null", "--authors", "second"]
    main([*words, "--diagnoser", fake, "-o", "out"])
    said = capfd.readouterr().out
    assert "second author: false alarms" in said
    assert "first author: false alarms" not in said
    assert "probability that something is there: 2 cases" in said
    score = json.loads((tmp_path / "out" / "score.json").read_text())
    assert [c["findings"] for c in score["cases"]] == [["acc_K2"]] * 2
    bins = score["reliability"]["exists"]["bins"]
    assert [(b["right"], b["n"]) for b in bins if b["n"]] == [(0, 2)]


@pytest.mark.usefixtures("here")
def test_shards_share_a_folder_and_a_last_call_scores_all(tmp_path, capfd):
    (tmp_path / "fake.py").write_text(FAKE)
    fake = shlex.join([sys.executable, str(tmp_path / "fake.py")])
    words = ["prove", "--n", "3", "--kinds", "six_faces", "--types", "null", "--authors", "second"]
    words += ["--diagnoser", fake, "-o", "out"]
    counts = {"1/2": 2, "2/2": 1, "1/1": 3}
    for shard, count in counts.items():
        main([*words, "--shard", shard])
        capfd.readouterr()
        score = json.loads((tmp_path / "out" / "score.json").read_text())
        assert len(score["cases"]) == count
    main([*words, "--shard", "3/2"])
    assert "found 3/2, need i/n with i from 1 to n" in capfd.readouterr().err
