"""What a file from somebody else may do: nothing but be read. Each test fails without its guard."""

import csv
import errno
import io
import json
import os
import pty
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from scenario_files import BENCH_SCENARIO, refusal

from tiltcal.calibration.firmware.header import header, in_comment
from tiltcal.calibration.result import load_calibration, setup_of
from tiltcal.cli import main
from tiltcal.core.safe_text import cell_of, plain, text_of
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.recording_files import read_recording
from tiltcal.recordings.saving import write_recording

ESCAPE = "\x1b[2J\x1b]0;owned\x07"
MARKUP = "</script><script>alert(1)</script><a href=x>y</a>"
SENTINEL = "import pathlib; pathlib.Path('was_run').write_text('yes')\n"
SMALL = BENCH_SCENARIO.replace("rate_hz = 50", "rate_hz = 10")
PLACING = """\
schema = 1
[site]
gravity_m_s2 = 9.8
[rig]
table = "placing"
[[sensor]]
name = "accel"
kind = "accelerometer"
rate_hz = 10
"""


def named(name: str) -> str:
    """A scenario of that name."""
    return SMALL.replace('name = "bench"', f"name = {json.dumps(name)}")


# ---- terminal


@pytest.mark.parametrize("text", [ESCAPE, "a\rb", "\x9b31m", "\u202egpj.exe", "\ud800", "\x00"])
def test_nothing_that_commands_a_terminal_is_plain(text):
    assert all(c.isprintable() for c in plain(text))


def test_text_lines_and_letters_of_all_languages_stay_as_they_are():
    assert plain("°C, 倾角\n\tµg") == "°C, 倾角\n\tµg"


@pytest.mark.parametrize("words", [[ESCAPE], ["simulate", ESCAPE], ["effects", ESCAPE]])
def test_arguments_cannot_command_a_terminal(words, here, capsys):
    refusal(words, here, capsys)
    assert main(words) == 2
    assert "\x1b" not in capsys.readouterr().err


def test_names_from_files_cannot_command_a_terminal(here, capsys):
    (here / "s.toml").write_text(named(f"bench {ESCAPE}"))
    assert main(["run", "s.toml"]) == 0
    out, err = capsys.readouterr()
    assert "bench \\x1b[2J" in out
    assert not {"\x1b", "\x07"} & set(out + err)


def test_only_one_module_of_the_command_line_writes_to_a_terminal():
    """All others go through it; only the boundary is beside it."""
    folder = Path(__file__).parents[1] / "tiltcal" / "cli"
    writing = {
        path.name
        for path in folder.glob("*.py")
        if any(
            words in path.read_text(encoding="utf-8")
            for words in (" print(", "(print(", "stdout.write", "stderr.write", "stdout.buffer")
        )
    }
    assert writing <= {"__init__.py", "output.py"}


def read_into(shown, terminal):
    """Read until the other end is closed, which is an error of the operating system."""
    while True:
        shown += terminal.read(1 << 16) or b""


def test_a_recording_on_a_terminal_cannot_command_it_and_into_a_pipe_it_is_exact(here):
    (here / "s.toml").write_text(SMALL.replace('"+z"', '"\\u001b[2J"'))
    words = [sys.executable, "-m", "tiltcal", "simulate", "s.toml"]
    piped = subprocess.run(words, capture_output=True, check=True).stdout
    assert b"\x1b[2J" in piped
    ours, theirs = pty.openpty()
    done = subprocess.Popen(words, stdout=theirs, stderr=subprocess.DEVNULL)
    os.close(theirs)
    shown = bytearray()
    with os.fdopen(ours, "rb", buffering=0) as terminal, pytest.raises(OSError) as closed:
        read_into(shown, terminal)
    assert closed.value.errno == errno.EIO  # the other end is closed
    assert done.wait() == 0
    assert b"accel_x_m_s2" in shown
    assert b"\x1b" not in shown


# ---- CSV


@pytest.mark.parametrize(
    "text", ["=1+1", "@sum(a)", "+1+cmd|' /C calc'!A0", "-2+3", "\t=1", "\r=1"]
)
def test_a_formula_in_a_cell_computes_nothing_and_reads_back(text):
    assert cell_of(text).startswith("'")
    assert text_of(cell_of(text)) == text


@pytest.mark.parametrize("text", ["+x", "-z", "-1.5e3", "[0,0,1]", "'quoted'", "", "level", "it's"])
def test_directions_and_words_are_written_as_they_are(text):
    assert cell_of(text) == text_of(text) == text


def test_texts_that_look_escaped_read_back_too():
    for text in ("'=1", "''=1", "'", "''", "'a"):
        assert text_of(cell_of(text)) == text


def test_no_cell_of_a_recording_is_a_formula(here):
    labels = np.array(["+x", "=1+1", "-2+3", None], dtype=object)
    recording = Recording.from_columns(
        np.arange(4.0),
        {"=a_g": np.arange(4.0)},
        labels=labels,
        extra={"@note": labels},
        metadata={"by": "a,=1+1"},
    )
    write_recording(recording, here / "r.csv")
    text = (here / "r.csv").read_text()
    cells = [cell for row in csv.reader(io.StringIO(text)) for cell in row]
    assert [c for c in cells if c[:1] in ("=", "@")] == []
    assert "-2+3" not in cells
    back = read_recording(here / "r.csv")
    assert list(back.labels) == list(labels)
    assert list(back.extra["@note"]) == list(labels)
    assert back.column_names == ["=a_g"]


