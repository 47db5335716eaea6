"""The channels of a recording over time, thinned out to what a screen shows."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import split_unit, unit_sign
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment
from tiltcal.report.plots import Plot, line

BUCKETS = 1000  # over the width of a plot: a pixel or two each, with its least and largest value
SHADED = "rgba(72, 187, 120, 0.15)"


def thinned(time: Array, values: Array, buckets: int = BUCKETS) -> tuple[Array, Array]:
    """A series with the least and the largest value of each bucket, in their order: nothing that
    stands out is lost.

    Args:
        time: s, increasing, (n,).
        values: (n,); NaN where not sampled.
        buckets: of as many samples each; a series of fewer than two samples in each stays as it is.
    """
    read = np.flatnonzero(~np.isnan(values))
    if len(read) <= 2 * buckets:
        return time[read], values[read]
    shown = values if len(read) == len(values) else values[read]
    width = -(-len(read) // buckets)
    whole = len(read) // width
    inside = shown[: whole * width].reshape(whole, width)
    starts = np.arange(whole) * width
    ends = np.sort([starts + inside.argmin(axis=1), starts + inside.argmax(axis=1)], axis=0)
    rest = shown[whole * width :]
    places = ends.T.ravel()
    if len(rest):
        last = np.sort([rest.argmin(), rest.argmax()]) + whole * width
        places = np.concatenate([places, last])
    kept = read[places]
    return time[kept], values[kept]


def series_plot(
    recording: Recording,
    columns: Sequence[str],
    span: tuple[float, float] | None = None,
    segments: Sequence[Segment] = (),
) -> Plot:
    """Columns of a recording over time, with its dwells as bands.

    Args:
        recording: to show.
        columns: of it, of one unit or of several.
        span: first and last time that is shown, s from the first stamp; all if not given.
        segments: of the recording; dwells are shaded.
    """
    time = recording.time - recording.time[0]
    low, high = span or (0.0, float(time[-1]))
    first, last = np.searchsorted(time, [low, high], side="left")
    rows = slice(max(int(first) - 1, 0), int(last) + 1)
    traces = [
        line(*thinned(time[rows], recording.column(name)[rows]), name, k, hover="%{x:.4f} s, %{y}")
        for k, name in enumerate(columns)
    ]
    units = dict.fromkeys(unit_sign(split_unit(name)[1] or "") for name in columns)
    bands: list[dict[str, Any]] = [
        {
            "type": "rect",
            "xref": "x",
            "yref": "paper",
            "x0": s.start - recording.time[0],
            "x1": s.end - recording.time[0],
            "y0": 0,
            "y1": 1,
            "line": {"width": 0},
            "fillcolor": SHADED,
            "layer": "below",
        }
        for s in segments
        if s.kind == "dwell"
    ]
    layout = {
        "xaxis": {"title": {"text": "time, s"}, "range": [low, high]},
        "yaxis": {"title": {"text": ", ".join(units)}},
        "shapes": bands,
        "showlegend": True,
    }
    text = f"{', '.join(columns)} from {low:.6g} to {high:.6g} s"
    return Plot(traces, f"{text}; dwells are shaded.", text, layout)
