"""Running scenarios: record, calibrate, judge against the acceptance limits; a folder of them with
JUnit XML.
"""

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from tiltcal.calibration.methods.registry import calibrate, run_command
from tiltcal.calibration.result import Calibration
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import replacing
from tiltcal.core.progress import Progress, silent
from tiltcal.laboratory.laboratory import Laboratory
from tiltcal.laboratory.scenario import Scenario, load_scenario
from tiltcal.laboratory.scenario_tables import EstimatorTable, MethodTable
from tiltcal.recordings.recording import Recording
from tiltcal.validation.accuracy import TiltError, normalised_error, tilt_error, true_parameters
from tiltcal.validation.gyro_accuracy import attitude_error
from tiltcal.validation.online.judging import OnlineResult, run_estimator
from tiltcal.validation.uncertainty_budget import Budget, make_budget


@dataclass(frozen=True)
class Limit:
    """One acceptance limit: what was reached, what was allowed, in words."""

    name: str
    reached: float
    allowed: str
    passed: bool


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
    calibrations: tuple[Calibration, ...]
    truth: dict[str, float]
    tilt: TiltError | None
    limits: tuple[Limit, ...]
    seconds: float
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
                need="leave to run programs",
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
        return MethodResult(table.title, (), {}, None, (), time.perf_counter() - start, str(error))
    limits = tuple(_limits(scenario, table, found, tilt))
    return MethodResult(
        table.title, found, truth, tilt, limits, time.perf_counter() - start, budget=budget
    )


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
        return MethodResult(table.title, (), {}, None, (), time.perf_counter() - start, str(error))
    limits = tuple(Limit(*limit) for limit in found.limits(table.accept))
    return MethodResult(
        table.title, (), {}, None, limits, time.perf_counter() - start, online=found
    )


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


def _limits(
    scenario: Scenario, table: MethodTable, found: Sequence[Calibration], tilt: TiltError | None
) -> Iterable[Limit]:
    verdicts = [c.verdict for c in found]
    wrong = [v for v in verdicts if v != table.expect]
    said = ", ".join(
        f"{v} x{verdicts.count(v)}" if len(verdicts) > 1 else v for v in dict.fromkeys(verdicts)
    )
    allowed_wrong = _rare(len(found), table.accept.false_alarm) if table.expect == "good" else 0
    yield Limit(
        f"verdict ({said})",
        float(len(wrong)),
        f"{table.expect}, at most {allowed_wrong} others",
        len(wrong) <= allowed_wrong,
    )
    if table.expect == "cannot_tell":
        return
    if table.accept.parameters:
        yield _parameter_limit(scenario, table, found)
    if tilt is None:
        return
    before, after, bound = tilt.in_arcsec
    a = table.accept
    if a.tilt_arcsec is not None:
        yield Limit(
            "tilt error, arcsec rms", after, f"<= {a.tilt_arcsec:g}", after <= a.tilt_arcsec
        )
    if a.tilt_over_bound is not None:
        yield Limit(
            "tilt error over its bound",
            _ratio(after, bound),
            f"<= {a.tilt_over_bound:g}",
            after <= a.tilt_over_bound * bound,
        )
    if a.better_by is not None:
        yield Limit(
            "tilt error before over after",
            _ratio(before, after),
            f">= {a.better_by:g}",
            before >= a.better_by * after,
        )


def _ratio(a: float, b: float) -> float:
    """a / b; a perfect b makes it infinite."""
    return a / b if b else np.inf


def _rare(runs: int, false_alarm: float) -> int:
    """How many of ``runs`` good calibrations may be called suspect: each has a few tests at 0.1
    %.
    """
    from scipy.stats import binom

    return int(binom.isf(false_alarm, runs, 5e-3)) if runs > 1 else 0


def _parameter_limit(scenario: Scenario, table: MethodTable, found: Sequence[Calibration]) -> Limit:
    """All parameters of all runs against the truth: the sum of squared errors in units of their
    covariance (NEES).
    """
    from scipy.special import chdtri

    total, dof = 0.0, 0
    for c in found:
        nees, n = normalised_error(c, true_parameters(scenario, scenario.effects, c))
        total, dof = total + nees, dof + n
    if dof == 0:
        return Limit("parameters against the truth", 0.0, "a truth to compare with", False)
    low, high = (
        chdtri(dof, 1 - table.accept.false_alarm / 2),
        chdtri(dof, table.accept.false_alarm / 2),
    )
    ok = low <= total <= high
    return Limit(
        "parameters, NEES per degree of freedom",
        total / dof,
        f"{low / dof:.3g} ... {high / dof:.3g}",
        bool(ok),
    )


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


def _printable(text: str) -> str:
    """Without the control characters that XML cannot hold."""
    return "".join(c if c.isprintable() or c == "\n" else "?" for c in text)


def write_junit(verification: Verification, path: Path) -> None:
    """JUnit XML: a suite a scenario, a case a limit."""
    root = ElementTree.Element(
        "testsuites", name="tiltcal verify", time=f"{verification.seconds:.3f}"
    )
    for result in verification.results:
        suite = ElementTree.SubElement(root, "testsuite", name=result.scenario.name)
        cases, failures = 0, 0
        for method in result.methods:
            limits = method.limits or (Limit("calibration", np.nan, method.error or "", False),)
            for limit in limits:
                cases += 1
                case = ElementTree.SubElement(
                    suite,
                    "testcase",
                    classname=f"{result.source}.{method.title}",
                    name=limit.name,
                    time=f"{method.seconds:.3f}",
                )
                if not limit.passed or method.error:
                    failures += 1
                    text = _printable(
                        method.error or f"reached {limit.reached:.6g}, allowed {limit.allowed}"
                    )
                    ElementTree.SubElement(case, "failure", message=text).text = text
        suite.set("tests", str(cases))
        suite.set("failures", str(failures))
    ElementTree.indent(root)
    with replacing(path) as temporary:
        ElementTree.ElementTree(root).write(temporary, encoding="utf-8", xml_declaration=True)
