"""What ``run`` and ``verify`` print."""

from collections.abc import Sequence
from typing import Any

from tiltcal.cli.output import paragraph, print_table
from tiltcal.core.units import ARCSEC
from tiltcal.validation.acceptance import MethodResult, ScenarioResult, Verification
from tiltcal.validation.accuracy import TiltError
from tiltcal.validation.limit import Limit
from tiltcal.validation.run_files import record_of
from tiltcal.validation.run_statistics import statistics_of
from tiltcal.validation.runs import Row
from tiltcal.validation.tilt_limits import rms_interval

HEADER = ("scenario", "method", "runs", "verdict", "before, arcsec", "after", "95 %", "bound")
RUN_HEADER = ("seed", "verdict", "NEES/dof", "before, arcsec", "after", "bound", "seconds")


def print_runs(result: ScenarioResult) -> None:
    """Print one row per run of each method that has several."""
    for m in result.methods:
        if len(m.runs) > 1:
            print_table(RUN_HEADER, [_run(row) for row in m.rows], title=f"runs of {m.title}")


def print_verification(verification: Verification) -> None:
    """Print one row per method over its runs, the limits that were not met, and the count."""
    pairs = [(r, m) for r in verification.results for m in r.methods]
    print_table((*HEADER, "judged"), [_row(r, m) for r, m in pairs])
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
