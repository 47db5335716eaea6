"""How a command ends when its words, a foreign log, the user, the reader of a pipe or the program
itself stops it.
"""

import os
import subprocess
import sys

import pytest
from scenario_files import BENCH_SCENARIO, refusal

from tiltcal.cli import main, methods

MAP = '[file]\n{file}\n[time]\nrate_hz = 10\n[[column]]\nfrom = {source}\nto = "{to}"\n'


@pytest.fixture
def here(here):
    """A working directory with a scenario."""
    (here / "bench.toml").write_text(BENCH_SCENARIO)
    return here


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["calibrte"], "unknown command 'calibrte'"),
        (["simulate"], "no SCENARIO"),
        (["simulate", "bench.toml", "--noise", "off", "--quick"], "unknown option: --quick"),
        (["simulate", "bench.toml", "--seed", "x"], "--seed: 'x' is not a whole number"),
        (["simulate", "bench.toml", "--json"], "--json without -o"),
        (["correct", "CAL.json", "run.csv", "--json"], "--json without -o"),
        (["calibrate", "run.csv"], "no --scenario, --method"),
        (["calibrate", "run.csv", "--scenario", "bench.toml"], "no --method"),
        (["init", "--latitude", "123"], "123 deg"),
        (["segments", "run.csv", "--window", "0"], "--window: found 0 s"),
        (["segments", "run.csv", "--window", "nan"], "nan is no number of at most 1e+30"),
        (["effects", "acc_bais"], "'acc_bais'"),
        (["simulate", "bench.toml", "-o", "run.xlsx"], "the ending '.xlsx'"),
        (
            ["simulate", "bench.toml", "-o", "run.csv", "--truth", "none/truth.json"],
            "no such file or directory",
        ),
        (
            ["simulate", "bench.toml", "-o", "none/run.csv", "--truth", "truth.json"],
            "no such file or directory",
        ),
    ],
)
def test_a_wrong_command_line_is_refused_in_the_same_words(words, found, here, capsys):
    message = refusal(words, here, capsys)
    assert found in message


def mapped(file="", source=1, to="a_x_g", more=""):
    return MAP.format(file=file, source=source, to=to) + more


BARE = "header = false"
TWICE = '[[column]]\nfrom = 1\nto = "a_x_g"\n'
SECOND = '[[column]]\nfile = "b.txt"\nfrom = 1\nto = "b_x_g"\n'
FOREIGN = {
    "no mapping": (None, "1 2 3\n", "no such file"),
    "a wrong key": (
        mapped("seperator = 'tab'"),
        "1\n",
        "file.seperator: unknown key; did you mean 'separator'?",
    ),
    "no unit": (mapped(to="accel_x"), "1\n", "'accel_x' ends in no unit"),
    "twice": (mapped(more=TWICE), "a\n1\n", "'a_x_g' stands twice"),
    "no TOML": ("[file", "1\n", "valid TOML"),
    "no time": (TWICE, "1\n", "time: Field required"),
    "no column": (mapped(source="'acc_y'"), "acc_x,acc_z\n1,2\n", "no column acc_y"),
    "text": (mapped(), "x,y\n1,2\noops,3\n", "data line 2: found the text 'oops'"),
    "ragged": (mapped(), "x,y\n1,2\n3\n4,5,6\n", "data line 2: found 1 cells, need 2"),
    "empty": (mapped(BARE), "", "no rows"),
    "no second file": (mapped(BARE, more=SECOND), "1\n", "b.txt: found no such file"),
}


@pytest.mark.parametrize("case", FOREIGN)
def test_a_foreign_log_that_does_not_fit_its_mapping_is_refused(case, here, capsys):
    mapping, log, words = FOREIGN[case]
    if mapping is not None:
        (here / "map.toml").write_text(mapping)
    (here / "log.txt").write_text(log)
    assert words in refusal(
        ["import", "log.txt", "--map", "map.toml", "-o", "run.csv"], here, capsys
    )


def test_import_refuses_files_that_are_not_there_and_places_that_cannot_be_written(here, capsys):
    (here / "map.toml").write_text(MAP.format(file="header = false", source=1, to="accel_x_g"))
    (here / "log.txt").write_text("1\n2\n")
    assert "no such file" in refusal(
        ["import", "none.txt", "--map", "map.toml", "-o", "run.csv"], here, capsys
    )
    assert "no such file" in refusal(
        ["import", "log.txt", "--map", "map.toml", "-o", "no/run.csv"], here, capsys
    )


@pytest.mark.parametrize("log", ["x,y,z\n1,,3\n4,,6\n7,,9\n", "x,y,z\n1,2,3\n\n4,5,6\n7,8,9\n"])
def test_empty_cells_and_lines_of_a_foreign_log_do_not_shift_its_rows(log, here):
    (here / "map.toml").write_text(MAP.format(file="", source="'z'", to="accel_z_g"))
    (here / "log.txt").write_text(log)
    assert main(["import", "log.txt", "--map", "map.toml", "-o", "run.csv"]) == 0
    rows = (here / "run.csv").read_text().splitlines()[-3:]
    assert rows == ["0,3", "0.1,6", "0.2,9"]


def raising(error):
    def run(*_):
        raise error

    return run


def test_ctrl_c_ends_with_130_and_a_word(monkeypatch, capsys):
    monkeypatch.setattr(methods, "methods", raising(KeyboardInterrupt()))
    assert main(["methods"]) == 130
    assert capsys.readouterr().err == "tiltcal: interrupted; no partial output is left\n"


def test_ctrl_c_in_the_middle_of_writing_leaves_nothing(here, monkeypatch):
    monkeypatch.setattr("tiltcal.recordings.pieces.csv_writer", raising(KeyboardInterrupt()))
    assert main(["simulate", "bench.toml", "-o", "run.csv", "--truth", "truth.json"]) == 130
    assert [p.name for p in here.iterdir()] == ["bench.toml"]


def test_an_error_of_our_own_is_told_in_words_and_raised_on_request(monkeypatch, capsys):
    monkeypatch.setattr(methods, "methods", raising(RuntimeError("lost")))
    assert main(["methods"]) == 2
    err = capsys.readouterr().err
    assert err.startswith(
        "tiltcal: found an internal error (RuntimeError: lost), need a bug report;"
    )
    assert err.count("\n") == 1
    monkeypatch.setenv("TILTCAL_TRACEBACK", "1")
    with pytest.raises(RuntimeError, match="lost"):
        main(["methods"])


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    "words",
    [["--help"], ["methods"], ["effects"], ["effects", "--json"], ["simulate", "bench.toml"]],
)
def test_a_reader_that_has_gone_ends_a_command_in_silence(words):
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        [sys.executable, "-m", "tiltcal", *words], stdout=write, stderr=subprocess.PIPE, check=False
    )
    os.close(write)
    assert (done.returncode, done.stderr) == (0, b"")


def test_without_a_simulator_the_message_says_what_to_install(here, monkeypatch, capsys):
    monkeypatch.setattr("tiltcal.api.simulating.entry_points", lambda **_: ())
    assert "need the package tiltsim" in refusal(
        ["simulate", "bench.toml", "-o", "run.csv"], here, capsys
    )
