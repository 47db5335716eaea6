"""``tiltcal run`` and ``verify``."""

import argparse
import time
from pathlib import Path

from tiltcal.cli.laboratory import simulator
from tiltcal.cli.output import print_json, print_table, progress_line
from tiltcal.core.assets import folder
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import make_folder
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.report import write_report
from tiltcal.validation.acceptance import Verification, run_scenario, verify_folder, write_junit
from tiltcal.validation.accuracy import TiltError


def run(args: argparse.Namespace) -> int:
    """Run some scenarios."""
    start = time.perf_counter()
    _check_output(args)
    with progress_line() as progress:
        laboratory = simulator(progress)
        results = tuple(
            run_scenario(
                load_scenario(path),
                laboratory,
                source=Path(path).name,
                allow_commands=args.allow_commands,
                progress=progress,
            )
            for path in args.scenario
        )
    return finish(Verification(results, time.perf_counter() - start), args)


def verify(args: argparse.Namespace) -> int:
    """Run a folder of scenarios."""
    place = Path(args.folder) if args.folder else folder("scenarios")
    _check_output(args)
    with progress_line() as progress:
        verification = verify_folder(
            place, simulator(progress), allow_commands=args.allow_commands, progress=progress
        )
    return finish(verification, args)


def _check_output(args: argparse.Namespace) -> None:
    """Refuse a report folder that cannot be made, before the work rather than after it.

    Raises:
        TiltcalError: a file is in the way.
    """
    if args.output:
        out = Path(args.output).absolute()
        there = next(p for p in (out, *out.parents) if p.exists())
        if not there.is_dir():
            raise TiltcalError(
                f"output {args.output}",
                found=f"the file {there}",
                need="a folder",
                do="choose another",
            )


def finish(verification: Verification, args: argparse.Namespace) -> int:
    """Print, write the report and JUnit XML, and the exit status."""
    if args.output:
        out = make_folder(Path(args.output))
        write_report(verification, out / "report.html")
        write_junit(verification, out / "junit.xml")
    if args.json:
        print_json(as_json(verification))
    else:
        print_verification(verification)
        if args.output:
            print(f"report: {Path(args.output) / 'report.html'}")
    return 0 if verification.accepted else 1


def print_verification(verification: Verification) -> None:
    """One row a method; what broke, in words."""
    rows = []
    for r in verification.results:
        for m in r.methods:
            tilt = [f"{x:.3g}" for x in m.tilt.in_arcsec] if m.tilt else ["", "", ""]
            verdict = (
                m.calibrations[0].verdict if m.calibrations else "error" if m.error else "on line"
            )
            rows.append(
                [
                    r.scenario.name,
                    m.title,
                    str(len(m.calibrations)),
                    verdict,
                    *tilt,
                    "accepted" if m.accepted else "NOT ACCEPTED",
                ]
            )
    print_table(
        ["scenario", "method", "runs", "verdict", "before, arcsec", "after", "bound", "judged"],
        rows,
    )
    for r in verification.results:
        for m in r.methods:
            for limit in m.limits:
                if not limit.passed:
                    print(
                        f"{r.scenario.name}, {m.title}: {limit.name}: reached {limit.reached:.6g},"
                        f" allowed {limit.allowed}"
                    )
            if m.error:
                print(f"{r.scenario.name}, {m.title}: {m.error}")
            if m.online:
                print(f"{r.scenario.name}, {m.title}: {m.online.statement}")
    good = sum(r.accepted for r in verification.results)
    print(
        f"{good} of {len(verification.results)} scenarios accepted in {verification.seconds:.1f} s"
    )


def _tilt_json(tilt: TiltError | None) -> dict[str, float] | None:
    return (
        None
        if tilt is None
        else dict(zip(("before", "after", "bound"), tilt.in_arcsec, strict=True))
    )


def as_json(verification: Verification) -> dict[str, object]:
    """The verification for machines."""
    return {
        "schema": 1,
        "accepted": verification.accepted,
        "seconds": verification.seconds,
        "scenarios": [
            {
                "name": r.scenario.name,
                "source": r.source,
                "accepted": r.accepted,
                "methods": [
                    {
                        "method": m.title,
                        "accepted": m.accepted,
                        "error": m.error,
                        "runs": len(m.calibrations),
                        "verdict": m.calibrations[0].verdict if m.calibrations else None,
                        "tilt_arcsec": _tilt_json(m.tilt),
                        "online": m.online.to_json() if m.online else None,
                        "limits": [vars(limit) for limit in m.limits],
                        "truth": m.truth,
                        "parameters": (
                            m.calibrations[0].to_json()["parameters"] if m.calibrations else {}
                        ),
                    }
                    for m in r.methods
                ],
            }
            for r in verification.results
        ],
    }
