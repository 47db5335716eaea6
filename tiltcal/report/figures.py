"""Plots for paper: the plots of a report drawn by matplotlib, as SVG and PDF.

A plot is drawn from the same data and layout as in the page: ``plots.Plot``. Width 160 mm, the
text width of an A4 page; text stays text.
"""

import io
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.figure_folder import figure_folder
from tiltcal.core.files import replacing
from tiltcal.report.plots import Plot, Trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS = ("svg", "pdf")
WIDTH_MM = 160.0
MM = 1 / 25.4  # in
PIXEL = 1 / 96  # in, of CSS
PRINTED = {
    "var(--c0)": "#2b6cb0",
    "var(--c1)": "#c05621",
    "var(--c2)": "#2f855a",
    "var(--c3)": "#6b46c1",
    "var(--c4)": "#b83280",
    "var(--c5)": "#4a5568",
    "var(--ink)": "#010101",
    "var(--soft)": "#4a5567",
    "var(--line)": "#cbd5e0",
}
"""Colours of the style of a printed page; each stands for one variable only."""
DASHES = {"solid": "-", "dot": ":", "dash": "--", "dashdot": "-."}
SYMBOLS = {"circle": "o", "diamond": "D", "square": "s", "cross": "P", "x": "X"}
STYLE: dict[Any, Any] = {
    "font.size": 8,
    "font.family": "sans-serif",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.edgecolor": PRINTED["var(--soft)"],
    "axes.linewidth": 0.6,
    "grid.color": PRINTED["var(--line)"],
    "grid.linewidth": 0.4,
    "lines.linewidth": 1.1,
    "legend.frameon": False,
    "svg.fonttype": "none",
    "svg.hashsalt": "tiltcal",
    "pdf.fonttype": 42,
    "text.parse_math": False,
    "text.color": PRINTED["var(--ink)"],
    "axes.labelcolor": PRINTED["var(--ink)"],
    "xtick.color": PRINTED["var(--ink)"],
    "ytick.color": PRINTED["var(--ink)"],
}
MOST_CHARACTERS = 75  # 130 mm of 8 points: longer labels below an axis are slanted
MOST_VECTORS = 5000  # markers of a series that are drawn one by one: 0.5 MB of SVG


def save_figures(plots: Sequence[Plot], page: str) -> None:
    """Write the plots of a page into the folder that the command names, if it names one.

    Args:
        plots: of the page, in their order.
        page: its kind, the beginning of the file names.

    Raises:
        TiltcalError: a file cannot be written.
    """
    folder = figure_folder()
    if folder is None or not plots:
        return
    folder.pages[page] = folder.pages.get(page, 0) + 1
    number = f"-{folder.pages[page]}" if folder.pages[page] > 1 else ""
    folder.path.mkdir(parents=True, exist_ok=True)
    for k, plot in enumerate(plots, start=1):
        for format in FORMATS:
            path = folder.path / f"{page}{number}-{k:02d}.{format}"
            with replacing(path) as temporary:
                Path(temporary).write_bytes(drawn(plot, format))
            folder.written.append(path)


def inline_svg(plot: Plot, width_mm: float, number: int) -> str:
    """A plot as an SVG element of a page, in the colours of the page.

    Args:
        plot: to draw.
        width_mm: of the element.
        number: of the plot on its page: makes its ids its own.
    """
    text = drawn(plot, "svg", width_mm).decode("utf-8")
    text = re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
    text = re.sub(r' xmlns(:xlink)?="[^"]*"', "", text)
    text = re.sub(r'( id="|"#|url\(#)', rf"\g<1>still{number}-", text)
    for variable, colour in PRINTED.items():
        text = text.replace(colour, variable)
    return text


def drawn(plot: Plot, format: str, width_mm: float = WIDTH_MM) -> bytes:
    """A plot as the contents of a file.

    Args:
        plot: to draw.
        format: svg or pdf.
        width_mm: of the figure.
    """
    out = io.BytesIO()
    with _style():
        made: dict[str, str | None] = {"Date": None} if format == "svg" else {"CreationDate": None}
        made["Title"] = plot.alternative
        _figure(plot, width_mm).savefig(out, format=format, metadata=made)
    return out.getvalue()


