"""Figures of a report: parameters against truth, residuals against angle and time, tilt error
before and after.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tiltcal.calibration.result import Calibration
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import ARCSEC, DEG, G0
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.static_poses import find_poses
from tiltcal.setup.setup import Setup
from tiltcal.validation.accuracy import TiltError

COLOURS = ("#2b6cb0", "#c05621", "#2f855a", "#6b46c1", "#b83280", "#4a5568")
_AXIS = {
    "gridcolor": "#ebf0f8",
    "zerolinecolor": "#ebf0f8",
    "zerolinewidth": 2,
    "automargin": True,
    "title": {"standoff": 15},
}
TEMPLATE = {
    "layout": {
        "title": {"x": 0.05},
        "plot_bgcolor": "white",
        "paper_bgcolor": "white",
        "xaxis": _AXIS,
        "yaxis": _AXIS,
    }
}
"""White with a light grid: a named template is ten times as long and is validated for each report.
"""
LAYOUT = {
    "template": TEMPLATE,
    "height": 340,
    "margin": {"l": 60, "r": 20, "t": 40, "b": 50},
    "font": {"family": "system-ui, sans-serif", "size": 13, "color": "#2a3f5f"},
}


def parameter_figure(calibration: Calibration, truth: Mapping[str, float]) -> Any:
    """Error of each parameter over its standard uncertainty, with the 95 % interval; None without
    truth.
    """
    import plotly.graph_objects as go

    names = [
        n for n in calibration.parameters if n in truth and calibration.parameters[n].sigma > 0
    ]
    if not names:
        return None
    z = [
        (calibration.parameters[n].value - truth[n]) / calibration.parameters[n].sigma
        for n in names
    ]
    figure = go.Figure(
        layout=LAYOUT | {"title": "Parameters: estimated minus injected, in standard uncertainties"}
    )
    figure.add_hrect(y0=-1.96, y1=1.96, fillcolor="#2f855a", opacity=0.12, line_width=0)
    figure.add_scatter(
        x=names,
        y=z,
        mode="markers",
        marker={"size": 9, "color": COLOURS[0]},
        error_y={"type": "constant", "value": 1},
    )
    figure.update_yaxes(title="error / sigma", zeroline=True)
    return figure


def tilt_figure(tilts: Sequence[tuple[str, TiltError]]) -> Any:
    """Tilt error before and after, and as predicted by the covariance."""
    import plotly.graph_objects as go

    figure = go.Figure(
        layout=LAYOUT
        | {"title": "Tilt error, rms", "barmode": "group", "height": 140 + 55 * len(tilts)}
    )
    for i, part in enumerate(("before", "after", "predicted by the covariance")):
        figure.add_bar(
            y=[name for name, _ in tilts],
            x=[t.in_arcsec[i] for _, t in tilts],
            orientation="h",
            name=part,
            marker={"color": COLOURS[i]},
        )
    figure.update_xaxes(title="arcsec", type="log")
    figure.update_yaxes(automargin=True, autorange="reversed")
    return figure


def residual_figures(recording: Recording, setup: Setup, calibration: Calibration) -> list[Any]:
    """Residuals of the dwells against time and against the outermost angle, where attitudes are
    known; else of the norm.
    """
    names = calibration.sensors()
    if not names or not setup.named(names[0]).is_accelerometer:
        return []
    try:
        poses = find_poses(recording, setup, setup.named(names[0]))
    except TiltcalError:
        return []
    middle = np.array([(s.start_s + s.end_s) / 2 for s in poses.spans])
    residual, channels, unit = _residuals(
        poses.means, poses.up, poses.sensor.axes, setup, calibration
    )
    figures = [_scatter(middle, residual, channels, "time, s", f"Residuals of the dwells, {unit}")]
    for name, angle in list(poses.angles.items())[:1]:
        figures.append(
            _scatter(
                angle / DEG,
                residual,
                channels,
                f"table {name}, deg",
                f"Residuals of the dwells, {unit}",
            )
        )
    return figures


def _residuals(
    means: Array, up: Array, axes: Sequence[str], setup: Setup, calibration: Calibration
) -> tuple[Array, list[str], str]:
    sensor = setup.named(calibration.sensors()[0])
    g = setup.site.gravity
    f = calibration.correct(sensor, means, g)
    if np.isnan(up).any() or calibration.method == "norm" or "base.roll" in calibration.parameters:
        if f.shape[1] == 3:
            return (np.linalg.norm(f, axis=1) - g)[:, None] / (1e-3 * G0), ["norm"], "mg"
        return f / g / ARCSEC, [f"{a} (bias removed)" for a in axes], "arcsec"
    return (f - g * up[:, list(sensor.axis_indices)]) / (1e-3 * G0), list(axes), "mg"


def _scatter(x: Array, y: Array, names: Sequence[str], x_title: str, title: str) -> Any:
    import plotly.graph_objects as go

    figure = go.Figure(layout=LAYOUT | {"title": title})
    for i, name in enumerate(names):
        figure.add_scatter(
            x=x,
            y=y[:, i],
            name=name,
            mode="markers",
            marker={"size": 8, "color": COLOURS[i % len(COLOURS)]},
        )
    figure.update_xaxes(title=x_title)
    figure.update_yaxes(zeroline=True)
    return figure
