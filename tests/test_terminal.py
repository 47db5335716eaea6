"""What reaches a terminal or a pipe: tables within the width, options before or after the command,
quiet when it is asked for, and progress with the time left.
"""

import json
import os
import pty
import re
import shutil
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from tiltcal.cli import main, output
from tiltcal.cli.commands import COMMANDS
from tiltcal.cli.output import fitted_widths, print_table
from tiltcal.core.progress import Stages

VISIBLE = ("--all-effects-observable", "14", "--terms", "acc_K2", "acc_Kip", "acc_drift")
CAMPAIGN = """\
schema = 1
scenario = "bench.toml"
name = "dwell and noise"
[[factor]]
field = "effect.acc_noise.white_ug_rthz"
values = [20, 100]
"""
LEFT = r".* (about|or more|[\d.]+ a second,) .*left"


@pytest.fixture
def narrow(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")


def made(good, *names):
    return [str(good / name) for name in names]


def named(words, good):
    """The words of a command line, with the files that they stand for."""
    files = {"SCENARIO": "bench.toml", "REC": "run.csv", "CAL": "CAL.json"}
    if "CAMPAIGN" in words:
        shutil.copy(good / "bench.toml", "bench.toml")
        Path("CAMPAIGN").write_text(CAMPAIGN)
    return [str(good / files[w]) if w in files else w for w in words]


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
        ("diagnose", "REC", "--scenario", "SCENARIO", "-o", "out"),
        ("verify", "SCENARIO", "-o", "out"),
        ("campaign", "CAMPAIGN", "-o", "out"),
        ("design", "SCENARIO", *VISIBLE),
        ("sweep", "SCENARIO", "--effect", "acc_K2.k2_x_ug_g2=0:90:2", "-o", "k2.parquet"),
    ],
    ids=lambda words: "-".join(words[:2]),
)
@pytest.mark.usefixtures("here", "narrow")
def test_lines_in_a_pipe_fit_80_columns_and_long_work_tells_the_time_left(
    words, good, capsys, told
):
    assert main([*named(words, good), "--progress"]) in (0, 1)
    out = capsys.readouterr().out
    assert out
    assert [line for line in out.splitlines() if len(line) > 80] == []
    if words[0] in ("diagnose", "design", "verify", "campaign"):
        assert [text for text in told if re.fullmatch(LEFT, text)]


