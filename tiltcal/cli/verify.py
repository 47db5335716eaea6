"""``tiltcal run`` and ``verify``, and what they print."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from tiltcal.api.simulating import simulator
from tiltcal.cli.options import DEFAULT_BUDGET, AllowCommands, EngineName, Jobs, Json, MoreBudget
from tiltcal.cli.output import paragraph, print_json, print_line, print_table, progress_line
from tiltcal.core.assets import folder as assets
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import claimed, make_folder
from tiltcal.core.units import ARCSEC
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.report.verification import write_report
from tiltcal.validation.acceptance import (
    MethodResult,
    ScenarioResult,
    Verification,
    run_scenario,
    verify_folder,
)
from tiltcal.validation.accuracy import TiltError
from tiltcal.validation.kept_runs import kept_runs
from tiltcal.validation.limits import Limit, rms_interval
from tiltcal.validation.run_files import record_of, write_junit, write_runs
from tiltcal.validation.run_statistics import statistics_of
from tiltcal.validation.runs import Row, worker_processes

HEADER = ("scenario", "method", "runs", "verdict", "before, arcsec", "after", "95 %", "bound")
RUN_HEADER = ("seed", "verdict", "NEES/dof", "before, arcsec", "after", "bound", "seconds")


def print_runs(result: ScenarioResult) -> None:
    """Print one row per run of each method that has several."""
    for m in result.methods:
        if len(m.runs) > 1:
            rows = [_run(row) for row in m.rows]
            spare = ["seconds", "bound"]
            print_table(RUN_HEADER, rows, title=f"runs of {m.title}", spare=spare)


def print_verification(verification: Verification) -> None:
    """Print one row per method over its runs, the limits that were not met, and the count."""
    pairs = [(r, m) for r in verification.results for m in r.methods]
    rows = [_row(r, m) for r, m in pairs]
    print_table((*HEADER, "judged"), rows, spare=["bound", "95 %", "before, arcsec", "runs"])
    for r, m in pairs:
        for line in _remarks(m):
            paragraph(f"{r.scenario.name}, {m.title}: {line}")
    good = sum(r.accepted for r in verification.results)
    paragraph(
        f"{good} of {len(verification.results)} scenarios accepted in {verification.seconds:.1f} s"
    )


def _run(row: Row) -> list[str]:
    nees = f"{row.nees / row.nees_dof:.3g}" if row.nees_dof else ""
    tilt = [_figure(x) for x in (row.tilt_before, row.tilt_after, row.tilt_bound)]
    return [f"{row.seed}", row.shown_verdict, nees, *tilt, f"{row.seconds:.2f}"]


def _figure(angle: float | None) -> str:
    return "" if angle is None else f"{angle / ARCSEC:.3g}"


def _row(r: ScenarioResult, m: MethodResult) -> list[str]:
    judged = "accepted" if m.accepted else "NOT ACCEPTED"
    tilt = _tilt(m.tilt, len(m.runs))
    return [r.scenario.name, m.title, str(len(m.runs)), m.verdict, *tilt, judged]


def _tilt(tilt: TiltError | None, runs: int) -> list[str]:
    """before, after with the interval of its rms over several runs, bound."""
    if tilt is None:
        return ["", "", "", ""]
    before, after, bound = (f"{x:.3g}" for x in tilt.in_arcsec)
    low, high = (_figure(x) for x in rms_interval(tilt.after, tilt.dof))
    return [before, after, f"{low} ... {high}" if runs > 1 else "", bound]


def _remarks(m: MethodResult) -> list[str]:
    lines = [_broken(limit) for limit in m.limits if not limit.passed]
    lines += [m.error] if m.error else []
    return lines + ([m.online.statement] if m.online else [])


def _broken(limit: Limit) -> str:
    where = f" ({limit.where})" if limit.where else ""
    return f"{limit.name}: reached {limit.reached:.6g}{where}, allowed {limit.allowed}"


def to_json(verification: Verification) -> dict[str, object]:
    """The verification as JSON."""
    return {
        "schema": 1,
        "accepted": verification.accepted,
        "seconds": verification.seconds,
        "scenarios": [
            {
                "name": r.scenario.name,
                "source": r.source,
                "accepted": r.accepted,
                "methods": [_method_json(r, k) for k in range(len(r.methods))],
            }
            for r in verification.results
        ],
    }


def _method_json(r: ScenarioResult, k: int) -> dict[str, object]:
    m = r.methods[k]
    first = m.calibrations[0] if m.calibrations else None
    found: dict[str, Any] = {
        "method": m.title,
        "accepted": m.accepted,
        "error": m.error,
        "runs": len(m.runs),
        "verdict": first.verdict if first else None,
        "verdicts": m.verdict,
        "tilt_arcsec": _tilt_json(m.tilt),
        "online": m.online.to_json() if m.online else None,
        "limits": [vars(limit) for limit in m.limits],
        "truth": m.truth,
        "parameters": first.to_json()["parameters"] if first else {},
    }
    if m.runs:
        quantile = r.scenario.method[k].accept.quantile
        found |= {"statistics": statistics_of(m.rows, quantile), "rows": _records(m.rows)}
    return found


def _records(rows: Sequence[Row]) -> list[dict[str, Any]]:
    return [record_of(row) for row in rows]


def _tilt_json(tilt: TiltError | None) -> dict[str, float] | None:
    if tilt is None:
        return None
    return dict(zip(("before", "after", "bound"), tilt.in_arcsec, strict=True))


Reports = Annotated[
    Path | None,
    Parameter(
        "--output",
        alias="-o",
        help="Folder for report.html, junit.xml, runs.parquet and runs.csv.",
    ),
]


def run(
    scenarios: Annotated[tuple[Path, ...], Parameter("SCENARIO", help="Scenario files.")],
    /,
    *,
    output: Reports = None,
    allow_commands: AllowCommands = False,
    jobs: Jobs = 1,
    engine: EngineName = "processes",
    budget: MoreBudget = DEFAULT_BUDGET,
    as_json: Json = False,
) -> int:
    """Simulate, calibrate and judge scenarios.

    The [[method]] tables of a scenario name the methods and the accuracy that
    each has to reach, over all its runs.

      tiltcal run bench.toml -o out

    Exit status: 0 accepted; 1 not accepted; 2 unusable input.
    """
    start = time.perf_counter()
    budget.apply()
    _check_output(output)
    with claimed(output):
        with progress_line() as progress, worker_processes(jobs, simulator, engine) as workers:
            laboratory = simulator(progress)
            results = tuple(
                run_scenario(
                    load_scenario(path),
                    laboratory,
                    source=path.name,
                    allow_commands=allow_commands,
                    progress=progress,
                    workers=workers,
                )
                for path in scenarios
            )
        return finish(Verification(results, time.perf_counter() - start), output, as_json)


def verify(
    folder: Annotated[
        Path | None,
        Parameter("DIR", help="Folder of scenarios, or one file; the built-in ones if not given."),
    ] = None,
    /,
    *,
    output: Reports = None,
    allow_commands: AllowCommands = False,
    jobs: Jobs = 1,
    engine: EngineName = "processes",
    budget: MoreBudget = DEFAULT_BUDGET,
    as_json: Json = False,
) -> int:
    """Run a folder of scenarios and write CI reports.

    Of a single scenario every run is shown. With -o every finished run is kept
    until the reports are written: the same command after an interruption makes
    only the runs that are missing.

      tiltcal verify scenarios -o out -j 4
      tiltcal verify bench.toml

    Exit status: 0 all accepted; 1 not all accepted; 2 unusable input.
    """
    budget.apply()
    _check_output(output)
    with claimed(output), kept_runs(output) as kept:
        with progress_line() as progress, worker_processes(jobs, simulator, engine) as workers:
            verification = verify_folder(
                folder or assets("scenarios"),
                simulator(progress),
                allow_commands=allow_commands,
                progress=progress,
                workers=workers,
                kept=kept,
            )
        return finish(verification, output, as_json, each_run=True)


def _check_output(output: Path | None) -> None:
    """Refuse a report folder that cannot be created, before the work.

    Raises:
        TiltcalError: a file has this name.
    """
    if output is None:
        return
    position = output.absolute()
    existing = next(p for p in (position, *position.parents) if p.exists())
    if not existing.is_dir():
        raise TiltcalError(
            f"output {output}", found=f"the file {existing}", need="a folder", do="choose another"
        )


def finish(
    verification: Verification, output: Path | None, as_json: bool, each_run: bool = False
) -> int:
    """Print the verification, write report, JUnit XML and rows, and return the exit status."""
    if output:
        make_folder(output)
        write_report(verification, output / "report.html")
        write_junit(verification, output / "junit.xml")
        rows = [row for r in verification.results for m in r.methods for row in m.rows]
        write_runs(rows, output)
    if as_json:
        print_json(to_json(verification))
    else:
        if each_run and len(verification.results) == 1:
            print_runs(verification.results[0])
        print_verification(verification)
        if output:
            print_line(f"runs: {output / 'runs.parquet'} and runs.csv")
            print_line(f"report: {output / 'report.html'}")
    return 0 if verification.accepted else 1
