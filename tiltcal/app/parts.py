"""Parts of pages: tables, plots, command lines, reports, verdicts."""

import json
from collections.abc import Callable, Sequence
from typing import Any

from nicegui import ui

from tiltcal.app.workspace import as_command
from tiltcal.report.plots import PALETTE, Plot

# seen on light and on dark paper
COLOURS = ("#3182ce", "#dd6b20", "#38a169", "#805ad5", "#d53f8c", "#718096")
GRID = "rgba(128, 128, 128, 0.25)"
VERDICTS = {"good": "positive", "match": "positive", "explained": "positive", "suspect": "warning"}


def drawn(plot: Plot, pans: bool = False) -> dict[str, Any]:
    """A plot of a report as plotly draws it here. pans: whether dragging moves the range."""
    text = plot.to_json()
    for name, hex_code in zip(PALETTE, COLOURS, strict=True):
        text = text.replace(name, hex_code)
    found = json.loads(text)
    layout = found["layout"]
    if layout.pop("sphere", False):
        found["data"] += _body()
    axis = {"gridcolor": GRID, "zerolinecolor": GRID}
    layout |= {
        "paper_bgcolor": "rgba(0, 0, 0, 0)",
        "plot_bgcolor": "rgba(0, 0, 0, 0)",
        "font": {"color": "#718096"},
        "height": plot.height,
        "margin": {"l": 60, "r": 10, "t": 30, "b": 45},
        "legend": {"orientation": "h", "y": 1.12},
        "xaxis": axis | layout.get("xaxis", {}),
        "yaxis": axis | layout.get("yaxis", {}),
        "dragmode": "pan" if pans else layout.get("dragmode", "zoom"),
    }
    # responsive: a plot whose page is left would be resized out of sight, which is an error
    config = {"displaylogo": False, "responsive": False, "scrollZoom": pans}
    return {"data": found["data"], "layout": layout, "config": config}


def figure(plot: Plot, on_zoom: Callable[[float, float], None] | None = None) -> ui.plotly:
    """A plot of a report.

    Args:
        plot: to show.
        on_zoom: is called with the ends of the range that is looked at.
    """
    shown = ui.plotly(drawn(plot, on_zoom is not None))
    shown.classes("w-full").props(f'role=img aria-label="{_attribute(plot.alternative)}"')
    ui.label(plot.caption).classes("text-xs text-gray-500")
    if on_zoom is not None:
        shown.on("plotly_relayout", lambda event: _zoomed(event.args, on_zoom))
    return shown


def _zoomed(told: dict[str, Any], on_zoom: Callable[[float, float], None]) -> None:
    ends = told.get("xaxis.range[0]"), told.get("xaxis.range[1]")
    if isinstance(ends[0], int | float) and isinstance(ends[1], int | float):
        on_zoom(float(ends[0]), float(ends[1]))


def _body() -> list[dict[str, Any]]:
    """The axes of the body."""
    found = []
    for k, name in enumerate("xyz"):
        end = [0.0, 0.0, 0.0]
        end[k] = 1.2
        found.append(
            {
                "type": "scatter3d",
                "mode": "lines+text",
                "showlegend": False,
                "x": [0, end[0]],
                "y": [0, end[1]],
                "z": [0, end[2]],
                "text": ["", name],
                "line": {"color": "#718096"},
                "hoverinfo": "skip",
            }
        )
    return found


def _attribute(text: str) -> str:
    """A text within double quotes of an attribute."""
    return text.replace("\\", "").replace('"', "'")


def table(columns: Sequence[str], rows: Sequence[Sequence[str]], numbers: int = 0) -> None:
    """A table of texts.

    Args:
        columns: titles.
        rows: of texts.
        numbers: how many columns, from the second one on, are aligned as numbers.
    """
    heads = [
        {
            "name": str(k),
            "label": title,
            "field": str(k),
            "align": "right" if 0 < k <= numbers else "left",
        }
        for k, title in enumerate(columns)
    ]
    cells = [{str(k): text for k, text in enumerate(row)} for row in rows]
    shown = ui.table(columns=heads, rows=cells, row_key="0").props("flat dense wrap-cells")
    shown.classes("w-full tabular")


def command_line(*words: str) -> None:
    """The command that does the same, to be copied."""
    text = as_command(words)
    with ui.row().classes("items-center no-wrap w-full gap-1"):
        copy = ui.button(icon="content_copy", on_click=lambda: ui.clipboard.write(text))
        copy.props('flat dense size=sm aria-label="Copy as command" title="Copy as command"')
        ui.label(text).classes("text-xs font-mono command").mark("command")


def verdict(word: str, more: str = "") -> None:
    """A verdict as a badge, with a sentence."""
    with ui.row().classes("items-center"):
        ui.badge(word.replace("_", " "), color=VERDICTS.get(word, "negative")).mark("verdict")
        if more:
            ui.label(more)


def page_of(name: str, title: str) -> None:
    """A report of the workspace, with a link that opens it alone."""
    ui.link(f"Open the {title}", f"/file/{name}", new_tab=True)
    frame = ui.element("iframe").classes("w-full report")
    frame.props(f'src="/file/{name}" title="{title}" sandbox="allow-scripts" loading=lazy')


def notes(texts: Sequence[str]) -> None:
    """Sentences as a list."""
    for text in texts:
        ui.label(f"• {text}").classes("text-sm")
