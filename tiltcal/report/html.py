"""The report as one offline HTML file that contains plotly and all data."""

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from tiltcal import __version__
from tiltcal.calibration.result import Calibration
from tiltcal.core.files import write_text
from tiltcal.core.units import ARCSEC
from tiltcal.report.budget import budget_rows
from tiltcal.report.figures import parameter_figure, residual_figures, tilt_figure
from tiltcal.validation.acceptance import MethodResult, ScenarioResult, Verification

TEMPLATE = Path(__file__).parent / "report.html.jinja"


def write_report(verification: Verification, path: Path) -> None:
    """Write the report of some scenarios."""
    sections = [_section(r) for r in verification.results]
    tilts = [
        (escape(f"{r.scenario.name}: {m.title}", quote=False), m.tilt)  # plotly reads markup
        for r in verification.results
        for m in r.methods
        if m.tilt is not None
    ]
    text = rendered(
        TEMPLATE,
        title="tiltcal report",
        sections=sections,
        accepted=verification.accepted,
        seconds=verification.seconds,
        overview=html_of(tilt_figure(tilts)) if tilts else "",
    )
    write_text(path, text)


def rendered(template: Path, **values: Any) -> str:
    """A page from a template, with ``plotly`` and ``version`` beside the values."""
    from jinja2 import Environment, StrictUndefined
    from plotly.offline import get_plotlyjs

    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    page = environment.from_string(template.read_text(encoding="utf-8"))
    return page.render(version=__version__, plotly=get_plotlyjs(), **values)


def _section(result: ScenarioResult) -> dict[str, Any]:
    return {
        "name": result.scenario.name,
        "about": result.scenario.about.strip(),
        "source": result.source,
        "accepted": result.accepted,
        "table": result.scenario.rig.table,
        "effects": [_effect_text(e) for e in result.scenario.effect],
        "methods": [_method(result, m) for m in result.methods],
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
        "warnings": notes,
        "verdict": method.verdict,
        "equation": first.equation if first else "",
        "budget": budget_rows(method.budget) if method.budget else [],
        "tilt": method.tilt,
        "figures": [html_of(f) for f in figures if f is not None],
    }


def parameter_rows(calibration: Calibration, truth: dict[str, float]) -> Sequence[dict[str, str]]:
    """Rows of the parameter table: value, sigma, 95 % interval, truth, in readable units."""
    rows = []
    for name, e in calibration.parameters.items():
        factor, unit = (
            (1 / ARCSEC, "arcsec")
            if e.unit == "rad"
            else (1e6, "ppm")
            if e.unit == "1"
            else (1.0, e.unit)
        )
        low, high = (e.value - 1.96 * e.sigma) * factor, (e.value + 1.96 * e.sigma) * factor
        known = name in truth
        rows.append(
            {
                "name": name,
                "value": f"{e.value * factor:.6g}",
                "sigma": f"{e.sigma * factor:.3g}",
                "unit": unit,
                "interval": f"{low:.6g} ... {high:.6g}",
                "truth": f"{truth[name] * factor:.6g}" if known else "",
                "inside": ""
                if not known
                else "yes"
                if low <= truth[name] * factor <= high
                else "no",
            }
        )
    return rows


def html_of(figure: Any) -> str:
    """A figure as a part of a page that holds plotly."""
    return str(
        figure.to_html(
            full_html=False,
            include_plotlyjs=False,
            config={"displaylogo": False, "responsive": True},
        )
    )
