"""``tiltcal run`` and ``verify``."""

import time
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tiltcal.api.simulating import simulator
from tiltcal.cli.options import DEFAULT_BUDGET, AllowCommands, EngineName, Jobs, Json, MoreBudget
from tiltcal.cli.output import print_json, progress_line, say
from tiltcal.cli.verify_output import print_runs, print_verification, to_json
from tiltcal.core.assets import folder as assets
from tiltcal.core.claimed_folder import claimed
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import make_folder
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.report.verification import write_report
from tiltcal.validation.acceptance import Verification, run_scenario, verify_folder
from tiltcal.validation.junit import write_junit
from tiltcal.validation.kept_runs import kept_runs
from tiltcal.validation.run_files import write_runs
from tiltcal.validation.runs import worker_processes

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
    place = output.absolute()
    existing = next(p for p in (place, *place.parents) if p.exists())
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
            say(f"runs: {output / 'runs.parquet'} and runs.csv")
            say(f"report: {output / 'report.html'}")
    return 0 if verification.accepted else 1
