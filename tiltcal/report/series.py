"""The channels of a recording over time, with its dwells and its faults, in as many points as a
screen has pixels.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import split_unit, unit_sign
from tiltcal.data_quality.check import Finding
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment, dwells
from tiltcal.report.plots import Plot, Trace, colour, line, points

BUCKETS = 1000  # of the visible range, two points each: a plot is some 1000 px wide
BESIDE = 0.5  # of the visible range drawn on both sides of it, so that panning shows something
ROW_PX = 150  # height of the plot of one sensor
MARGIN_PX = 80
LEGEND_PX = 26  # above the plot of each sensor
MOST_MARKS = 200  # faults that are marked one by one
MOST_BANDS = 400  # dwells that are drawn as bands


def envelope(time: Array, values: Array, buckets: int = BUCKETS) -> tuple[Array, Array]:
    """The least and the greatest reading of each of some stretches of equal rows, in their order:
    what a plot of that many pixels shows of the series.

    Args:
        time: s, (n,).
        values: (n,); NaN where nothing was read.
        buckets: stretches; a series of up to twice as many rows is returned as it is.
    """
    if len(time) <= 2 * buckets:
        return time, values
    starts = np.linspace(0, len(time), buckets, endpoint=False).astype(int)
    some = np.where(np.isnan(values), np.inf, values)
    low = np.minimum.reduceat(some, starts)
    some = np.where(np.isnan(values), -np.inf, values)
    high = np.maximum.reduceat(some, starts)
    middle = starts[: len(starts)] + np.diff([*starts, len(time)]) // 2
    both = np.column_stack([low, high]).ravel()
    both[~np.isfinite(both)] = np.nan
    return np.column_stack([time[starts], time[middle]]).ravel(), both


def visible_rows(recording: Recording, start: float, end: float) -> slice:
    """The rows of a range of time, s, and of what is beside it."""
    more = BESIDE * (end - start)
    first, last = np.searchsorted(recording.time, [start - more, end + more])
    return slice(max(int(first) - 1, 0), int(last) + 1)


def series_traces(
    recording: Recording, within: tuple[float, float] | None = None
) -> Sequence[Trace]:
    """The lines of all channels, always in the same order.

    Args:
        recording: of channels that are numbers.
        within: visible range, s; None: all of it.
    """
    rows = slice(None) if within is None else visible_rows(recording, *within)
    buckets = BUCKETS if within is None else int(BUCKETS * (1 + 2 * BESIDE))
    traces: list[Trace] = []
    for k, names in enumerate(groups_of(recording).values()):
        for index, name in enumerate(names):
            t, v = envelope(recording.time[rows], recording.column(name)[rows], buckets)
            axis = _place(k)
            traces.append(line(t, v, name, index, hover="%{y:.6g} at %{x:.4f} s", **axis))
    return traces


def groups_of(recording: Recording) -> Mapping[str, list[str]]:
    """The channels of each sensor: those of one name and one unit share an axis."""
    found: dict[str, list[str]] = {}
    for name in recording.column_names:
        stem, unit = split_unit(name)
        sensor = stem.partition("_")[0]
        found.setdefault(f"{sensor}, {unit_sign(unit)}" if unit else sensor, []).append(name)
    return found


def series_plot(
    recording: Recording,
    findings: Sequence[Finding] = (),
    segments: Sequence[Segment] = (),
    within: tuple[float, float] | None = None,
    *,
    movable: bool = False,
) -> Plot:
    """All channels, a plot for each sensor above the other, over one time.

    Args:
        recording: to draw.
        findings: of the checks of the data, marked where they are.
        segments: whose dwells are drawn as bands.
        within: visible range, s; None: all of it.
        movable: whether the edges of the bands can be dragged; the page is told.
    """
    groups = groups_of(recording)
    traces = [*series_traces(recording, within), *_marks(recording, findings, groups)]
    layout: dict[str, Any] = {"shapes": [*_bands(segments, movable), *_times(recording, findings)]}
    share = 1 / max(len(groups), 1)
    for k, title in enumerate(groups):
        bottom = 1 - (k + 1) * share
        top = bottom + share * (1 - LEGEND_PX / ROW_PX)
        number = str(k + 1) if k else ""
        layout[f"yaxis{number}"] = {"title": {"text": title}, "domain": [max(bottom, 0.0), top]}
        layout[f"legend{number}"] = {"orientation": "h", "x": 0, "y": top, "yanchor": "bottom"}
    layout["showlegend"] = True
    last = f"y{len(groups)}" if len(groups) > 1 else "y"
    layout["xaxis"] = {"title": {"text": "time, s"}, "anchor": last}
    if within is not None:
        layout["xaxis"]["range"] = list(within)
    still = dwells(segments)
    noted = f"; bands: {len(still)} dwells" if still else ""
    text = f"{len(recording)} rows of {len(recording.column_names)} channels{noted}"
    marked = "; crosses: findings" if findings else ""
    return Plot(
        traces,
        f"{text}{marked}. Drag to pan, turn the wheel to zoom, double-click for all.",
        f"Readings over time: {text}",
        layout,
        height=MARGIN_PX + ROW_PX * max(len(groups), 1),
    )


def _place(k: int) -> dict[str, str]:
    """Axis and legend of the k-th sensor."""
    return {"yaxis": f"y{k + 1}", "legend": f"legend{k + 1}"} if k else {}


def _marks(
    recording: Recording, findings: Sequence[Finding], groups: Mapping[str, list[str]]
) -> list[Trace]:
    """A cross at each row of a finding, on the axis of its channel."""
    axis = {name: k for k, names in enumerate(groups.values()) for name in names}
    traces: list[Trace] = []
    for finding in findings:
        there = [n for n in finding.columns if n in axis]
        for name in there:
            rows = np.asarray(finding.rows, dtype=int)[:MOST_MARKS]
            values = recording.column(name)[rows]
            k = axis[name]
            label = f"{finding.kind}: {name}"
            mark = {"size": 9, "symbol": "x", "color": "var(--bad)"}
            traces.append(points(recording.time[rows], values, label, k, marker=mark, **_place(k)))
    return traces


def _times(recording: Recording, findings: Sequence[Finding]) -> list[dict[str, Any]]:
    """A line across at each finding in the stamps."""
    rows = [r for f in findings if "time_s" in f.columns for r in f.rows[:MOST_MARKS]]
    return [
        {
            "type": "line",
            "xref": "x",
            "yref": "paper",
            "x0": recording.time[r],
            "x1": recording.time[r],
            "y0": 0,
            "y1": 1,
            "line": {"color": "var(--bad)", "width": 1, "dash": "dot"},
        }
        for r in rows[:MOST_MARKS]
    ]


def _bands(segments: Sequence[Segment], movable: bool) -> list[dict[str, Any]]:
    return [
        {
            "type": "rect",
            "xref": "x",
            "yref": "paper",
            "x0": s.start,
            "x1": s.end,
            "y0": 0,
            "y1": 1,
            "fillcolor": colour(2),
            "opacity": 0.13,
            "line": {"width": 0},
            "layer": "above" if movable else "below",
            "editable": movable,
        }
        for s in dwells(segments)[:MOST_BANDS]
    ]
