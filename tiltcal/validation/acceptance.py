"""Running scenarios: record, calibrate, judge against the acceptance limits; one or a folder of
them.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tiltcal.calibration.result import Calibration
from tiltcal.core.budget import require_within
from tiltcal.core.errors import TiltcalError
from tiltcal.core.progress import Progress, Rate, silent
from tiltcal.laboratory.laboratory import Laboratory
from tiltcal.laboratory.scenario import Scenario, load_scenario
from tiltcal.laboratory.scenario_tables import EstimatorTable, MethodTable
from tiltcal.recordings.recording import Recording
from tiltcal.validation.accuracy import TiltError
from tiltcal.validation.limits import Limit, dof_of_mean, limits_of, tilts
from tiltcal.validation.online.judging import OnlineResult, run_estimator
from tiltcal.validation.runs import Keeper, Row, Run, Workers, results_by_seed
from tiltcal.validation.uncertainty_budget import UncertaintyBudget, budget_of

RUN_BYTES = 20_000  # of memory for a run and its calibration, measured
RUN_S = 0.02  # of a short run


@dataclass(frozen=True)
class MethodResult:
    """One method on one scenario.

    Args:
        title: of the method.
        runs: one a seed.
        limits: judged over all runs.
        seconds: all runs.
        error: what went wrong, when it did not even calibrate; of the first such run.
        online: of an estimator that was fed sample by sample.
        budget: of the first run, where the scenario names sources of uncertainty.
    """

    title: str
    runs: tuple[Run, ...] = ()
    limits: tuple[Limit, ...] = ()
    seconds: float = 0.0
    error: str | None = None
    online: OnlineResult | None = None
    budget: UncertaintyBudget | None = None

    @property
    def accepted(self) -> bool:
        """Whether every limit is met."""
        return self.error is None and all(limit.passed for limit in self.limits)

    @property
    def rows(self) -> list[Row]:
        """The plain record of each run."""
        return [run.row for run in self.runs]

    @property
    def calibrations(self) -> tuple[Calibration, ...]:
        """Of the runs that did not fail."""
        return tuple(run.calibration for run in self.runs if run.calibration is not None)

    @property
    def truth(self) -> dict[str, float]:
        """Injected value of each parameter of the first run that has one."""
        found = self.rows[0].parameters if self.runs else ()
        return {p.name: p.truth for p in found if p.truth is not None}

    @property
    def tilt(self) -> TiltError | None:
        """Tilt error before and after, and as predicted: rms over runs, with the degrees of freedom
        of that mean.
        """
        known = [run.tilt for run in self.runs if run.tilt is not None]
        if not known:
            return None
        before, after, bound = np.sqrt(np.mean(tilts(self.rows) ** 2, axis=0)).tolist()
        dof = dof_of_mean(np.array([t.bound for t in known]), np.array([t.dof for t in known]))
        return TiltError(before, after, bound, known[0].over, dof)

    @property
    def verdict(self) -> str:
        """The verdicts of all runs, as text; those of one run and of runs that agree without a
        number.
        """
        shown = [row.shown_verdict for row in self.rows]
        different = list(dict.fromkeys(shown))
        if len(different) < 2:
            return different[0] if different else "error" if self.error else "on line"
        return ", ".join(f"{v} x{shown.count(v)}" for v in different)


@dataclass(frozen=True)
class ScenarioResult:
    """All methods on one scenario; ``recording`` is the first run's."""

    scenario: Scenario
    source: str
    methods: tuple[MethodResult, ...]
    recording: Recording | None = None
    error: str | None = None

    @property
    def accepted(self) -> bool:
        """Whether every method was accepted."""
        return self.error is None and all(m.accepted for m in self.methods)


def run_scenario(
    scenario: Scenario,
    laboratory: Laboratory,
    *,
    source: str = "",
    allow_commands: bool = False,
    progress: Progress = silent,
    workers: Workers | None = None,
    kept: Keeper | None = None,
) -> ScenarioResult:
    """Simulate, calibrate, judge.

    Args:
        scenario: that is run.
        source: its file, for messages.
        allow_commands: whether it may run programs as methods.
        progress: receives the rate and the time left.
        laboratory: of this process.
        workers: other processes, which make the same runs.
        kept: runs that were made before, and takes those that are made.

    Raises:
        TiltcalError: the scenario has no method, or a command that is not allowed.
    """
    _require_runnable(scenario, source, allow_commands)
    runs = max((m.runs for m in scenario.method), default=1)
    seeds = []
    require_within(
        f"scenario {source or scenario.name}, {runs} runs",
        size=RUN_BYTES * runs,
        seconds=RUN_S * runs,
        less="ask for fewer runs, or use `tiltcal campaign`, which keeps them on disk",
    )
    rate = Rate(runs)
    for result in results_by_seed(scenario, laboratory, workers, kept):
        seeds.append(result)
        progress(f"{scenario.name}: {rate.after_one(0)}")
    recording = seeds[0].recording
    assert recording is not None
    results = []
    for k, m in enumerate(scenario.method):
        of_method = [run for s in seeds if (run := s.runs[k]) is not None]
        results.append(_judged(scenario, m, of_method))
    for e in scenario.estimator:
        progress(f"{scenario.name}: {e.title}, sample by sample")
        results.append(_run_estimator(scenario, e, recording, laboratory))
    return ScenarioResult(scenario, source, tuple(results), recording)


