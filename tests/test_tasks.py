"""Tasks in processes that they may hang, fill or end; and the journal of what is finished."""

import operator
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import Future, ThreadPoolExecutor

import pytest

from tiltcal.core.errors import TiltcalError
from tiltcal.core.progress import Rate
from tiltcal.core.tasks.disposable import DisposableProcess, call_apart, close_all
from tiltcal.core.tasks.engines import Engine, open_engine
from tiltcal.core.tasks.journal import open_journal
from tiltcal.core.tasks.outcome import Limits
from tiltcal.core.tasks.run_tasks import Task, make_all, outcomes, values_of

USUAL = Limits(30.0, 600)
NO_NEGATIVE = "TypeError: bad operand type for unary -: 'Limits'"


@pytest.fixture
def process():
    one = DisposableProcess()
    yield one
    one.close()


@pytest.fixture
def engine():
    with open_engine("processes", 2) as opened:
        yield opened


def test_a_call_returns_raises_or_loses_its_process_and_the_next_is_made_all_the_same(process):
    cases = [
        (operator.truediv, (6, 2), USUAL, (3.0, None, None)),
        (operator.truediv, (6, 0), USUAL, (None, "ZeroDivisionError: division by zero", None)),
        (time.sleep, (60,), Limits(0.3, 600), (None, None, "time")),
        (bytearray, (2 << 30,), USUAL, (None, None, "memory")),
        (os._exit, (3,), USUAL, (None, "its process ended by exit status 3", "ended")),
        (signal.raise_signal, (9,), USUAL, (None, "its process ended by signal SIGKILL", "ended")),
        (operator.neg, (USUAL,), USUAL, (None, NO_NEGATIVE, None)),
        (operator.add, (2, 2), USUAL, (4, None, None)),
    ]
    for function, arguments, limits, (value, error, fault) in cases:
        found = process.call(function, arguments, limits)
        assert (found.value, found.error, found.fault) == (value, error, fault), function
    assert found.seconds < 1.0


def test_arguments_that_cannot_go_to_another_process_are_said(process):
    found = process.call(operator.neg, (lambda: 1,), USUAL)
    assert "Can't pickle" in found.error
    assert process.call(operator.neg, (1,), USUAL).value == -1


def test_one_process_serves_many_calls_and_the_limit_is_of_each(process):
    first = process.call(os.getpid, (), Limits(0.6, 600))
    for _ in range(4):
        assert process.call(time.sleep, (0.2,), Limits(0.6, 600)).fault is None
    assert process.call(os.getpid, (), USUAL).value == first.value != os.getpid()


def test_what_a_task_prints_and_leaves_running_does_no_harm(process, tmp_path):
    script = "print('to stdout', flush=True)"
    assert process.call(os.system, (f'{sys.executable} -c "{script}"',), USUAL).value == 0
    assert process.call(print, ("words",), USUAL).fault is None
    mark = tmp_path / "alive"
    late = f"sleep 1.5; touch {mark}"
    # a hanging task goes with what it started
    assert process.call(os.system, (late,), Limits(0.3, 600)).fault == "time"
    time.sleep(1.8)
    assert not mark.exists()


def test_a_call_that_was_ended_from_outside_is_made_once_more(tmp_path):
    mark = tmp_path / "mark"
    # the first attempt leaves a mark and ends, the second finds it
    ends_once = f"test -e {mark} || (touch {mark}; kill -9 $PPID)"
    try:
        assert call_apart(os.system, (ends_once,), USUAL).value == 0
    finally:
        close_all()


def test_an_error_of_ours_arrives_as_itself(process):
    found = process.call(Limits, (-1.0, 5), USUAL)
    assert isinstance(found.refusal, TiltcalError)
    assert str(found.refusal) == found.error
    assert "need both above 0" in found.error


def test_an_engine_makes_all_tasks_and_poison_stays_with_its_own(engine):
    tasks = [Task(f"{k}", operator.mul, (k, k)) for k in range(30)]
    tasks[4] = Task("4", os._exit, (1,))
    tasks[7] = Task("7", time.sleep, (60,))
    found = {t.key: o for t, o in outcomes(tasks, engine, Limits(1.0, 600))}
    assert found.pop("4").fault == "ended"
    assert found.pop("7").fault == "time"
    assert {k: o.value for k, o in found.items()} == {
        f"{k}": k * k for k in range(30) if k not in (4, 7)
    }


def test_tasks_that_an_engine_loses_are_counted_after_the_others_are_through():
    class Forgetful(ThreadPoolExecutor):
        """Loses every third task."""

        count = 0

        def submit(self, *call):
            self.count += 1
            if self.count % 3:
                return super().submit(*call)
            lost: Future = Future()
            lost.cancel()
            lost.set_running_or_notify_cancel()
            return lost

    tasks = [Task(f"{k}", operator.add, (k, 1)) for k in range(9)]
    made = []
    with Forgetful(1) as executor:
        results = outcomes(tasks, Engine(executor, 1), USUAL)
        made.extend(next(results)[0].key for _ in range(6))
        with pytest.raises(TiltcalError, match="found 3 tasks lost"):
            next(results)
        close_all()
    assert sorted(made) == ["0", "1", "3", "4", "6", "7"]