@contextmanager
def _style() -> Iterator[None]:
    import matplotlib as mpl

    with mpl.rc_context(STYLE):
        yield


def _figure(plot: Plot, width_mm: float) -> "Figure":
    """The figure of a plot."""
    from matplotlib.figure import Figure

    spatial = any(str(t["type"]).endswith("3d") for t in plot.traces)
    figure = Figure((width_mm * MM, plot.height * PIXEL), layout="constrained")
    ax = figure.add_subplot(projection="3d" if spatial else None)
    if spatial:
        _draw_space(ax, plot)
        return figure
    _scales(ax, plot)
    bars = [t for t in plot.traces if t["type"] == "bar"]
    for k, trace in enumerate(plot.traces):
        if trace["type"] == "bar":
            _draw_bars(ax, trace, bars.index(trace), len(bars))
        else:
            _draw_series(ax, trace, plot.traces[k - 1] if k else trace)
    for shape in plot.layout.get("shapes", ()):
        _draw_shape(ax, shape)
    _limits(ax, plot.layout)
    if plot.layout.get("showlegend", len(plot.traces) > 1):
        figure.legend(loc="outside upper left", ncols=4)
    return figure


def _scales(ax: "Axes", plot: Plot) -> None:
    """Titles, scales and categories of both axes."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    for name in "xy":
        given = plot.layout.get(f"{name}axis", {})
        ax.set(**{f"{name}label": given.get("title", {}).get("text", "")})
        if given.get("type") == "log":
            ax.set(**{f"{name}scale": "log"})
            axis = ax.xaxis if name == "x" else ax.yaxis
            axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axis.set_major_formatter(StrMethodFormatter("{x:g}"))
            axis.set_minor_formatter(NullFormatter())
        texts = [v for t in plot.traces for v in np.ravel(t[name]) if isinstance(v, str)]
        if texts or given.get("type") == "category":
            order = list(given.get("categoryarray", dict.fromkeys(texts)))
            ax.set(**{f"{name}ticks": range(len(order)), f"{name}ticklabels": order})
            if name == "x" and max(map(len, order)) * len(order) > MOST_CHARACTERS:
                ax.tick_params("x", rotation=45)
                for label in ax.get_xticklabels():
                    label.set(ha="right", rotation_mode="anchor")
            ax.__dict__[f"{name}order"] = order


def _limits(ax: "Axes", layout: Mapping[str, Any]) -> None:
    """Ranges and aspect, after everything is drawn."""
    for name in "xy":
        given = layout.get(f"{name}axis", {})
        if "range" in given:
            low, high = given["range"]
            power = given.get("type") == "log"
            ax.set(**{f"{name}lim": (10**low, 10**high) if power else (low, high)})
        elif given.get("rangemode") == "tozero":
            getattr(ax, f"set_{name}lim")(0)
        if given.get("autorange") == "reversed":
            getattr(ax, f"invert_{name}axis")()
    if layout.get("yaxis", {}).get("scaleanchor") == "x":
        ax.set_aspect("equal")


def _positions(ax: "Axes", values: Any, name: str) -> Array:
    """Numbers on an axis; of categories their index."""
    order = ax.__dict__.get(f"{name}order")
    if order is not None:
        return np.array([order.index(v) for v in values], dtype=float)
    return np.array([np.nan if v is None else v for v in values], dtype=float)


def _colour(value: Any) -> Any:
    """A colour as matplotlib reads it."""
    if isinstance(value, list | tuple):
        return [_colour(v) for v in value]
    return PRINTED.get(value, value)


def _draw_series(ax: "Axes", trace: Trace, before: Trace) -> None:
    """Points, a line, a band to the series before, or a map by colour."""
    x, y = _positions(ax, trace["x"], "x"), _positions(ax, trace["y"], "y")
    marker, mode = trace.get("marker", {}), trace.get("mode", "markers")
    named = trace.get("name") or "_nolegend_"
    label = named if trace.get("showlegend", True) else "_nolegend_"
    size = marker.get("size", 6) * 72 * PIXEL
    if isinstance(marker.get("color"), np.ndarray):
        found = ax.scatter(x, y, s=size**2, c=marker["color"], cmap="viridis")
        title = marker.get("colorbar", {}).get("title", {}).get("text", "")
        ax.figure.colorbar(found, ax=ax, label=title)
        return
    line = trace.get("line", {})
    colour = _colour(line.get("color", marker.get("color")))
    if trace.get("fill") == "tonexty":
        low = _positions(ax, before["y"], "y")
        ax.fill_between(x, low, y, color=colour, alpha=0.15, lw=0, label=label)
        return
    symbol = str(marker.get("symbol", "circle"))
    ax.plot(
        x,
        y,
        label=label,
        color=colour,
        linestyle=DASHES[line.get("dash", "solid")] if "lines" in mode else "",
        linewidth=line.get("width", 2) * 0.55,
        marker=SYMBOLS[symbol.removesuffix("-open")] if "markers" in mode else "",
        markersize=size * 0.7,
        markerfacecolor="none" if symbol.endswith("-open") else _colour(marker.get("color")),
        markeredgecolor=_colour(marker.get("color")),
        rasterized=len(x) > MOST_VECTORS,
    )
    if "error_y" in trace:
        bars = trace["error_y"]
        ends = [bars.get("arrayminus", bars["array"]), bars["array"]]
        ends = [np.array(e, dtype=float) for e in ends]
        ax.errorbar(x, y, ends, fmt="none", ecolor=colour, elinewidth=0.7)


def _draw_bars(ax: "Axes", trace: Trace, index: int, count: int) -> None:
    """One series of grouped bars."""
    along, size = ("y", "x") if trace.get("orientation") == "h" else ("x", "y")
    width = 0.8 / count
    at = _positions(ax, trace[along], along) + (index - (count - 1) / 2) * width
    draw = ax.barh if along == "y" else ax.bar
    values = np.array(trace[size], dtype=float)
    draw(at, values, width, color=_colour(trace["marker"]["color"]), label=trace.get("name", ""))


def _draw_shape(ax: "Axes", shape: Mapping[str, Any]) -> None:
    """A level or a band across the plot."""
    colour = _colour(shape.get("fillcolor", shape.get("line", {}).get("color")))
    if shape["type"] == "rect":
        ax.axhspan(shape["y0"], shape["y1"], color=colour, alpha=shape.get("opacity", 1.0), lw=0)
    else:
        dash = DASHES[shape.get("line", {}).get("dash", "solid")]
        ax.axhline(shape["y0"], color=colour, linestyle=dash, linewidth=0.8)


def _draw_space(ax: Any, plot: Plot) -> None:
    """Points on the unit sphere, or solids; seen as the page shows them at first."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    if plot.layout.get("sphere"):
        u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 37), np.linspace(0, np.pi, 13))
        globe = np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)
        ax.plot_wireframe(*globe, color=PRINTED["var(--line)"], linewidth=0.4)
        for k, name in enumerate("xyz"):
            ax.text(*(1.25 * np.eye(3)[k]), name, ha="center", va="center")
    for trace in plot.traces:
        xyz = np.array([trace[k] for k in "xyz"], dtype=float).T
        if trace["type"] == "mesh3d":
            faces = np.array([trace[k] for k in "ijk"], dtype=int).T
            colour = _colour(trace["color"])
            ax.add_collection3d(Poly3DCollection(xyz[faces], facecolor=colour, linewidth=0))
        else:
            colour = _colour(trace["marker"]["color"])
            ax.scatter(*xyz.T, color=colour, s=12, label=trace["name"], depthshade=False)
    for name in "xyz":
        ax.set(**{f"{name}lim": plot.layout["scene"][f"{name}axis"]["range"]})
    ax.set_box_aspect((1, 1, 1), zoom=1.3)
    ax.view_init(elev=24, azim=-45)
    ax.set_axis_off()
    if plot.layout.get("showlegend"):
        ax.figure.legend(loc="outside upper left", ncols=2)
