"""The report of a verification: scenarios, their methods, the limits they were judged by;
parameters against truth, residuals of the dwells by mounting, tilt error before and after.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tiltcal.calibration.result import Calibration
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import ARCSEC, DEG, G0
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.static_poses import Poses, find_poses
from tiltcal.report.page import write_page
from tiltcal.report.plots import Plot, Trace, axes, colour, points
from tiltcal.report.poses import poses_of
from tiltcal.report.scenes import sphere_plot
from tiltcal.report.tables import budget_rows, parameter_rows
from tiltcal.setup.setup import Setup
from tiltcal.validation.acceptance import MethodResult, ScenarioResult, Verification
from tiltcal.validation.accuracy import TiltError

WITHIN = 1.96  # sigma, of 95 % of normal errors


def parameter_figure(calibration: Calibration, truth: Mapping[str, float]) -> Plot | None:
    """Error of each parameter over its standard uncertainty, with the 95 % band; None without
    truth.
    """
    names = [
        n for n in calibration.parameters if n in truth and calibration.parameters[n].sigma > 0
    ]
    if not names:
        return None
    z = [
        (calibration.parameters[n].value - truth[n]) / calibration.parameters[n].sigma
        for n in names
    ]
    outside = sum(abs(x) > WITHIN for x in z)
    band = {
        "type": "rect",
        "xref": "paper",
        "x0": 0,
        "x1": 1,
        "y0": -WITHIN,
        "y1": WITHIN,
        "fillcolor": colour(2),
        "opacity": 0.12,
        "line": {"width": 0},
    }
    text = f"{len(names) - outside} of {len(names)} parameters lie within 1.96 sigma of the truth"
    return Plot(
        [points(names, z, "error", 0, sigma=np.ones(len(z)), hover="%{x}: %{y:.3g} sigma")],
        f"Estimated minus injected, in standard uncertainties: {text}.",
        f"Error of each parameter over its sigma: {text}",
        axes("", "error / sigma", shapes=[band], showlegend=False),
    )


def tilt_figure(tilts: Sequence[tuple[str, TiltError]]) -> Plot:
    """Tilt error before and after, and as predicted by the covariance."""
    names = [name for name, _ in tilts]
    traces: list[Trace] = [
        {
            "type": "bar",
            "orientation": "h",
            "y": names,
            "x": [t.in_arcsec[i] for _, t in tilts],
            "name": part,
            "marker": {"color": colour((1, 0, 2)[i])},
            "hovertemplate": "%{y}<br>%{fullData.name} %{x:.4g} arcsec<extra></extra>",
        }
        for i, part in enumerate(("before", "after", "predicted by the covariance"))
    ]
    before, after = (float(np.median([t.in_arcsec[i] for _, t in tilts])) for i in (0, 1))
    text = f"median {before:.4g} arcsec before, {after:.3g} arcsec after"
    layout = axes("arcsec, rms", "", barmode="group", showlegend=True)
    layout["xaxis"]["type"] = "log"
    layout["yaxis"] |= {"autorange": "reversed"}
    return Plot(
        traces,
        f"Tilt error, rms: {text}.",
        f"Tilt error of {len(tilts)} results before and after calibration: {text}",
        layout,
        height=120 + 55 * len(tilts),
    )


def residual_figures(recording: Recording, setup: Setup, calibration: Calibration) -> list[Plot]:
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
    residual, channels, unit = _residuals(poses, setup, calibration)
    turned = [n for n in setup.rig.kind.turning if n in poses.angles][:1]
    angles = {f"table {name}, °": poses.angles[name] / DEG for name in turned}
    return [
        _scatter(x, residual, channels, title, unit)
        for title, x in {"time, s": middle, **angles}.items()
        if residual.size
    ]


def _residuals(
    poses: Poses, setup: Setup, calibration: Calibration
) -> tuple[Array, list[str], str]:
    sensor = setup.named(calibration.sensors()[0])
    g = setup.site.gravity
    f = calibration.correct(sensor, poses.means, g)
    up, micro = poses.up, 1e-6 * G0
    if np.isnan(up).any() or calibration.method == "norm" or "base.roll" in calibration.parameters:
        if f.shape[1] == 3:
            return (np.linalg.norm(f, axis=1) - g)[:, None] / micro, ["norm"], "µg"
        return f / g / ARCSEC, [f"{a} (bias removed)" for a in sensor.axes], "arcsec"
    return (f - g * up[:, list(sensor.axis_indices)]) / micro, list(sensor.axes), "µg"


def _scatter(x: Array, y: Array, names: Sequence[str], title: str, unit: str) -> Plot:
    hover = f"{title} %{{x:.5g}}<br>%{{y:.4g}} {unit}"
    rms = float(np.sqrt(np.mean(y**2)))
    text = f"{len(x)} dwells, rms {rms:.3g} {unit}"
    return Plot(
        [points(x, y[:, i], name, i, hover=hover) for i, name in enumerate(names)],
        f"Residuals of the dwells over {title}: {text}.",
        f"Residuals of the dwells against {title}: {text}",
        axes(title, f"residual, {unit}", showlegend=True),
    )


def write_report(verification: Verification, path: Path) -> None:
    """Write the report of some scenarios."""
    tilts = [
        (f"{r.scenario.name}: {m.title}", m.tilt)
        for r in verification.results
        for m in r.methods
        if m.tilt is not None
    ]
    write_page(
        path,
        "verification",
        lead=lead(verification),
        sections=[_section(k, r) for k, r in enumerate(verification.results, 1)],
        accepted=verification.accepted,
        seconds=verification.seconds,
        overview=tilt_figure(tilts) if tilts else None,
    )


def lead(verification: Verification) -> str:
    """The result in one sentence."""
    results = verification.results
    accepted = sum(r.accepted for r in results)
    refused = [r.scenario.name for r in results if not r.accepted]
    first = f"{accepted} of {len(results)} scenarios accepted: every limit was met"
    if not refused:
        return f"{first}."
    others = f" and {len(refused) - 3} more" if len(refused) > 3 else ""
    return f"{first} in these; not in {', '.join(refused[:3])}{others}."


def _section(number: int, result: ScenarioResult) -> dict[str, Any]:
    recordings = [] if result.recording is None else [result.recording]
    return {
        "id": f"scenario-{number}",
        "name": result.scenario.name,
        "about": result.scenario.about.strip(),
        "source": result.source,
        "accepted": result.accepted,
        "table": result.scenario.rig.table,
        "effects": [_effect_text(e) for e in result.scenario.effect],
        "methods": [_method(result, m) for m in result.methods],
        "sphere": sphere_plot(poses_of(recordings, result.scenario)),
    }


def _effect_text(table: Any) -> str:
    where = table.sensor or table.axis
    values = ", ".join(
        f"{k} = {v:g}" if isinstance(v, int | float) else f"{k} = {v}"
        for k, v in (table.model_extra or {}).items()
    )
    return f"{table.id}{f' on {where}' if where else ''}: {values}"


def _method(result: ScenarioResult, method: MethodResult) -> dict[str, Any]:
    first = method.calibrations[0] if method.calibrations else None
    notes = first.warnings if first else [method.online.statement] if method.online else []
    figures: list[Any] = []
    if first is not None:
        figures.append(parameter_figure(first, method.truth))
        if result.recording is not None:
            figures += residual_figures(result.recording, result.scenario, first)
    return {
        "title": method.title,
        "accepted": method.accepted,
        "error": method.error,
        "runs": len(method.runs),
        "limits": method.limits,
        "rows": parameter_rows(first, method.truth) if first else [],
        "tests": first.tests if first else [],
        "heldout": first.heldout_shown if first else {},
        "warnings": notes,
        "verdict": method.verdict,
        "equation": first.equation if first else "",
        "budget": budget_rows(method.budget, first) if method.budget and first else [],
        "tilt": method.tilt,
        "figures": [f for f in figures if f is not None],
    }
