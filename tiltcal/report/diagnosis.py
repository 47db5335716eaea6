"""The HTML report of a diagnosis: verdict, location, fit before and after, rejected alternatives
and the next measurement.
"""

from pathlib import Path
from typing import Any

import numpy as np

from tiltcal import __version__
from tiltcal.core.files import write_text
from tiltcal.diagnosis.conclusions.finding import Diagnosis, Finding
from tiltcal.diagnosis.conclusions.residual_plots import View
from tiltcal.report.figures import COLOURS, LAYOUT

TEMPLATE = Path(__file__).parent / "diagnosis.html.jinja"
COORDINATE = {
    "time": "time_s",
    "temperature": "temperature_degC",
    "tilt": "input",
    "rate": "input",
    "move": "time_s",
    "sample": "time_s",
}
MEANING = {
    "match": "The recording agrees with the scenario.",
    "explained": "The scenario leaves out physics; every finding has one name.",
    "ambiguous": "The scenario leaves out physics; several effects fit.",
    "unlisted": "The scenario leaves out physics of no listed effect; it is modelled as a curve.",
    "cannot_tell": "The recording, or the check of the answer, leaves no judgement.",
}


def write_diagnosis(diagnosis: Diagnosis, path: Path, sources: str) -> None:
    """Write the report of one diagnosis; ``sources`` names its recordings."""
    from jinja2 import Environment, StrictUndefined
    from plotly.offline import get_plotlyjs

    template = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    ).from_string(TEMPLATE.read_text(encoding="utf-8"))
    text = template.render(
        plotly=get_plotlyjs(),
        version=__version__,
        sources=sources,
        d=diagnosis,
        meaning=MEANING[diagnosis.verdict],
        findings=[{"f": f, "figures": _figures(f, diagnosis)} for f in diagnosis.findings],
        overview=_html(_spectra(diagnosis)),
        unseen=_unseen(diagnosis),
        noise=_noise(diagnosis),
        figure=_figure,
    )
    write_text(path, text)


def _figures(finding: Finding, diagnosis: Diagnosis) -> list[str]:
    """Residuals of the affected channels over the coordinate of a finding, before and after."""
    wanted = COORDINATE.get(finding.where.coordinate, f"{finding.where.coordinate}_deg")
    shown = [
        v
        for v in diagnosis.views
        if v.channel.split(".")[0] in finding.sensors and v.channel.split(".")[1] in finding.axes
    ]
    figures = []
    for view in shown[:3]:
        for name in dict.fromkeys((wanted, "time_s")):
            if name in view.coordinates:
                figures.append(_html(_residuals(view, name)))
    return figures


def _residuals(view: View, name: str) -> Any:
    """Mean residual over one coordinate with its standard uncertainty, before and after."""
    import plotly.graph_objects as go

    u = view.coordinates[name]
    axis = "own reading, SI" if name == "input" else name
    figure = go.Figure(layout=LAYOUT | {"title": f"{view.channel}: residual over {axis}"})
    for label, values, colour in (
        ("before", view.before[name], COLOURS[1]),
        ("after", view.after[name], COLOURS[0]),
    ):
        figure.add_scattergl(
            x=u,
            y=values,
            mode="markers",
            name=label,
            marker={"size": 4, "color": colour},
            error_y={"type": "data", "array": view.sigma[name], "thickness": 0.6, "width": 0},
        )
    figure.update_xaxes(title=axis)
    figure.update_yaxes(title=f"residual, {view.unit}", exponentformat="e")
    return figure


def _spectra(diagnosis: Diagnosis) -> Any:
    """Spectrum of the residual, before and after."""
    import plotly.graph_objects as go

    figure = go.Figure(layout=LAYOUT | {"title": "Spectrum of the residual (dotted: before)"})
    for i, view in enumerate(diagnosis.views[:8]):
        scale = max(float(np.median(view.spectrum_after[len(view.spectrum_after) // 2 :])), 1e-300)
        colour = COLOURS[i % len(COLOURS)]
        figure.add_scatter(
            x=view.frequency,
            y=view.spectrum_before / scale,
            line={"dash": "dot", "color": colour},
            showlegend=False,
        )
        figure.add_scatter(
            x=view.frequency,
            y=view.spectrum_after / scale,
            line={"color": colour},
            name=view.channel,
        )
    figure.update_xaxes(title="Hz", type="log")
    figure.update_yaxes(title="rms in the band / its noise", type="log")
    return figure


def _unseen(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """Effects that were not found; those that are not detectable first."""
    rows = [
        {
            "effect": u.effect,
            "absorbed": u.absorbed,
            "size": ", ".join(f"{k} {v:.3g}" for k, v in list(u.size.items())[:3]),
        }
        for u in diagnosis.undetectable
    ]
    return sorted(rows, key=lambda row: (bool(row["size"]), -row["absorbed"]))


def _noise(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """The noise of each channel, a row for each of its amplitudes."""
    return [
        {
            "channel": name,
            "kind": kind,
            "value": f"{a.value:.3g}",
            "interval": "" if a.low is None else f"{a.low:.3g} to {a.high:.3g}",
            "unit": c.units[kind],
            "share": f"{100 * c.share:.1f} %",
        }
        for name, c in diagnosis.noise.channels.items()
        for kind, a in c.amplitudes.items()
    ]


def _figure(value: float | None, digits: int = 4) -> str:
    """A number as text; a dash where nothing was tested."""
    return "-" if value is None else f"{value:.{digits}f}"


def _html(figure: Any) -> str:
    return str(figure.to_html(full_html=False, include_plotlyjs=False))
