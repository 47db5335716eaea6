"""The report of a comparison: the differences over the working range."""

from pathlib import Path
from typing import Any

import numpy as np

from tiltcal.report.page import sections, write_page
from tiltcal.report.plots import Plot, Trace, axes, colour, line
from tiltcal.validation.comparison import Comparison, Curve


def write_comparison(found: Comparison, path: Path) -> None:
    """Write the report.

    Args:
        found: what is shown.
        path: of the file.
    """
    write_page(
        path,
        "comparison",
        found=found,
        contents=sections("Differences", "Over the range", "Tests"),
        rows=_rows(found),
        plots_of=[plot for curve in found.curves for plot in _plots(curve, found.names)],
    )


def _rows(found: Comparison) -> list[dict[str, Any]]:
    columns = found.as_columns()
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _plots(curve: Curve, names: "list[str] | Any") -> list[Plot]:
    if curve.coordinate == "direction":
        return [_map(curve, k, names) for k in range(len(curve.difference))]
    return [_curves(curve, names)] if curve.coordinate else []


def _map(curve: Curve, k: int, names: Any) -> Plot:
    """A quantity over all directions, seen from above: the distance from the middle is the tilt."""
    n = len(curve.at)
    up, values = curve.at, curve.difference[k]
    tilt = np.degrees(np.arccos(np.clip(up[:, 2], -1, 1)))
    heading = np.arctan2(up[:, 1], up[:, 0])
    worst = int(np.argmax(np.abs(values)))
    trace: Trace = {
        "type": "scatter",
        "mode": "markers",
        "x": tilt * np.cos(heading),
        "y": tilt * np.sin(heading),
        "name": curve.quantity,
        "text": [f"{v:.3g} +- {s:.2g}" for v, s in zip(values, curve.sigma[k], strict=True)],
        "hovertemplate": "%{text} " + curve.unit + "<extra></extra>",
        "marker": {
            "size": 7,
            "color": values,
            "colorscale": "Viridis",
            "colorbar": {"title": {"text": curve.unit}},
        },
    }
    where = f"tilt along x and y of the instrument, deg; {n} directions"
    caption = (
        f"{curve.sensor}, {curve.quantity}: {names[k + 1]} less {names[0]}, {curve.unit};"
        f" worst {values[worst]:.3g} +- {curve.sigma[k][worst]:.2g} at {tilt[worst]:.0f} deg."
    )
    layout = axes("tilt along x, deg", "tilt along y, deg")
    layout["yaxis"]["scaleanchor"] = "x"
    return Plot([trace], caption, f"Map of the difference over {where}", layout, height=420)


def _curves(curve: Curve, names: Any) -> Plot:
    """A quantity over rate or angle, with its uncertainty at k = 2 as a band."""
    x = curve.at[:, 0]
    order = np.argsort(x)
    unit = "deg/s" if curve.coordinate == "rate" else "deg"
    traces: list[Trace] = []
    for k, values in enumerate(curve.difference):
        low, high = values - 2 * curve.sigma[k], values + 2 * curve.sigma[k]
        traces += [
            line(x[order], low[order], "", k, showlegend=False, hoverinfo="skip"),
            line(
                x[order],
                high[order],
                "U (k = 2)",
                k,
                fill="tonexty",
                showlegend=False,
                hoverinfo="skip",
            ),
            line(
                x[order], values[order], str(names[k + 1]), k, line={"color": colour(k), "width": 3}
            ),
        ]
    caption = (
        f"{curve.sensor}, {curve.quantity}: difference from {names[0]}, {curve.unit}, with its"
        " uncertainty (k = 2)."
    )
    title = f"difference, {curve.unit}"
    return Plot(traces, caption, caption, axes(f"{curve.coordinate}, {unit}", title))
