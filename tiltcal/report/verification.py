"""The report of a verification: scenarios, their methods, and the limits they were judged by."""

from pathlib import Path
from typing import Any

from tiltcal.report.budget import budget_rows
from tiltcal.report.figures import parameter_figure, residual_figures, tilt_figure
from tiltcal.report.page import write_page
from tiltcal.report.parameters import parameter_rows
from tiltcal.report.poses import poses_of
from tiltcal.report.scenes import sphere_plot
from tiltcal.validation.acceptance import MethodResult, ScenarioResult, Verification


def write_report(verification: Verification, path: Path) -> None:
    """Write the report of some scenarios."""
    tilts = [
        (f"{r.scenario.name}: {m.title}", m.tilt)
        for r in verification.results
        for m in r.methods
        if m.tilt is not None
    ]
    write_page(
        path,
        "verification",
        lead=lead(verification),
        sections=[_section(k, r) for k, r in enumerate(verification.results, 1)],
        accepted=verification.accepted,
        seconds=verification.seconds,
        overview=tilt_figure(tilts) if tilts else None,
    )


def lead(verification: Verification) -> str:
    """The result in one sentence."""
    results = verification.results
    accepted = sum(r.accepted for r in results)
    refused = [r.scenario.name for r in results if not r.accepted]
    first = f"{accepted} of {len(results)} scenarios accepted: every limit was met"
    if not refused:
        return f"{first}."
    others = f" and {len(refused) - 3} more" if len(refused) > 3 else ""
    return f"{first} in these; not in {', '.join(refused[:3])}{others}."


def _section(number: int, result: ScenarioResult) -> dict[str, Any]:
    recordings = [] if result.recording is None else [result.recording]
    return {
        "id": f"scenario-{number}",
        "name": result.scenario.name,
        "about": result.scenario.about.strip(),
        "source": result.source,
        "accepted": result.accepted,
        "table": result.scenario.rig.table,
        "effects": [_effect_text(e) for e in result.scenario.effect],
        "methods": [_method(result, m) for m in result.methods],
        "sphere": sphere_plot(poses_of(recordings, result.scenario)),
    }


def _effect_text(table: Any) -> str:
    where = table.sensor or table.axis
    values = ", ".join(
        f"{k} = {v:g}" if isinstance(v, int | float) else f"{k} = {v}"
        for k, v in (table.model_extra or {}).items()
    )
    return f"{table.id}{f' on {where}' if where else ''}: {values}"


def _method(result: ScenarioResult, method: MethodResult) -> dict[str, Any]:
    first = method.calibrations[0] if method.calibrations else None
    notes = first.warnings if first else [method.online.statement] if method.online else []
    figures: list[Any] = []
    if first is not None:
        figures.append(parameter_figure(first, method.truth))
        if result.recording is not None:
            figures += residual_figures(result.recording, result.scenario, first)
    return {
        "title": method.title,
        "accepted": method.accepted,
        "error": method.error,
        "runs": len(method.runs),
        "limits": method.limits,
        "rows": parameter_rows(first, method.truth) if first else [],
        "tests": first.tests if first else [],
        "heldout": first.heldout_shown if first else {},
        "warnings": notes,
        "verdict": method.verdict,
        "equation": first.equation if first else "",
        "budget": budget_rows(method.budget, first) if method.budget and first else [],
        "tilt": method.tilt,
        "figures": [f for f in figures if f is not None],
    }
