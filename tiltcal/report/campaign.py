"""The report of a campaign: tables and pictures in one offline HTML file."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tiltcal.core.files import write_text
from tiltcal.report.figures import COLOURS, LAYOUT
from tiltcal.report.html import html_of, rendered
from tiltcal.validation.campaign.campaign_file import Campaign
from tiltcal.validation.campaign.results import Results
from tiltcal.validation.run_statistics import share_of

LEAST_LOG_P = -700.0  # of what a float holds
TEMPLATE = Path(__file__).parent / "campaign.html.jinja"


def write_campaign_report(results: Results, summary: dict[str, Any], path: Path) -> None:
    """Write the report.

    Args:
        summary: of these results.
    """
    figures = []
    for method in summary["cells"][0]["methods"] if summary["cells"] else ():
        figures += _figures(results, summary, method)
    text = rendered(
        TEMPLATE,
        title=summary["name"],
        summary=summary,
        figures=[html_of(f) for f in figures],
    )
    write_text(path, text)


def _figures(results: Results, summary: dict[str, Any], method: str) -> list[Any]:
    cells = [(cell["values"], cell["methods"][method]) for cell in summary["cells"]]
    figures = [_nees_figure(results, method)]
    axis = _numeric_factor(results.campaign)
    if axis is not None and len(cells) > 1:
        figures += [_tilt_figure(cells, axis, method), _verdict_figure(cells, axis, method)]
    return [f for f in [*figures, _coverage_figure(cells, method)] if f is not None]


def _numeric_factor(campaign: Campaign) -> str | None:
    """The grid's factor with the most numbers."""
    known = [
        (len(f.levels()), f.title)
        for f in campaign.grids
        if all(isinstance(v, int | float) for v, _ in f.levels())
    ]
    return max(known)[1] if known else None


def _series(
    cells: Sequence[tuple[dict[str, Any], dict[str, Any]]], axis: str
) -> dict[str, list[tuple[float, dict[str, Any]]]]:
    """Statistics against a factor, for each combination of the others."""
    found: dict[str, list[tuple[float, dict[str, Any]]]] = {}
    for values, statistics in cells:
        others = ", ".join(f"{k} = {v}" for k, v in values.items() if k != axis)
        found.setdefault(others, []).append((float(values[axis]), statistics))
    return found


def _tilt_figure(cells: Any, axis: str, method: str) -> Any:
    """Tilt error after calibration, and its bound, against a factor."""
    import plotly.graph_objects as go

    figure = go.Figure(
        layout=LAYOUT
        | {
            "title": f"{method}: tilt error, rms over runs, 95 % interval",
            "xaxis": {"title": axis},
            "yaxis": {"title": "arcsec", "rangemode": "tozero"},
        }
    )
    drawn = False
    for k, (others, series) in enumerate(_series(cells, axis).items()):
        known = [(x, s["tilt_arcsec"]) for x, s in series if s["tilt_arcsec"]]
        x = [at for at, _ in known]
        y = np.array([t["after_rms"] for _, t in known])
        ends = np.array([t["after_rms_interval_95"] for _, t in known]).reshape(-1, 2)
        colour = COLOURS[k % len(COLOURS)]
        bars = {"array": ends[:, 1] - y, "arrayminus": y - ends[:, 0], "color": colour}
        name = f"after {others}".strip()
        figure.add_scatter(x=x, y=y, error_y=bars, name=name, line={"color": colour})
        bound = [t["bound_rms"] for _, t in known]
        figure.add_scatter(
            x=x, y=bound, name=f"bound {others}".strip(), line={"color": colour, "dash": "dot"}
        )
        drawn = drawn or bool(known)
    return figure if drawn else None


