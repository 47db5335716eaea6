"""Every benchmark runs to its end at its smallest size."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.benchmarks.__main__ import ROOMS

ROOT = Path(__file__).resolve().parents[1]
pytestmark = pytest.mark.long
JUDGED = {"investigating", "trials"}  # rates of answers: those of no answers are rates too
PROGRAMS = {"baselines", "compare_commits"}  # with command lines of their own


def python(*words):
    return subprocess.run(
        [sys.executable, "-m", *map(str, words)],
        cwd=ROOT,
        env=os.environ | {"TILTCAL_BENCH": "smoke"},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize("room", ROOMS)
def test_a_benchmark_ends(room):
    done = python("tests.benchmarks", room)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "Traceback" not in done.stderr, done.stderr[-2000:]  # of a program that it started
    assert done.stdout
    if room in JUDGED:
        assert re.search(r"no answer at all +0/", done.stdout), done.stdout + done.stderr


def test_every_module_is_a_benchmark_or_a_program():
    modules = {p.stem for p in (ROOT / "tests" / "benchmarks").glob("[!_]*.py")}
    assert modules == {*ROOMS, *PROGRAMS}


@pytest.mark.parametrize("selection", ["greedy", "sparse"])
def test_a_simple_diagnoser_answers(selection, good, tmp_path):
    words = ("diagnose", good / "run.csv", "--scenario", good / "bench.toml", "-o", tmp_path)
    done = python("tests.benchmarks.baselines", selection, *words)
    assert done.returncode == 0, done.stderr[-2000:]
    assert (tmp_path / "diagnosis.json").exists()


def test_the_comparison_of_commits_explains_itself():
    done = python("tests.benchmarks.compare_commits", "--help")
    assert done.returncode == 0, done.stderr[-2000:]
    assert "BASE HEAD" in done.stdout