def test_no_cell_of_the_table_of_runs_is_a_formula(here):
    (here / "s.toml").write_text(named("=HYPERLINK(1)"))
    assert main(["run", "s.toml", "-o", "out"]) == 0
    rows = list(csv.DictReader(io.StringIO((here / "out" / "runs.csv").read_text())))
    assert rows[0]["scenario"] == "'=HYPERLINK(1)"


# ---- C, XML, HTML


def placing_table(here: Path, source: str) -> Path:
    """A CAL.json with a small table, said to come from a recording of that name."""
    entries = [
        {"angle_deg": a, "value": 0.001, "sigma": 0.0, "unit": "m_s2"} for a in (0.0, 10.0, 20.0)
    ]
    table = {
        "method": "placing_table",
        "verdict": "good",
        "parameters": {},
        "bias_tables": {"accel.x": entries, "accel.y": entries},
        "provenance": {
            "recording": source,
            "setup": {
                "site": {"gravity_m_s2": 9.8},
                "rig": {"table": "placing"},
                "sensor": [{"name": "accel", "kind": "accelerometer"}],
            },
        },
    }
    (here / "T.json").write_text(json.dumps(table))
    return here / "T.json"


def test_a_name_from_a_file_stays_in_its_comment_of_a_c_header(here):
    c = load_calibration(placing_table(here, "*/ int x; /*\r\n*/ int y;\x1b /*"))
    text = header(c, setup_of(c))
    outside = "".join(part.partition("*/")[2] for part in text.split("/*"))
    assert "int x;" in text
    assert "int x;" not in outside
    assert "int y;" not in outside
    assert "\x1b" not in text
    assert not {"*/", "/*"} & {in_comment("**//**/")[k : k + 2] for k in range(12)}


@pytest.mark.parametrize("name", ["a b", "x;int", "*/", "1a", "é", ""])
def test_only_c_names_are_prefixes_of_a_header(name, here, capsys):
    words = ["export", placing_table(here, "r.csv"), "--name", name, "-o", here / "t.h"]
    assert "C name" in refusal(words, here, capsys)


def test_names_cannot_put_markup_into_xml_and_html(here):
    (here / "s.toml").write_text(named(MARKUP + ESCAPE))
    assert main(["run", "s.toml", "-o", "out"]) == 0
    suite = ElementTree.parse(here / "out" / "junit.xml").getroot()[0]
    assert suite.get("name", "").startswith(MARKUP)
    page = (here / "out" / "report.html").read_text()
    assert "<script>alert(1)" not in page
    assert "<a href=x>" not in page
    assert "\\u003ca href" not in page  # in the data of a figure, which reads markup itself


# ---- what is run


def stand_in(here: Path) -> None:
    """Files of the names of packages that the program imports."""
    for name in ("jinja2", "plotly", "scipy", "pyarrow", "rich", "xml", "secrets"):
        (here / f"{name}.py").write_text(SENTINEL)


@pytest.mark.parametrize(
    "program", [["-m", "tiltcal"], ["-c", "from tiltcal.cli import main; raise SystemExit(main())"]]
)
def test_files_of_the_working_folder_are_not_run(program, here):
    stand_in(here)
    two = SMALL.replace('name = "six_position"', 'name = "six_position"\nruns = 2')
    (here / "s.toml").write_text(two)  # so that both workers are needed
    safe = [] if program[0] == "-m" else ["-P"]  # a console script has no such entry
    words = [sys.executable, *safe, *program, "run", "s.toml", "-o", "out", "-j", "2"]
    done = subprocess.run(words, capture_output=True, check=False, text=True)
    assert done.returncode == 0, done.stderr
    assert not (here / "was_run").exists()


def test_a_method_of_the_users_own_comes_from_the_working_folder_after_all_packages(here):
    stand_in(here)
    (here / "s.toml").write_text(SMALL)
    (here / "mine.py").write_text(
        "import jinja2\nfrom tiltcal.calibration.methods.six_position import six_position\n"
        "assert hasattr(jinja2, 'Environment')\nmethod = six_position\n"
    )
    python = [sys.executable, "-m", "tiltcal"]
    subprocess.run([*python, "simulate", "s.toml", "-o", "r.csv"], check=True, capture_output=True)
    words = ["calibrate", "r.csv", "--scenario", "s.toml", "--method", "mine:method"]
    done = subprocess.run([*python, *words], capture_output=True, check=False, text=True)
    assert done.returncode == 0, done.stderr
    assert not (here / "was_run").exists()


def test_a_scenario_runs_no_program_unless_it_is_allowed(here, capsys):
    (here / "s.toml").write_text(SMALL + '[[method]]\ncommand = ["touch", "was_run"]\n')
    for command in ("run", "verify"):
        assert "need permission to run programs" in refusal([command, "s.toml"], here, capsys)
    assert not (here / "was_run").exists()
