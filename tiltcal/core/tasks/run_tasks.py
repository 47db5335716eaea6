"""Making many tasks: those that a journal has are skipped, each other one is in it as soon as it is
finished.
"""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from itertools import islice
from threading import Thread
from typing import Any

from tiltcal.core.errors import TiltcalError
from tiltcal.core.progress import Part, Progress, Rate, silent, unmeasured
from tiltcal.core.tasks.disposable import call_apart
from tiltcal.core.tasks.engines import Engine
from tiltcal.core.tasks.journal import Journal
from tiltcal.core.tasks.outcome import Limits, Outcome

WAITING = 8  # waiting tasks for each one that runs: a remote engine is never idle
CHECK_S = 2.0  # between looks whether the engine still answers


@dataclass(frozen=True)
class Task:
    """A call that is made in another process.

    Args:
        key: of its content; equal keys mean equal results.
        function: at the top of a module.
        arguments: plain values.
    """

    key: str
    function: Callable[..., Any]
    arguments: tuple[Any, ...]


def outcomes(
    tasks: Iterable[Task], engine: Engine, limits: Limits
) -> Iterator[tuple[Task, Outcome]]:
    """Each task with what became of it, in the order in which they end.

    Raises:
        TiltcalError: the engine lost tasks, after all others are through.
    """
    queue, lost = iter(tasks), 0
    pending: dict[Future[Outcome], Task] = {}
    while True:
        for task in islice(queue, (1 + WAITING) * engine.slots - len(pending)):
            call = (task.function, task.arguments, limits)
            pending[engine.executor.submit(call_apart, *call)] = task
        if not pending:
            break
        done, _ = wait(pending, timeout=CHECK_S, return_when=FIRST_COMPLETED)
        for future in done:
            task = pending.pop(future)
            if future.cancelled() or future.exception() is not None:
                lost += 1
            else:
                yield task, future.result()
        if not engine.alive():
            lost += len(pending)
            break
    if lost:
        raise TiltcalError(
            "engine",
            found=f"{lost} tasks lost with its workers or its scheduler",
            need="an engine that stays until all tasks are made",
            do="run the same command again: what is finished is not made again",
        )


def values_of(
    function: Callable[..., Any],
    calls: Iterable[tuple[Any, ...]],
    engine: Engine | None,
    part: Part = unmeasured,
) -> list[Any]:
    """What a function returns for each of some arguments, in order; without an engine in this
    process.

    Args:
        function: at the top of a module.
        calls: its arguments.
        engine: where it is called; this process if not given.
        part: callback, called with the share of the calls that has returned.

    Raises:
        TiltcalError: what the function raised first, or a call lost its process.
    """
    limits = Limits()
    tasks = [Task(f"{k}", function, arguments) for k, arguments in enumerate(calls)]
    if engine is None:
        values = []
        for task in tasks:
            values.append(function(*task.arguments))
            part(len(values) / len(tasks))
        return values
    found: dict[int, Outcome] = {}
    for task, outcome in outcomes(tasks, engine, limits):
        found[int(task.key)] = outcome
        part(len(found) / len(tasks))
    for k in range(len(tasks)):
        found[k].require(f"call {k + 1} of {len(tasks)}", limits)
    return [found[k].value for k in range(len(tasks))]


def values_as_made(
    function: Callable[..., Any],
    calls: Iterable[tuple[Any, ...]],
    engine: Engine,
    limits: Limits | None = None,
) -> Iterator[Any]:
    """What a function returns for each of some arguments, in the order in which the calls end.

    Args:
        function: at the top of a module.
        calls: its arguments.
        engine: where it is called.
        limits: of time and memory of one call.

    Raises:
        TiltcalError: a call raised or lost its process, or the engine lost it; after all others
            are through.
    """
    limits = limits or Limits()
    failures = []
    tasks = (Task(f"{k + 1}", function, arguments) for k, arguments in enumerate(calls))
    for task, outcome in outcomes(tasks, engine, limits):
        if (failure := outcome.failure(limits)) is None:
            yield outcome.value
        else:
            failures.append(f"call {task.key}: {failure}")
    if failures:
        raise TiltcalError(
            "engine",
            found=f"{len(failures)} calls without a result; first, {failures[0]}",
            need="an answer from each",
            do="run the same command again: what is finished is not made again",
        )


def make_all(
    tasks: Iterable[Task],
    total: int,
    journal: Journal,
    engine: Engine,
    limits: Limits,
    recorded: Callable[[Task, Outcome], str],
    progress: Progress = silent,
    meanwhile: Callable[[], None] | None = None,
) -> int:
    """Make all tasks that the journal does not have; how many these were.

    Args:
        tasks: all of them, also those that the journal has.
        journal: of what is finished.
        engine: where they are made.
        limits: of time and memory of each.
        progress: receives the rate and the time left.
        total: how many there are, with those that it has.
        recorded: the record of an outcome, as it goes into the journal.
        meanwhile: called in another thread when the first task is handed out.

    Raises:
        TiltcalError: the engine lost tasks, or there is no disk space for the journal.
    """
    rate = Rate(total)
    had = 0
    began = list[Thread]()

    def missing() -> Iterator[Task]:
        nonlocal had
        for task in tasks:
            if task.key in journal:
                had += 1
                continue
            if not began:
                began.append(Thread(target=meanwhile, daemon=True))
                began[0].start()
            yield task

    for task, outcome in outcomes(missing(), engine, limits):
        journal.record(task.key, recorded(task, outcome))
        progress(rate.after_one(had))
    return rate.made
