"""Running scenarios: record, calibrate, judge against the acceptance limits; one or a folder of
them.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from tiltcal.calibration.methods.registry import calibrate, run_command
from tiltcal.calibration.result import Calibration
from tiltcal.core.errors import TiltcalError
from tiltcal.core.progress import Progress, silent
from tiltcal.laboratory.laboratory import Laboratory
from tiltcal.laboratory.scenario import Scenario, load_scenario
from tiltcal.laboratory.scenario_tables import EstimatorTable, MethodTable
from tiltcal.recordings.recording import Recording
from tiltcal.validation.accuracy import TiltError, tilt_error, true_parameters
from tiltcal.validation.gyro_accuracy import attitude_error
from tiltcal.validation.limits import Limit, limits_of
from tiltcal.validation.online.judging import run_estimator
from tiltcal.validation.online.online_result import OnlineResult
from tiltcal.validation.uncertainty_budget import Budget, make_budget


@dataclass(frozen=True)
class MethodResult:
    """One method on one scenario.

    Args:
        title: of the method.
        calibrations: one a run.
        truth: injected value of each parameter that has one.
        tilt: error before and after, of the first run.
        limits: judged.
        seconds: all runs.
        error: what went wrong, when it did not even calibrate.
        online: of an estimator that was fed sample by sample.
        budget: of the first run, where the scenario names sources of uncertainty.
    """

    title: str
    calibrations: tuple[Calibration, ...] = ()
    truth: dict[str, float] = field(default_factory=dict)
    tilt: TiltError | None = None
    limits: tuple[Limit, ...] = ()
    seconds: float = 0.0
    error: str | None = None
    online: OnlineResult | None = None
    budget: Budget | None = None

    @property
    def accepted(self) -> bool:
        """Whether every limit holds."""
        return self.error is None and all(limit.passed for limit in self.limits)


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
) -> ScenarioResult:
    """Simulate, calibrate, judge.

    Raises:
        TiltcalError: the scenario holds no method, or a command that is not allowed.
    """
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
    runs = max((m.runs for m in scenario.method), default=1)
    recordings = []
    for k in range(runs):
        progress(f"{scenario.name}: recording {k + 1} of {runs}")
        recordings.append(laboratory.record(scenario, scenario.seed + k))
    results = []
    for m in scenario.method:
        progress(f"{scenario.name}: {m.title}")
        results.append(_run_method(scenario, m, recordings[: m.runs]))
    for e in scenario.estimator:
        progress(f"{scenario.name}: {e.title}, sample by sample")
        results.append(_run_estimator(scenario, e, recordings[0], laboratory))
    return ScenarioResult(scenario, source, tuple(results), recordings[0])


def _run_method(
    scenario: Scenario, table: MethodTable, recordings: Sequence[Recording]
) -> MethodResult:
    start = time.perf_counter()
    try:
        found = tuple(_calibrate(scenario, table, r) for r in recordings)
        truth = true_parameters(scenario, scenario.effects, found[0])
        tilt = _error_of(found[0], scenario)
        budget = _budget(scenario, table, recordings[0])
    except TiltcalError as error:
        return MethodResult(table.title, seconds=time.perf_counter() - start, error=str(error))
    limits = tuple(limits_of(scenario, table, found, tilt))
    seconds = time.perf_counter() - start
    return MethodResult(table.title, found, truth, tilt, limits, seconds, budget=budget)


def _budget(scenario: Scenario, table: MethodTable, recording: Recording) -> Budget | None:
    if not scenario.budget or table.name is None:
        return None
    return make_budget(table.name, recording, scenario, scenario.budget, **table.options)[1]


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
) -> Verification:
    """Run every scenario of a folder that holds methods.

    Raises:
        TiltcalError: there is none, or one does not read.
    """
    paths = sorted(folder.glob("*.toml")) if folder.is_dir() else [folder]
    if not paths:
        raise TiltcalError(
            f"folder {folder}",
            found="no *.toml",
            need="scenarios",
            do="name a folder that holds some",
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
