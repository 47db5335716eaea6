"""SIGINT and SIGTERM at any moment: 130 and 143, one line, nothing partial; a second run into the
folder is refused, and `verify` goes on where it was stopped.
"""

import shutil
import signal
import subprocess
import sys
import time

import pytest
from scenario_files import BENCH_SCENARIO, refusal

from tiltcal.cli import main, methods
from tiltcal.cli.signals import Terminated, unwinding
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import TEMPORARY, claimed
from tiltcal.core.tasks.journal import open_journal
from tiltcal.validation import runs
from tiltcal.validation.kept_runs import NAME

PYTHON = [sys.executable, "-m", "tiltcal"]
STATUS = {signal.SIGINT: 130, signal.SIGTERM: 143}
LONG = BENCH_SCENARIO.replace("dwell_s = 3\n", "dwell_s = 1000000\n", 1)  # a minute of writing
MANY = BENCH_SCENARIO.replace('name = "six_position"', 'name = "six_position"\nruns = 4')


@pytest.fixture(autouse=True)
def heard():
    """A shell's job in the background does not hear Ctrl-C, nor does what it starts."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("number", list(STATUS))
@pytest.mark.parametrize("delay", [0.0, 0.8])
def test_a_signal_while_a_recording_is_written_leaves_nothing(number, delay, here):
    (here / "long.toml").write_text(LONG)
    words = [*PYTHON, "simulate", "long.toml", "-o", "run.csv", "--truth", "truth.json"]
    process = subprocess.Popen(words, stderr=subprocess.PIPE, text=True)
    while not list(here.glob(f"{TEMPORARY}*")):  # the work has begun
        time.sleep(0.01)
        assert process.poll() is None
    time.sleep(delay)
    process.send_signal(number)
    said = process.communicate()[1].splitlines()
    assert process.returncode == STATUS[number]
    assert sum(line.startswith("tiltcal: ") for line in said) == 1
    assert [p.name for p in here.iterdir()] == ["long.toml"]


def raising(error):
    def run(*_):
        raise error

    return run


@pytest.mark.parametrize(
    ("error", "status"), [(KeyboardInterrupt(), 130), (ImportError("half"), 143)]
)
def test_what_a_signal_has_become_on_its_way_is_still_an_interrupt(
    error, status, monkeypatch, capsys
):
    """A signal in the middle of an import comes out as an error of the import."""

    def run(*_):
        if status == 143:
            with pytest.raises(Terminated):
                signal.raise_signal(signal.SIGTERM)
        raise error

    monkeypatch.setattr(methods, "methods", run)
    assert main(["methods"]) == status
    assert capsys.readouterr().err.endswith("no partial output is left\n")


class Falling:
    """Its destructor is interrupted."""

    def __del__(self):
        signal.raise_signal(signal.SIGINT)


def test_a_signal_that_falls_into_a_destructor_is_not_lost():
    def drop():
        with unwinding():
            thing = Falling()
            del thing
            time.sleep(1)

    with pytest.raises(KeyboardInterrupt):
        drop()


def test_handlers_are_as_before_afterwards():
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    assert main(["methods"]) == 0
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before


@pytest.mark.parametrize("command", ["run", "verify"])
def test_a_second_run_into_a_folder_is_refused_and_changes_nothing(command, here, capsys):
    (here / "s.toml").write_text(BENCH_SCENARIO)
    with claimed(here / "out"):
        assert "another run that writes into it" in refusal(
            [command, "s.toml", "-o", "out"], here, capsys
        )
    assert main([command, "s.toml", "-o", "out"]) == 0


@pytest.mark.parametrize("command", ["diagnose", "investigate"])
def test_nor_do_two_diagnoses_mix(command, good, here, capsys):
    words = [command, good / "run.csv", "--scenario", good / "bench.toml", "-o", "out"]
    words += ["--lab", "true"] if command == "investigate" else []
    with claimed(here / "out"):
        assert "another run" in refusal(words, here, capsys)


def test_a_folder_is_free_again_after_an_error_and_goes_when_it_is_empty(here):
    with pytest.raises(ValueError), claimed(here / "a" / "b"):
        raise ValueError
    assert list(here.iterdir()) == []
    (here / "out").mkdir()
    with claimed(here / "out"), pytest.raises(TiltcalError), claimed(here / "out"):
        pytest.fail("held twice")
    with claimed(here / "out"):
        pass
    assert (here / "out").exists()


def test_verify_goes_on_where_it_was_stopped(here, monkeypatch):
    (here / "s.toml").write_text(MANY)
    assert main(["verify", "s.toml", "-o", "whole"]) == 0
    made, run_seed = [], runs.run_seed

    def stopping(scenario, laboratory, k):
        if len(made) == 2:
            raise KeyboardInterrupt
        made.append(k)
        return run_seed(scenario, laboratory, k)

    monkeypatch.setattr(runs, "run_seed", stopping)
    assert main(["verify", "s.toml", "-o", "out"]) == 130
    assert [p.name for p in (here / "out").iterdir()] == [NAME]

    monkeypatch.setattr(runs, "run_seed", lambda *words: made.append(words[2]) or run_seed(*words))
    copied = shutil.copytree(here / "out", here / "again")
    assert main(["verify", "s.toml", "-o", "out"]) == 0
    assert made == [0, 1, 2, 3]
    assert not (here / "out" / NAME).exists()
    assert main(["verify", "s.toml", "-o", "again", "-j", "2"]) == 0
    assert numbers(copied) == numbers(here / "whole")
    assert numbers(here / "out") == numbers(here / "whole")


def numbers(folder):
    """The table of runs without the times."""
    import pyarrow.parquet as pq

    return pq.read_table(folder / "runs.parquet").drop_columns(["seconds"]).to_pylist()


def test_runs_of_another_scenario_are_not_taken(here, monkeypatch):
    made, run_seed = [], runs.run_seed

    def stopping(scenario, laboratory, k):
        if k == 2:
            raise KeyboardInterrupt
        made.append(k)
        return run_seed(scenario, laboratory, k)

    monkeypatch.setattr(runs, "run_seed", stopping)
    for text in (MANY, MANY.replace("bias_x_ug = 3000", "bias_x_ug = 2000")):
        (here / "s.toml").write_text(text)
        assert main(["verify", "s.toml", "-o", "out"]) == 130
    assert made == [0, 1, 0, 1]


@pytest.mark.parametrize("content", [b"", b"nothing", b"SQLite format 3\x00" + bytes(200)])
def test_a_damaged_journal_is_refused_in_words(content, here, capsys):
    (here / "s.toml").write_text(MANY)
    (here / "out").mkdir()
    (here / "out" / NAME).write_bytes(content)
    status = main(["verify", "s.toml", "-o", "out"])
    assert status == (2 if content else 0)
    assert ("need a journal" in capsys.readouterr().err) == bool(content)


def test_a_damaged_run_in_a_journal_is_refused_in_words(here, monkeypatch, capsys):
    (here / "s.toml").write_text(MANY)
    monkeypatch.setattr("tiltcal.validation.kept_runs._key", lambda *_: "key")
    for record in ("{", "{}", '{"seed": 1, "runs": [{"row": {}, "calibration": null, "tilt": 1}]}'):
        shutil.rmtree(here / "out", ignore_errors=True)
        (here / "out").mkdir()
        with open_journal(here / "out" / NAME) as journal:
            journal.record("key", record)
        assert main(["verify", "s.toml", "-o", "out"]) == 2
        assert "need the runs of `tiltcal verify`" in capsys.readouterr().err
