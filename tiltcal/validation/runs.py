"""One run: a scenario with one seed, recorded, calibrated and compared with the truth."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from typing import Protocol

from tiltcal.calibration.methods.registry import calibrate, run_command
from tiltcal.calibration.result import Calibration
from tiltcal.core.errors import TiltcalError
from tiltcal.core.tasks.engines import Engine, shared_engine
from tiltcal.core.tasks.outcome import Limits
from tiltcal.core.tasks.run_tasks import Task, outcomes
from tiltcal.laboratory.laboratory import Laboratory
from tiltcal.laboratory.reference_errors import with_reference_errors
from tiltcal.laboratory.scenario import Scenario, fresh
from tiltcal.laboratory.scenario_tables import MethodTable
from tiltcal.recordings.recording import Recording
from tiltcal.validation.accuracy import (
    TiltError,
    attitude_error,
    normalised_error,
    tilt_error,
    true_parameters,
)

UNTESTED = "untested"


@dataclass(frozen=True)
class ParameterRow:
    """A recovered parameter of one run, in ``unit``; truth None where nothing injected defines
    one.
    """

    name: str
    unit: str
    value: float
    sigma: float
    truth: float | None


@dataclass(frozen=True)
class Row:
    """What one method made of one recording. Plain values only: a row is what files and workers
    exchange, and all that acceptance is judged by.

    Args:
        scenario, method: their names.
        seed: of the recording.
        verdict: the method's own; empty when it failed.
        tests: how many it made of its own.
        parameters: recovered.
        nees: squared error of the parameters with a truth in units of the covariance.
        nees_dof: their number; 0 where there is none, or where a sigma is zero.
        tilt_before, tilt_after, tilt_bound: rad rms; None where not defined.
        tilt_dof: of after^2.
        seconds: the method's own time.
        error: what went wrong, when it failed.
    """

    scenario: str
    method: str
    seed: int
    verdict: str = ""
    tests: int = 0
    parameters: tuple[ParameterRow, ...] = ()
    nees: float = 0.0
    nees_dof: int = 0
    tilt_before: float | None = None
    tilt_after: float | None = None
    tilt_bound: float | None = None
    tilt_dof: float = 1.0
    seconds: float = 0.0
    error: str | None = None

    @property
    def shown_verdict(self) -> str:
        """The verdict; a ``good`` that no test of the method's own stands behind is
        ``untested``.
        """
        if self.error is not None:
            return "error"
        return UNTESTED if self.verdict == "good" and self.tests == 0 else self.verdict


@dataclass(frozen=True)
class Run:
    """A row with what it was made from.

    Args:
        tilt: tilt error, with the description of its directions.
    """

    row: Row
    calibration: Calibration | None = None
    tilt: TiltError | None = None


@dataclass(frozen=True)
class SeedResult:
    """All methods on the recording of one seed; ``recording`` only where it was asked for."""

    seed: int
    runs: tuple[Run | None, ...]
    recording: Recording | None = None


@dataclass(frozen=True)
class Workers:
    """Other processes that make runs.

    Args:
        engine: what the runs are spread over.
        limits: of one run.
        make_laboratory: called once in each process; a function at the top of a module.
    """

    engine: Engine
    make_laboratory: Callable[[], Laboratory]
    limits: Limits


@contextmanager
def worker_processes(
    jobs: int, make_laboratory: Callable[[], Laboratory], engine: str = "processes"
) -> Iterator[Workers | None]:
    """An engine for runs; None, this process, for one job without another engine.

    Raises:
        TiltcalError: jobs is less than 1, or there is no such engine.
    """
    with shared_engine(engine, jobs) as opened:
        yield None if opened is None else Workers(opened, make_laboratory, Limits())


class Keeper(Protocol):
    """Whoever keeps runs that are made."""

    def result(self, scenario: Scenario, k: int) -> SeedResult | None:
        """Run k of a scenario, without its recording; None where it is not kept."""

    def keep(self, scenario: Scenario, k: int, result: SeedResult) -> None:
        """Keep run k of a scenario."""


def results_by_seed(
    scenario: Scenario,
    laboratory: Laboratory,
    workers: Workers | None = None,
    kept: Keeper | None = None,
) -> Iterator[SeedResult]:
    """The runs of a scenario, in the order of their seeds: ``seed``, ``seed + 1``, ...

    The result is the same in this process and in any number of workers. The first one carries its
    recording.

    Raises:
        TiltcalError: the scenario cannot be recorded, or a run lost its process.
    """
    count = max((m.runs for m in scenario.method), default=1)
    if workers is None or count == 1:
        for k in range(count):
            yield _kept_result(scenario, laboratory, k, kept) or _made(
                scenario, laboratory, k, kept
            )
        return
    bare = fresh(scenario)
    early = {
        k: result
        for k in range(count)
        if (result := _kept_result(scenario, laboratory, k, kept)) is not None
    }
    missing = [k for k in range(count) if k not in early]
    tasks = [Task(f"{k}", _run_apart, (workers.make_laboratory, bare, k)) for k in missing]
    following = 0
    while following in early:
        yield early.pop(following)
        following += 1
    for task, outcome in outcomes(tasks, workers.engine, workers.limits):
        k = int(task.key)
        outcome.require(f"scenario {scenario.name}, run {k + 1}", workers.limits)
        early[k] = outcome.value
        if kept is not None:
            kept.keep(scenario, k, outcome.value)
        while following in early:
            yield early.pop(following)
            following += 1


def _made(scenario: Scenario, laboratory: Laboratory, k: int, kept: Keeper | None) -> SeedResult:
    """Run k, kept as soon as it is made."""
    result = run_seed(scenario, laboratory, k)
    if kept is not None:
        kept.keep(scenario, k, result)
    return result


def _kept_result(
    scenario: Scenario, laboratory: Laboratory, k: int, kept: Keeper | None
) -> SeedResult | None:
    """Run k as it was kept; the first one with its recording, which is made again."""
    result = None if kept is None else kept.result(scenario, k)
    if result is None or k > 0:
        return result
    return replace(result, recording=_recorded(scenario, laboratory, result.seed))


def _recorded(scenario: Scenario, laboratory: Laboratory, seed: int) -> Recording:
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, user_api="blas"):
        return laboratory.record(with_reference_errors(scenario, seed), seed)


def _run_apart(make_laboratory: Callable[[], Laboratory], scenario: Scenario, k: int) -> SeedResult:
    return run_seed(scenario, laboratory_of(make_laboratory), k)


@cache
def laboratory_of(make: Callable[[], Laboratory]) -> Laboratory:
    """The laboratory of this process; ``make`` is called once."""
    return make()


def run_seed(scenario: Scenario, laboratory: Laboratory, k: int) -> SeedResult:
    """Record run k, from 0, and hand the recording to each method that has more than k runs.

    Raises:
        TiltcalError: the scenario cannot be recorded.
    """
    from threadpoolctl import threadpool_limits

    seed = scenario.seed + k
    with threadpool_limits(1, user_api="blas"):  # sums in the same order everywhere
        recording = laboratory.record(with_reference_errors(scenario, seed), seed)
        runs = tuple(
            run_method(scenario, m, recording, seed) if k < m.runs else None
            for m in scenario.method
        )
    return SeedResult(seed, runs, recording if k == 0 else None)


def run_method(scenario: Scenario, table: MethodTable, recording: Recording, seed: int) -> Run:
    """Calibrate from a recording and compare with the truth. What goes wrong in the method is in
    the row.
    """
    start = time.perf_counter()
    try:
        found = _calibrate(scenario, table, recording)
        seconds = time.perf_counter() - start
        truth = true_parameters(scenario, scenario.effects, found)
        tilt = _error_of(found, scenario)
    except TiltcalError as error:
        seconds = time.perf_counter() - start
        row = Row(scenario.name, table.title, seed, seconds=seconds, error=str(error))
        return Run(row)
    nees, dof = normalised_error(found, truth)
    parameters = tuple(
        ParameterRow(name, e.unit, float(e.value), float(e.sigma), truth.get(name))
        for name, e in found.parameters.items()
    )
    row = Row(
        scenario.name,
        table.title,
        seed,
        found.verdict,
        len(found.tests),
        parameters,
        nees,
        dof,
        seconds=seconds,
    )
    if tilt is not None:
        row = replace(
            row,
            tilt_before=tilt.before,
            tilt_after=tilt.after,
            tilt_bound=tilt.bound,
            tilt_dof=tilt.dof,
        )
    return Run(row, found, tilt)


def _calibrate(scenario: Scenario, table: MethodTable, recording: Recording) -> Calibration:
    if table.command is not None:
        return run_command(table.command, recording, scenario)
    return calibrate(str(table.name), recording, scenario, **table.options)


def _error_of(found: Calibration, scenario: Scenario) -> TiltError | None:
    """Tilt error of what senses gravity, attitude error of a gyro triad; None where nothing was
    determined.
    """
    if "base.roll" in found.parameters:
        return tilt_error(scenario, scenario.effects, found)
    if found.verdict == "cannot_tell" or not found.sensors():
        return None
    sensor = scenario.named(found.sensors()[0])
    if sensor.kind == "gyro" and len(sensor.axes) == 3:
        return attitude_error(scenario, scenario.effects, found)
    return tilt_error(scenario, scenario.effects, found) if sensor.is_accelerometer else None