def _verdict_figure(cells: Any, axis: str, method: str) -> Any:
    """Share of runs that the method did not call good: detection against the factor, and false
    alarms where nothing is injected.
    """
    import plotly.graph_objects as go

    figure = go.Figure(
        layout=LAYOUT
        | {
            "title": f"{method}: share of runs by verdict, 95 % interval",
            "xaxis": {"title": axis},
            "yaxis": {"title": "share", "range": [-0.03, 1.03]},
        }
    )
    k = 0
    for others, series in _series(cells, axis).items():
        for verdict in sorted({v for _, s in series for v in s["verdicts"]}):
            shares = [s["verdicts"].get(verdict, share_of(0, s["runs"])) for _, s in series]
            y = np.array([s["share"] for s in shares])
            ends = np.array([s["interval_95"] for s in shares])
            colour = COLOURS[k % len(COLOURS)]
            bars = {"array": ends[:, 1] - y, "arrayminus": y - ends[:, 0], "color": colour}
            figure.add_scatter(
                x=[x for x, _ in series],
                y=y,
                error_y=bars,
                name=f"{verdict} {others}".strip(),
                line={"color": colour},
            )
            k += 1
    return figure


def _coverage_figure(cells: Any, method: str) -> Any:
    """Share of runs whose error is within the stated 95 % interval, by parameter."""
    import plotly.graph_objects as go

    figure = go.Figure(
        layout=LAYOUT
        | {
            "title": f"{method}: share of errors within 1.96 sigma, 95 % interval",
            "yaxis": {"title": "coverage", "range": [-0.03, 1.03]},
        }
    )
    figure.add_hline(y=0.95, line_dash="dot", line_color=COLOURS[-1])
    drawn = False
    for k, (values, statistics) in enumerate(cells):
        names = list(statistics["parameters"])
        found = [statistics["parameters"][n]["coverage_95"] for n in names]
        y = np.array([c["share"] for c in found])
        ends = np.array([c["interval_95"] for c in found]).reshape(-1, 2)
        figure.add_scatter(
            x=names,
            y=y,
            mode="markers",
            marker={"color": COLOURS[k % len(COLOURS)]},
            error_y={"array": ends[:, 1] - y, "arrayminus": y - ends[:, 0]},
            name=", ".join(f"{a} = {b}" for a, b in values.items()) or "all",
        )
        drawn = drawn or bool(names)
    return figure if drawn else None


def _nees_figure(results: Results, method: str) -> Any:
    """Quantiles of NEES over the runs of each combination of levels against those of chi-square, as
    probabilities mapped to one scale, so that runs of different degrees of freedom stand together.
    """
    import plotly.graph_objects as go
    from scipy.stats import chi2, norm

    series = _nees_of(results, method)
    if not series:
        return None
    figure = go.Figure(
        layout=LAYOUT
        | {
            "title": f"{method}: NEES against chi-square, as normal quantiles",
            "xaxis": {"title": "expected of a correct covariance"},
            "yaxis": {"title": "found"},
        }
    )
    most = max(len(pairs) for pairs in series.values())
    end = float(norm.isf(0.5 / most))
    line = {"color": COLOURS[-1], "dash": "dot"}
    figure.add_scatter(x=[-end, end], y=[-end, end], mode="lines", line=line, name="expected")
    for k, (words, pairs) in enumerate(series.items()):
        nees, dof = np.array(pairs, dtype=float).T
        found = np.sort(norm.isf(np.exp(np.maximum(chi2.logsf(nees, dof), LEAST_LOG_P))))
        expected = norm.ppf((np.arange(1, len(found) + 1) - 0.5) / len(found))
        marker = {"color": COLOURS[k % len(COLOURS)], "size": 5}
        figure.add_scatter(x=expected, y=found, mode="markers", marker=marker, name=words)
    return figure


def _nees_of(results: Results, method: str) -> dict[str, list[tuple[float, int]]]:
    """NEES and its degrees of freedom of the runs of a method that have them, by what their levels
    are called.
    """
    names = [f.title for f in results.campaign.grids]
    found: dict[str, list[tuple[float, int]]] = {}
    for run, recorded in results.runs():
        words = ", ".join(f"{n} = {run.point.values[n]}" for n in names) or "all"
        for row in recorded.rows:
            if row.method == method and row.error is None and row.nees_dof:
                found.setdefault(words, []).append((row.nees, row.nees_dof))
    return found