def _require_runnable(scenario: Scenario, source: str, allow_commands: bool) -> None:
    """Refuse a scenario without methods, or with a command that is not allowed."""
    if not scenario.method and not scenario.estimator:
        raise TiltcalError(
            f"scenario {source or scenario.name}",
            found="no [[method]]",
            need="at least one to judge",
            do="add [[method]] name = 'six_position'",
        )
    for command in [m.command for m in scenario.method] + [e.command for e in scenario.estimator]:
        if command and not allow_commands:
            raise TiltcalError(
                f"scenario {source or scenario.name}",
                found=f"the command {command[0]}",
                need="permission to run programs",
                do="read it, then add --allow-commands",
            )


def _judged(scenario: Scenario, table: MethodTable, runs: Sequence[Run]) -> MethodResult:
    """A method over its runs."""
    seconds = sum(run.row.seconds for run in runs)
    failed = [run.row for run in runs if run.row.error is not None]
    if failed:
        first, where = failed[0], f"{len(failed)} of {len(runs)} runs, first seed {failed[0].seed}"
        text = first.error if len(runs) == 1 else f"{first.error} ({where})"
        return MethodResult(table.title, tuple(runs), seconds=seconds, error=text)
    found = runs[0].calibration
    budget = budget_of(found) if found is not None and found.references else None
    limits = tuple(limits_of(scenario, table, [run.row for run in runs]))
    return MethodResult(table.title, tuple(runs), limits, seconds, budget=budget)


def _run_estimator(
    scenario: Scenario, table: EstimatorTable, recording: Recording, laboratory: Laboratory
) -> MethodResult:
    start = time.perf_counter()
    try:
        found = run_estimator(scenario, table, recording, laboratory)
    except TiltcalError as error:
        return MethodResult(table.title, seconds=time.perf_counter() - start, error=str(error))
    limits = tuple(Limit(*limit) for limit in found.limits(table.accept))
    seconds = time.perf_counter() - start
    return MethodResult(table.title, limits=limits, seconds=seconds, online=found)


@dataclass(frozen=True)
class Verification:
    """A folder of scenarios, run."""

    results: tuple[ScenarioResult, ...]
    seconds: float
    interrupted: bool = field(default=False)

    @property
    def accepted(self) -> bool:
        """Whether every scenario was accepted."""
        return all(r.accepted for r in self.results)


def verify_folder(
    folder: Path,
    laboratory: Laboratory,
    *,
    allow_commands: bool = False,
    progress: Progress = silent,
    workers: Workers | None = None,
    kept: Keeper | None = None,
) -> Verification:
    """Run every scenario with methods in a folder, or one file.

    Raises:
        TiltcalError: there is none, or one does not read.
    """
    paths = sorted(folder.glob("*.toml")) if folder.is_dir() else [folder]
    if not paths:
        raise TiltcalError(
            f"folder {folder}",
            found="no *.toml",
            need="scenarios",
            do="name a folder that contains some",
        )
    scenarios = [(path, load_scenario(path)) for path in paths]
    start = time.perf_counter()
    results = []
    for k, (path, scenario) in enumerate(scenarios, start=1):
        progress(f"{k} of {len(scenarios)}: {path.name}")
        if scenario.method or scenario.estimator:
            results.append(
                run_scenario(
                    scenario,
                    laboratory,
                    source=path.name,
                    allow_commands=allow_commands,
                    progress=progress,
                    workers=workers,
                    kept=kept,
                )
            )
    if not results:
        raise TiltcalError(
            f"folder {folder}",
            found="no scenario with a [[method]] or [[estimator]]",
            need="one to judge",
            do="add a [[method]]",
        )
    return Verification(tuple(results), time.perf_counter() - start)