def test_an_engine_that_is_gone_ends_the_work():
    class Gone(ThreadPoolExecutor):
        def submit(self, *call):
            return Future()  # never answers

    with (
        Gone(1) as executor,
        pytest.raises(TiltcalError, match="found 5 tasks lost"),
    ):
        list(
            outcomes(
                [Task(f"{k}", operator.neg, (k,)) for k in range(5)],
                Engine(executor, 1, alive=lambda: False),
                USUAL,
            )
        )


@pytest.mark.parametrize(
    ("name", "jobs", "words"),
    [
        ("processes", 0, "option -j: found 0"),
        ("spark", 1, "option --engine: found spark"),
        ("dask://127.0.0.1:1", 1, "found no Dask scheduler at tcp://127.0.0.1:1"),
    ],
)
def test_an_engine_that_cannot_be_is_one_message(name, jobs, words, monkeypatch):
    monkeypatch.setattr("tiltcal.core.tasks.engines.CONNECTING_S", 1)
    with pytest.raises(TiltcalError) as refused, open_engine(name, jobs):
        pass
    assert words in str(refused.value)


def test_values_are_in_the_order_of_the_calls_and_an_error_is_raised(engine):
    calls = [(k, 3) for k in range(7)]
    assert values_of(operator.mul, calls, engine) == values_of(operator.mul, calls, None)
    with pytest.raises(TiltcalError, match="call 2 of 3: found no result: ZeroDivisionError"):
        values_of(operator.truediv, [(1, 1), (1, 0), (2, 0)], engine)
    with pytest.raises(TiltcalError, match="need both above 0"):
        values_of(Limits, [(1.0, 5), (-1.0, 5)], engine)


def test_a_journal_has_what_was_recorded_and_makes_nothing_twice(tmp_path, engine):
    path = tmp_path / "x.journal"
    tasks = [Task(f"{k}", operator.mul, (k, 2)) for k in range(6)]
    said = []

    def record(task, outcome):
        return f"{task.key}: {outcome.value}"

    with open_journal(path) as journal:
        made = make_all(tasks[:4], 6, journal, engine, USUAL, record, said.append)
        assert made == len(said) == 4
    with open_journal(path) as journal:
        assert make_all(tasks, 6, journal, engine, USUAL, record, said.append) == 2
        assert [journal.record_of(f"{k}") for k in range(6)] == [f"{k}: {2 * k}" for k in range(6)]
        assert journal.record_of("6") is None
        assert said[-1].startswith("6 of 6 runs, ")
        journal.forget("3")
        assert make_all(tasks, 6, journal, engine, USUAL, record) == 1


def test_a_journal_takes_one_writer_and_no_other_file(tmp_path):
    with (
        open_journal(tmp_path / "one"),
        pytest.raises(TiltcalError, match="database is locked"),
        open_journal(tmp_path / "one"),
    ):
        pass
    (tmp_path / "text").write_text("no database, but a text of some length\n" * 40)
    with (
        pytest.raises(TiltcalError, match="file is not a database"),
        open_journal(tmp_path / "text"),
    ):
        pass
    with pytest.raises(TiltcalError, match="unable to open"), open_journal(tmp_path / "no" / "one"):
        pass


FILLS = """
import resource, sys
from pathlib import Path
from tiltcal.core.errors import TiltcalError
from tiltcal.core.tasks.journal import open_journal
with open_journal(Path(sys.argv[1])) as journal:
    resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))
    for k in range(1000):
        try:
            journal.record(f"{k}", "x" * 2000)
        except TiltcalError as error:
            print(k, error)
            break
"""


def test_no_room_is_one_message_and_what_was_recorded_stays(tmp_path):
    """The operating system refuses to let the files grow."""
    path = tmp_path / "x.journal"
    said = subprocess.run(
        [sys.executable, "-c", FILLS, str(path)], capture_output=True, text=True, check=True
    ).stdout
    count = int(said.split()[0])
    assert "free some space and run the same command again" in said
    assert 5 < count < 400
    with open_journal(path) as journal:
        assert len(journal) == count
        assert all(journal.record_of(f"{k}") == "x" * 2000 for k in range(count))
        journal.record("next", "there is room again")


def test_the_rate_is_of_the_tasks_that_were_made(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    rate = Rate(1000)
    now[0] += 2.0
    assert rate.after_one(399) == "400 of 1000 runs, 0.5 a second, 20 min left"
    now[0] += 8.0
    rate.after_one(399)
    assert rate.after_one(979) == "982 of 1000 runs, 0.3 a second, 60 s left"
    assert rate.after(123_456).startswith("123456 of 1000 runs, 12300 a second")
