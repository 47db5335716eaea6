"""Plots of a report: data and layout as plotly reads them.

A plot names its colours as the style of the page does, ``var(--c0)``: the page draws it, light or
dark. What comes from files is text: none of it can be markup.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

PALETTE = tuple(f"var(--c{k})" for k in range(6))
LOGARITHMIC = {"type": "log", "dtick": "D2", "tickformat": "~g"}
"""A logarithmic axis with ticks at 1, 2 and 5, each labelled with its whole number."""
DIGITS = 6
MARKUP = ("hovertemplate",)  # written here, with names as %{fullData.name} and %{text}
Trace = dict[str, Any]


@dataclass(frozen=True)
class Plot:
    """One plot.

    Args:
        traces: as plotly reads them.
        caption: what it shows, below the plot.
        alternative: the same for those who do not see it.
        layout: as plotly reads it.
        frames: of an animation.
        height: px.
    """

    traces: Sequence[Trace]
    caption: str
    alternative: str
    layout: Mapping[str, Any] = field(default_factory=dict)
    height: int = 320
    frames: Sequence[Mapping[str, Any]] = ()

    def to_json(self) -> str:
        """The data for a script element: nothing in it ends that element or is markup."""
        parts = {"data": self.traces, "layout": self.layout, "frames": self.frames}
        text = json.dumps(_plain(parts), separators=(",", ":"), allow_nan=False)
        return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def colour(k: int) -> str:
    """Colour of the k-th series."""
    return PALETTE[k % len(PALETTE)]


def points(
    x: ArrayLike,
    y: ArrayLike,
    name: str,
    index: int,
    *,
    sigma: ArrayLike | None = None,
    text: Sequence[str] | None = None,
    hover: str = "%{x:.4g}, %{y:.4g}",
    **more: Any,
) -> Trace:
    """A series of points.

    Args:
        x, y: (n,).
        name: of the series.
        index: of its colour in the palette.
        sigma: standard uncertainty of y, (n,).
        text: of each point, for its label.
        hover: the label, with units, below the name.
        more: other keys of the trace.
    """
    label = f"%{{fullData.name}}<br>{hover}" + ("<br>%{text}" if text is not None else "")
    trace: Trace = {
        "type": "scatter",
        "mode": "markers",
        "x": x,
        "y": y,
        "name": name,
        "hovertemplate": label + "<extra></extra>",
        "marker": {"size": 6, "color": colour(index)},
        "line": {"color": colour(index)},
    }
    if sigma is not None:
        trace["error_y"] = {"type": "data", "array": sigma, "thickness": 1, "width": 0}
    if text is not None:
        trace["text"] = list(text)
    return trace | more


def line(x: ArrayLike, y: ArrayLike, name: str, index: int, **more: Any) -> Trace:
    """A series of points joined by a line. x, y: (n,)."""
    return points(x, y, name, index, **({"mode": "lines"} | more))


def axes(x: str, y: str, **more: Any) -> dict[str, Any]:
    """Layout with the titles of both axes."""
    return {"xaxis": {"title": {"text": x}}, "yaxis": {"title": {"text": y}}} | more


def _plain(value: Any, key: str = "") -> Any:
    """Plain values for JSON: rounded numbers, null for those that are not finite, text as text."""
    if isinstance(value, float):  # nearly all of them are
        return float(f"{value:.{DIGITS}g}") if isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(k): _plain(v, str(k)) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist(), key)
    if isinstance(value, list | tuple):
        return [_plain(v, key) for v in value]
    if isinstance(value, str):
        return value if key in MARKUP else value.replace("&", "&amp;").replace("<", "&lt;")
    if isinstance(value, bool) or value is None or isinstance(value, int):
        return value
    return _plain(float(value))
