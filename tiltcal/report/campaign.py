"""The report of a campaign: tables and plots over the factors in one offline HTML file."""

from pathlib import Path
from typing import Any

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import readable_unit
from tiltcal.report.page import write_page
from tiltcal.report.plots import Plot, Trace, axes, colour, line, points
from tiltcal.validation.campaign.campaign_file import Campaign
from tiltcal.validation.campaign.results import Results
from tiltcal.validation.run_statistics import share_of

LEAST_LOG_P = -700.0  # smallest logarithm of a float
SHARES = [-0.03, 1.03]  # of an axis
Cells = list[tuple[dict[str, Any], dict[str, Any]]]


def write_campaign_report(results: Results, summary: dict[str, Any], path: Path) -> None:
    """Write the report.

    Args:
        results: of the campaign.
        path: of the file.
        summary: of these results.
    """
    figures: list[Plot] = []
    for method in summary["cells"][0]["methods"] if summary["cells"] else ():
        figures += _figures(results, summary, method)
    write_page(
        path,
        "campaign",
        lead=lead(summary),
        summary=summary,
        figures=figures,
        readable=readable_unit,
    )


def lead(summary: dict[str, Any]) -> str:
    """The result in one sentence."""
    statistics = [m for cell in summary["cells"] for m in cell["methods"].values()]
    counts: dict[str, int] = {}
    for one in statistics:
        for verdict, share in one["verdicts"].items():
            counts[verdict] = counts.get(verdict, 0) + share["count"]
    verdicts = ", ".join(f"{v.replace('_', ' ')} {n}" for v, n in counts.items())
    afters = [m["tilt_arcsec"]["after_rms"] for m in statistics if m["tilt_arcsec"]]
    tilt = (
        f"; the tilt error after calibration is {min(afters):.3g} to {max(afters):.3g} arcsec rms"
        if afters
        else ""
    )
    failed = f"; {len(summary['failed'])} without a result" if summary["failed"] else ""
    several = len(summary["cells"][0]["methods"]) if summary["cells"] else 0
    each = f", each by {several} methods" if several > 1 else ""
    done = f"{summary['runs']} of {summary['runs_planned']} runs{each}: {verdicts or 'no verdict'}"
    return f"{done}{failed}{tilt}."


def _figures(results: Results, summary: dict[str, Any], method: str) -> list[Plot]:
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


def _series(cells: Cells, axis: str) -> dict[str, list[tuple[float, dict[str, Any]]]]:
    """Statistics against a factor, for each combination of the others."""
    found: dict[str, list[tuple[float, dict[str, Any]]]] = {}
    for values, statistics in cells:
        others = ", ".join(f"{k} = {v}" for k, v in values.items() if k != axis)
        found.setdefault(others, []).append((float(values[axis]), statistics))
    return found


def _bars(y: Array, ends: Array) -> Trace:
    """Error bars from an interval, (n, 2), about y, (n,)."""
    below, above = y - ends[:, 0], ends[:, 1] - y
    bars = {"type": "data", "symmetric": False, "array": above, "arrayminus": below, "thickness": 1}
    return {"error_y": bars}


def _tilt_figure(cells: Cells, axis: str, method: str) -> Plot | None:
    """Tilt error after calibration, and its bound, against a factor."""
    traces: list[Trace] = []
    for k, (others, series) in enumerate(_series(cells, axis).items()):
        known = [(x, s["tilt_arcsec"]) for x, s in series if s["tilt_arcsec"]]
        if not known:
            continue
        x = [at for at, _ in known]
        y = np.array([t["after_rms"] for _, t in known])
        ends = np.array([t["after_rms_interval_95"] for _, t in known]).reshape(-1, 2)
        hover = "%{x:.4g}: %{y:.4g} arcsec"
        joined = {"mode": "lines+markers", "hover": hover}
        traces.append(line(x, y, f"after {others}".strip(), k, **joined, **_bars(y, ends)))
        bound = [t["bound_rms"] for _, t in known]
        dots = {"line": {"color": colour(k), "dash": "dot"}, "hover": hover}
        traces.append(line(x, bound, f"bound {others}".strip(), k, **dots))
    if not traces:
        return None
    layout = axes(axis, "arcsec", showlegend=True)
    layout["yaxis"]["rangemode"] = "tozero"
    return Plot(
        traces,
        f"{method}: tilt error after calibration, rms over runs, 95 % intervals, and its bound.",
        f"{method}: tilt error after calibration and its bound against {axis}",
        layout,
        height=360,
    )


