"""``tiltcal run`` and ``verify``."""

import time
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tiltcal.cli.laboratory import simulator
from tiltcal.cli.options import Json
from tiltcal.cli.output import print_json, print_table, progress_line
from tiltcal.core.assets import folder as assets
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import make_folder
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.report import write_report
from tiltcal.validation.acceptance import (
    MethodResult,
    ScenarioResult,
    Verification,
    run_scenario,
    verify_folder,
)
from tiltcal.validation.accuracy import TiltError
from tiltcal.validation.junit import write_junit

HEADER = ("scenario", "method", "runs", "verdict", "before, arcsec", "after", "bound", "judged")

Reports = Annotated[
    Path | None, Parameter("--output", alias="-o", help="Folder for report.html and junit.xml.")
]
AllowCommands = Annotated[
    bool,
    Parameter("--allow-commands", help="Permit scenarios to run external programs as methods."),
]


def run(
    scenarios: Annotated[tuple[Path, ...], Parameter("SCENARIO", help="Scenario files.")],
    /,
    *,
    output: Reports = None,
    allow_commands: AllowCommands = False,
    as_json: Json = False,
) -> int:
    """Simulate, calibrate and judge scenarios.

    The [[method]] tables of a scenario name the methods and the accuracy that
    each has to reach.

      tiltcal run bench.toml -o out

    Exit status: 0 accepted; 1 not accepted; 2 unusable input.
    """
    start = time.perf_counter()
    _check_output(output)
    with progress_line() as progress:
        laboratory = simulator(progress)
        results = tuple(
            run_scenario(
                load_scenario(path),
                laboratory,
                source=path.name,
                allow_commands=allow_commands,
                progress=progress,
            )
            for path in scenarios
        )
    return finish(Verification(results, time.perf_counter() - start), output, as_json)


def verify(
    folder: Annotated[
        Path | None, Parameter("DIR", help="Folder of scenarios; the built-in ones if not given.")
    ] = None,
    /,
    *,
    output: Reports = None,
    allow_commands: AllowCommands = False,
    as_json: Json = False,
) -> int:
    """Run a folder of scenarios and write CI reports.

      tiltcal verify scenarios -o out
      tiltcal verify

    Exit status: 0 all accepted; 1 not all accepted; 2 unusable input.
    """
    _check_output(output)
    with progress_line() as progress:
        verification = verify_folder(
            folder or assets("scenarios"),
            simulator(progress),
            allow_commands=allow_commands,
            progress=progress,
        )
    return finish(verification, output, as_json)


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


def finish(verification: Verification, output: Path | None, as_json: bool) -> int:
    """Print the verification, write report and JUnit XML, and return the exit status."""
    if output:
        make_folder(output)
        write_report(verification, output / "report.html")
        write_junit(verification, output / "junit.xml")
    if as_json:
        print_json(to_json(verification))
    else:
        print_verification(verification)
        if output:
            print(f"report: {output / 'report.html'}")
    return 0 if verification.accepted else 1


def print_verification(verification: Verification) -> None:
    """Print one row per method, the limits that were not met, and the count."""
    pairs = [(r, m) for r in verification.results for m in r.methods]
    print_table(HEADER, [_row(r, m) for r, m in pairs])
    for r, m in pairs:
        for line in _remarks(m):
            print(f"{r.scenario.name}, {m.title}: {line}")
    good = sum(r.accepted for r in verification.results)
    print(
        f"{good} of {len(verification.results)} scenarios accepted in {verification.seconds:.1f} s"
    )


def _row(r: ScenarioResult, m: MethodResult) -> list[str]:
    tilt = [f"{x:.3g}" for x in m.tilt.in_arcsec] if m.tilt else ["", "", ""]
    judged = "accepted" if m.accepted else "NOT ACCEPTED"
    return [r.scenario.name, m.title, str(len(m.calibrations)), _verdict(m), *tilt, judged]


def _verdict(m: MethodResult) -> str:
    if m.calibrations:
        return m.calibrations[0].verdict
    return "error" if m.error else "on line"


def _remarks(m: MethodResult) -> list[str]:
    broken = [limit for limit in m.limits if not limit.passed]
    lines = [f"{b.name}: reached {b.reached:.6g}, allowed {b.allowed}" for b in broken]
    lines += [m.error] if m.error else []
    return lines + ([m.online.statement] if m.online else [])


def _tilt_json(tilt: TiltError | None) -> dict[str, float] | None:
    if tilt is None:
        return None
    return dict(zip(("before", "after", "bound"), tilt.in_arcsec, strict=True))


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
                "methods": [_method_json(m) for m in r.methods],
            }
            for r in verification.results
        ],
    }


def _method_json(m: MethodResult) -> dict[str, object]:
    first = m.calibrations[0] if m.calibrations else None
    return {
        "method": m.title,
        "accepted": m.accepted,
        "error": m.error,
        "runs": len(m.calibrations),
        "verdict": first.verdict if first else None,
        "tilt_arcsec": _tilt_json(m.tilt),
        "online": m.online.to_json() if m.online else None,
        "limits": [vars(limit) for limit in m.limits],
        "truth": m.truth,
        "parameters": first.to_json()["parameters"] if first else {},
    }
