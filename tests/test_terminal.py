"""What reaches a terminal or a pipe: tables within the width, options before or after the command,
quiet when it is asked for, and progress with the time left.
"""

import json
import re
import sys

import pytest

from tiltcal.cli import main
from tiltcal.cli.output import fitted_widths, print_table

STATEMENT = re.compile(r"note: |held-out residual of \w+: |(.*, )?six_position: ")
"""Lines that are one sentence: they may be long."""


@pytest.fixture
def narrow(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")


def made(good, *names):
    return [str(good / name) for name in names]


@pytest.mark.parametrize(
    "words",
    [
        ("effects",),
        ("effects", "acc_K2"),
        ("methods",),
        ("datasets", "list"),
        ("explain-frames", "SCENARIO"),
        ("confuse", "SCENARIO"),
        ("noise", "REC"),
        ("segments", "REC"),
        ("check", "CAL", "REC", "--scenario", "SCENARIO"),
        ("calibrate", "REC", "--scenario", "SCENARIO", "--method", "six_position", "--budget"),
        ("run", "SCENARIO"),
        ("design", "SCENARIO", "--budget-s", "60", "--terms", "bias"),
        ("sweep", "SCENARIO", "--effect", "acc_K2.k2_x_ug_g2=0:90:2", "-o", "k2.parquet"),
    ],
    ids=lambda words: "-".join(words[:2]),
)
@pytest.mark.usefixtures("here", "narrow")
def test_lines_in_a_pipe_fit_80_columns(words, good, capsys):
    files = {"SCENARIO": "bench.toml", "REC": "run.csv", "CAL": "CAL.json"}
    assert main([str(good / files[w]) if w in files else w for w in words]) in (0, 1)
    out = capsys.readouterr().out
    wide = [line for line in out.splitlines() if len(line) > 80 and not STATEMENT.match(line)]
    assert out
    assert not wide


def test_columns_shrink_between_words_and_never_below_one():
    cells = [["name", "text"], ["a", "some words that are long"]]
    assert fitted_widths(cells, 80) == ([4, 24], 3)
    assert fitted_widths(cells, 20) == ([4, 11], 2)
    assert fitted_widths(cells, 8) is None


def test_a_table_whose_words_do_not_fit_is_printed_as_lists(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "20")
    print_table(["one", "two"], [["a" * 15, "b" * 15]])
    assert capsys.readouterr().out == f"\none: {'a' * 15}\ntwo: {'b' * 15}\n\n"


@pytest.mark.parametrize(
    "words", [["--json", "methods"], ["methods", "--json"], ["--quiet", "--json", "methods"]]
)
def test_json_and_quiet_stand_before_or_after_the_command(words, capsys):
    assert main(words) == 0
    said = capsys.readouterr()
    assert json.loads(said.out)
    assert said.err == ""


def test_quiet_leaves_errors_and_results(good, here, capsys):
    scenario, recording = made(good, "bench.toml", "run.csv")
    assert main(["simulate", scenario, "-o", "loud.csv"]) == 0
    assert "rows" in capsys.readouterr().err
    for words in (["--quiet", "simulate", scenario], ["simulate", scenario, "--quiet"]):
        assert main([*words, "-o", "quiet.csv"]) == 0
        assert capsys.readouterr() == ("", "")
    assert (here / "quiet.csv").exists()
    assert main(["--quiet", "segments", "none.csv"]) == 2
    assert "none.csv" in capsys.readouterr().err
    assert main(["segments", recording]) == 0


@pytest.mark.usefixtures("here")
def test_the_budget_says_how_long_it_takes(good, monkeypatch):
    from tiltcal.cli import output

    told = []
    monkeypatch.setattr(output._Lines, "show", lambda _, text: told.append(text))
    scenario, recording = made(good, "bench.toml", "run.csv")
    words = ["calibrate", recording, "--scenario", scenario, "--method", "six_position"]
    assert main([*words, "--report", "page.html"]) == 0
    pattern = r"uncertainty budget: (\d+) of (\d+) runs, [\d.e+]+ a second, .+ left"
    counts = [re.fullmatch(pattern, text).groups() for text in told]
    assert counts[-1][0] == counts[-1][1]
    assert len(counts) == int(counts[-1][1])


def test_no_colour_in_a_pipe(capsys):
    assert main(["methods"]) == 0
    assert "\x1b" not in capsys.readouterr().out
    assert not sys.stdout.isatty()