def _verdict_figure(cells: Cells, axis: str, method: str) -> Plot:
    """Share of runs by verdict: detection against the factor, and false alarms where nothing is
    injected.
    """
    traces: list[Trace] = []
    for others, series in _series(cells, axis).items():
        for verdict in sorted({v for _, s in series for v in s["verdicts"]}):
            shares = [s["verdicts"].get(verdict, share_of(0, s["runs"])) for _, s in series]
            y = np.array([s["share"] for s in shares])
            ends = np.array([s["interval_95"] for s in shares])
            traces.append(
                line(
                    [x for x, _ in series],
                    y,
                    f"{verdict} {others}".strip(),
                    len(traces),
                    mode="lines+markers",
                    hover="%{x:.4g}: %{y:.3f}",
                    **_bars(y, ends),
                )
            )
    layout = axes(axis, "share", showlegend=True)
    layout["yaxis"]["range"] = SHARES
    return Plot(
        traces,
        f"{method}: share of runs by verdict, 95 % intervals.",
        f"{method}: share of runs by verdict against {axis}",
        layout,
        height=360,
    )


def _coverage_figure(cells: Cells, method: str) -> Plot | None:
    """Share of runs whose error is within the stated 95 % interval, by parameter."""
    traces: list[Trace] = []
    for k, (values, statistics) in enumerate(cells):
        names = list(statistics["parameters"])
        if not names:
            continue
        found = [statistics["parameters"][n]["coverage_95"] for n in names]
        y = np.array([c["share"] for c in found])
        ends = np.array([c["interval_95"] for c in found]).reshape(-1, 2)
        text = ", ".join(f"{a} = {b}" for a, b in values.items()) or "all"
        traces.append(points(names, y, text, k, hover="%{x}: %{y:.3f}", **_bars(y, ends)))
    if not traces:
        return None
    stated = {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": 0.95, "y1": 0.95}
    dots = {"line": {"dash": "dot", "width": 1, "color": colour(5)}}
    layout = axes("", "coverage", shapes=[stated | dots], showlegend=len(traces) > 1)
    layout["yaxis"]["range"] = SHARES
    return Plot(
        traces,
        f"{method}: share of errors within 1.96 sigma, 95 % intervals; 0.95 is expected.",
        f"{method}: coverage of the 95 % interval of each parameter",
        layout,
        height=360,
    )


def _nees_figure(results: Results, method: str) -> Plot | None:
    """Quantiles of NEES over the runs of each combination of levels against those of chi-square, as
    probabilities mapped to one scale, so that runs of different degrees of freedom stand together.
    """
    from scipy.stats import chi2, norm

    series = _nees_of(results, method)
    if not series:
        return None
    most = max(len(pairs) for pairs in series.values())
    end = float(norm.isf(0.5 / most))
    dots = {"line": {"color": colour(5), "dash": "dot"}, "hoverinfo": "skip"}
    traces = [line([-end, end], [-end, end], "expected", 5, **dots)]
    for k, (text, pairs) in enumerate(series.items()):
        nees, dof = np.array(pairs, dtype=float).T
        found = np.sort(norm.isf(np.exp(np.maximum(chi2.logsf(nees, dof), LEAST_LOG_P))))
        expected = norm.ppf((np.arange(1, len(found) + 1) - 0.5) / len(found))
        hover = "expected %{x:.3g}, found %{y:.3g}"
        traces.append(points(expected, found, text, k, hover=hover))
    return Plot(
        traces,
        f"{method}: NEES against chi-square, as normal quantiles; points above the line are larger"
        " errors than stated.",
        f"{method}: quantiles of NEES against those of chi-square",
        axes("expected of a correct covariance", "found", showlegend=True),
        height=360,
    )


def _nees_of(results: Results, method: str) -> dict[str, list[tuple[float, int]]]:
    """NEES and its degrees of freedom of the runs of a method that have them, by what their levels
    are called.
    """
    names = [f.title for f in results.campaign.grids]
    found: dict[str, list[tuple[float, int]]] = {}
    for run, recorded in results.runs():
        text = ", ".join(f"{n} = {run.point.values[n]}" for n in names) or "all"
        for row in recorded.rows:
            if row.method == method and row.error is None and row.nees_dof:
                found.setdefault(text, []).append((row.nees, row.nees_dof))
    return found