@pytest.mark.parametrize("command", ["", *COMMANDS])
@pytest.mark.usefixtures("narrow")
def test_help_fits_80_columns(command, capsys):
    assert main([*command.split(), "--help"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if len(line) > 80] == []


def test_sentences_are_wrapped_and_never_into_pillars():
    cells = [["name", "a text of a row"], ["a", "some words that make a sentence"]]
    assert fitted_widths(cells, 80) == ([4, 31], 3)
    assert fitted_widths(cells, 36) == ([4, 27], 2)
    assert fitted_widths(cells, 28) is None
    assert fitted_widths([["a long name", "b"], ["1 mm", "2"]], 12) == ([6, 1], 2)


def test_columns_that_may_be_spared_are_left_out_and_named(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "24")
    rows = [["a" * 10, "b" * 10, "c" * 10]]
    print_table(["one", "two", "three"], rows, spare=["two", "three"])
    out = capsys.readouterr().out
    assert "c" * 10 in out
    assert "b" not in out
    assert " ".join(out.split()).endswith("not shown in 24 columns: two")
    monkeypatch.setenv("COLUMNS", "80")
    print_table(["one", "two", "three"], rows, spare=["two", "three"])
    assert "not shown" not in capsys.readouterr().out


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
    for words in (
        ["--quiet", "simulate", scenario],
        ["simulate", scenario, "--quiet"],
        ["simulate", "-q", scenario],
    ):
        assert main([*words, "-o", "quiet.csv"]) == 0
        assert capsys.readouterr() == ("", "")
    assert (here / "quiet.csv").exists()
    assert main(["--quiet", "segments", "none.csv"]) == 2
    assert "none.csv" in capsys.readouterr().err
    assert main(["segments", recording]) == 0


@pytest.fixture
def told(monkeypatch):
    """What commands tell of their progress."""
    words = []
    monkeypatch.setattr(output._Lines, "show", lambda _, text: words.append(text))
    return words


@pytest.mark.usefixtures("here")
def test_a_film_tells_the_time_left(good, told):
    words = ("film", "SCENARIO", "--seconds", "0.2", "-o", "film.mp4", "--progress")
    assert main(named(words, good)) == 0
    assert [text for text in told if re.fullmatch(LEFT, text)]


@pytest.mark.usefixtures("here")
def test_work_tells_of_its_progress_in_a_pipe_where_it_is_asked_for(good, told):
    """All commands tell it in one place."""
    words = named(("verify", "SCENARIO"), good)
    assert main(words) == 0
    assert main([*words, "--progress", "--quiet"]) == 0
    assert told == []
    assert main(["--progress", *words]) == 0
    assert told


@pytest.mark.usefixtures("here")
def test_an_import_tells_its_stages(told):
    rows = "".join(f"{k / 50},0.{k % 7},0.2,9.8\n" for k in range(50))
    Path("log.csv").write_text(f"t,ax,ay,az\n{rows}")
    assert main(["import", "log.csv", "--propose", "-o", "map.toml"]) == 0
    assert main(["import", "log.csv", "--map", "map.toml", "-o", "run.csv", "--progress"]) == 0
    assert [text.partition(":")[0] for text in told] == ["reading", "checking", "writing"]


def test_the_time_left_follows_the_shares_of_the_stages(monkeypatch):
    now, told = [0.0], []
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    stages = Stages(told.append, {"first": 1.0, "second": 2.0, "third": 1.0})
    stages.begin("first")
    for now[0], act, argument in (
        (1.0, stages.part, 0.5),  # an eighth of the work in 1 s
        (2.0, stages.begin, "second"),
        (3.0, stages.status, "one found"),
        (9.0, stages.status, "two found"),  # beyond its share: what is left is a lower bound
        (9.0, stages.begin, "third"),
        (9.0, stages.part, 0.5),
    ):
        act(argument)
    assert told == [
        "first",
        "first: about 7 s left",
        "second: about 6 s left",
        "second (one found): about 5 s left",
        "second (two found): 3 s or more left",
        "third: about 3 s left",
        "third: about 1 s left",
    ]


def shown_on(terminal):
    """What a program shows, until it ends: a terminal that nobody reads is soon full."""
    with os.fdopen(terminal, "rb", buffering=0) as reader, suppress(OSError):
        while data := reader.read(4096):
            yield data.decode(errors="replace")


def test_on_a_terminal_progress_is_one_line_with_the_time_left(good):
    """A diagnosis on a pseudo-terminal: its last words on progress are followed by none."""
    scenario, recording = made(good, "bench.toml", "run.csv")
    program = [sys.executable, "-m", "tiltcal", "diagnose", recording, "--scenario", scenario]
    reader, writer = pty.openpty()
    with subprocess.Popen(program, stderr=writer, stdout=subprocess.PIPE, text=True) as process:
        os.close(writer)
        shown = "".join(shown_on(reader))
        said = process.stdout.read()
    assert process.returncode == 0
    assert re.search(r": .*left", shown)  # of a stage: shown once a second
    assert shown.count("\n") <= shown.count("\x1b[1A") + 1  # each line is written over
    assert said.startswith("match")


def test_no_colour_in_a_pipe(capsys):
    assert main(["methods"]) == 0
    assert "\x1b" not in capsys.readouterr().out
    assert not sys.stdout.isatty()


def test_a_reminder_keeps_no_new_line_back(monkeypatch, capsys):
    """New text is written also right after what a silence was filled with."""
    monkeypatch.setattr(output, "SILENCE_S", 0.5)
    lines = output._Lines()
    try:
        until = time.monotonic() + 10
        while not (told := capsys.readouterr().err):
            assert time.monotonic() < until
            time.sleep(0.02)
        assert told.startswith("working ... ")
        lines.show("4 of 10 runs")
        assert capsys.readouterr().err.startswith("4 of 10 runs\n")
    finally:
        lines.close()
