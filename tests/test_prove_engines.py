"""Blind trials of `diagnose` and `investigate` over every engine."""

import json
import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from blind import loop

from tiltcal.cli import main

FAKE = """\
import json, pathlib, sys, time
words = sys.argv[1:]
out = pathlib.Path(words[words.index("-o") + 1])
if words[0] != "diagnose":
    sys.exit(2)
out.mkdir()
verdict = {"verdict": "match", "findings": []}
(out / "diagnosis.json").write_text(json.dumps(verdict))
"""
NULLS = ["--n", "3", "--kinds", "six_faces", "--types", "null", "--authors", "first"]
RESULT = {
    "lambda": 300.0,
    "verdicts": ["ambiguous", "explained"],
    "forecasts": [[0.8, True]],
    "classes": [["e0"]],
    "said": "",
    "ambiguous": True,
    "held": True,
    "explained": True,
    "minutes": 2.0,
    "quick": True,
}


@pytest.fixture
def fake(here):
    """A command that answers at once."""
    (here / "fake.py").write_text(FAKE)
    return shlex.join([sys.executable, str(here / "fake.py")])


def drawn_cases(folder: Path) -> dict[str, bytes]:
    """The recordings that the trials in a folder were about."""
    return {p.parent.name: p.read_bytes() for p in folder.rglob("recording.csv")}


@pytest.mark.parametrize("engine", [["-j", "2"], ["--engine", "dask", "-j", "2"]])
def test_trials_are_the_same_over_every_engine(engine, fake, here, capfd):
    main(["prove", *NULLS, "--diagnoser", fake, "-o", "one"])
    main(["prove", *NULLS, "--diagnoser", fake, "-o", "more", *engine])
    assert "3/3: six_faces-null" in capfd.readouterr().err
    assert len(drawn_cases(here / "one")) == 3
    assert drawn_cases(here / "one") == drawn_cases(here / "more")
    names = [c["name"] for c in json.loads((here / "more" / "score.json").read_text())["cases"]]
    assert sorted(names) == [f"six_faces-null-00{k}" for k in range(3)]


OTHER_TRIALS = """\
import os, pathlib
def investigated(place, k):
    return [k, os.getppid() != int(place)]
def main(words, spread):
    found = sorted(spread(investigated, [(f"{os.getpid()}", k) for k in range(5)]))
    print(words, found)
    return 0
"""


@pytest.mark.parametrize("engine", [["-j", "2"], ["--engine", "dask"]])
def test_trials_of_investigate_go_over_the_same_engines(engine, here):
    """Another program of trials, whose cases cost nothing to draw."""
    (here / "other" / "blind").mkdir(parents=True)
    for name, text in (("__init__", ""), ("__main__", ""), ("loop", OTHER_TRIALS)):
        (here / "other" / "blind" / f"{name}.py").write_text(text)
    words = ["prove", "--investigate", "--n", "3", "--trials", "other", *engine]
    said = subprocess.run(
        [sys.executable, "-m", "tiltcal", *words], capture_output=True, text=True, check=True
    ).stdout
    apart = engine[0] == "--engine"  # whose processes belong to a worker
    assert (
        said == f"['--n', '3', '--seed', '0', '--shard', '1/1'] {[[k, apart] for k in range(5)]}\n"
    )


def test_investigations_are_scored_however_they_are_spread(monkeypatch, capsys):
    def told(_folder, kind, _seed, k, *_):
        return RESULT | {"kind": kind, "truth": f"e{k}", "right": k > 0}

    def backwards(function, calls):
        return (function(*call) for call in reversed(calls))

    monkeypatch.setattr(loop, "run_case", told)
    said = []
    for spread in (backwards, lambda function, calls: (function(*call) for call in calls)):
        loop.main(["--n", "3", "--seed", "1", "--kinds", "placing_sweep"], spread)
        said.append(capsys.readouterr().out)
    assert said[0] == said[1]
    assert "explained and right within two blocks            2/3" in said[0]


def test_what_does_not_go_together_is_said(fake, capfd):
    for words, said in (
        (["--investigate", "--types", "null"], "found --investigate and --types"),
        (["--engine", "cloud"], "need processes, dask or dask://HOST:PORT"),
        (["--engine", "dask://127.0.0.1:1"], "need a folder that all workers share"),
        (["-j", "0"], "option -j: found 0"),
        (["--shard", "9" * 5000], "argument --shard: found 999"),
        (["--diagnoser", '"a'], "No closing quotation"),
        (["--diagnoser", ""], "argument --diagnoser: no command"),
        (["--kinds", "any"], "argument --kinds: invalid choice: 'any'"),
        (["--investigate"], "argument --kinds: invalid choice: 'six_faces'"),
        (["--n", "0"], "0 is not from 1 to 100000"),
    ):
        assert main(["prove", *NULLS[:4], "--diagnoser", fake, *words]) == 2
        told = capfd.readouterr().err
        assert said in told
        assert told.count("\n") == 1


def test_an_interrupt_ends_the_diagnoser_with_the_trials(here):
    """Also where it runs in a session of its own."""
    (here / "slow.py").write_text(
        "import os, pathlib, time\n"
        f"pathlib.Path({str(here)!r}, 'pid').write_text(str(os.getpid()))\ntime.sleep(60)\n"
    )
    slow = shlex.join([sys.executable, str(here / "slow.py")])
    command = [sys.executable, "-m", "tiltcal", "prove", *NULLS, "--diagnoser", slow, "-o", "out"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        until = time.monotonic() + 30
        while not (here / "pid").exists() or not (here / "pid").read_text():
            assert time.monotonic() < until
            time.sleep(0.02)
        process.send_signal(signal.SIGTERM)
        assert "interrupted after 0 of 3; run again with -o" in process.stderr.read()
        assert process.wait(20) == 143
    with pytest.raises(ProcessLookupError):
        os.kill(int((here / "pid").read_text()), 0)


def test_the_loop_scores_what_was_stated_of_its_blocks():
    """Two forecasts by hand: 0.6, which did not come true, and 0.8, which did."""
    verdicts = ["ambiguous", "ambiguous", "explained", "explained"]
    blocks = [{"confidence": 0.6}, {"confidence": 0.8}, {"confidence": 0.0}]
    told = loop.forecasts(verdicts, blocks)
    assert told == [(0.6, False), (0.8, True)]
    shown = loop.show([{**RESULT, "kind": "placing_sweep", "truth": "e0", "right": True}])
    assert "stated 80 %, came true 100 % of 1, Brier score 0.04" in shown
    two = {**RESULT, "kind": "placing_sweep", "truth": "e0", "right": True, "forecasts": told}
    assert "stated 70 %, came true 50 % of 2, Brier score 0.20" in loop.show([two])
