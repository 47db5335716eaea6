"""The report of a diagnosis: the result in one sentence, the functional form of each finding,
held-out data before and after, rejected alternatives, the next measurement, what could not be seen.

Its plots show the functional form of each finding, residuals of held-out blocks, and spectra.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.core.units import unit_sign
from tiltcal.diagnosis.conclusions.finding import Diagnosis, Finding, in_words
from tiltcal.diagnosis.conclusions.residual_plots import LawView, Spectrum, View
from tiltcal.effects.curve_coordinates import title_of
from tiltcal.report.page import sections, write_page
from tiltcal.report.plots import LOGARITHMIC, Plot, Trace, axes, colour, line, points
from tiltcal.report.poses import Pose
from tiltcal.report.scenes import sphere_plot

FOLLOWED = {"temperature": "temperature_degC", "tilt": "input", "rate": "input"}
MOVING = ("rate", "time", "move", "sample", "frequency")
"""Coordinates of findings that show while the table moves; of others only standstills are drawn."""
MIN_DWELLS = 6  # fewest standstills that are drawn as points
MOST_CURVES = 4  # plots of one finding
MOST_SPECTRA = 6
WAVES = 12.0  # a curve goes up and down so often, at most
VISIBLE = 1e-3  # of a functional form


def curve_plots(finding: Finding) -> list[Plot]:
    """The functional form of a finding over the coordinate that it follows: deviations at the
    table first, then the channels that show it, each mounting as a series of its own.
    """
    grouped: dict[tuple[str, str, str], list[LawView]] = {}
    for view in finding.laws:
        wanted = view.sensor in finding.sensors and view.axis in finding.axes
        if wanted or not view.sensor:
            grouped.setdefault((view.subject, view.unit, view.sensor), []).append(view)
    order = sorted(grouped, key=lambda key: (bool(key[2]), -_size(grouped[key])))
    plots = [_curve_plot(grouped[key], finding.where.coordinate) for key in order[:MOST_CURVES]]
    return [p for p in plots if p is not None]


def _size(views: Sequence[LawView]) -> float:
    return max(float(np.ptp(view.law)) for view in views)


def _size_text(views: Sequence[LawView], unit: str) -> str:
    """Range of a functional form, or its constant value."""
    largest = max((view.law for view in views), key=lambda values: float(np.abs(values).max()))
    if _size(views) < VISIBLE * float(np.abs(largest).max()):
        return f"{float(np.mean(largest)):.3g} {unit} throughout"
    return f"{_size(views):.3g} {unit} from lowest to highest"


def _curve_plot(views: Sequence[LawView], coordinate: str) -> Plot | None:
    name = views[0].follows or _coordinate_of([view.coordinates for view in views], coordinate)
    if name is None:
        return None
    title, unit = coordinate_title(name), unit_sign(views[0].unit)
    hover = f"{title} %{{x:.4g}}<br>%{{y:.4g}} {unit}"
    standstills = coordinate not in MOVING and all(view.still.sum() >= MIN_DWELLS for view in views)
    traces: list[Trace] = []
    for k, view in enumerate(views):
        shown = view.still if standstills else np.ones(len(view.law), bool)
        traces += _curve_traces(view, name, shown, _where(view, views), 2 * k, hover)
    what = views[0].subject
    peak = _size_text(views, unit)
    return Plot(
        traces,
        f"{what}: the curve over {title.partition(',')[0]}, {peak}.",
        f"Curve of the finding in {what} against {title}: {peak}",
        axes(title, f"{what if views[0].sensor else 'deviation'}, {unit}", showlegend=True),
    )


def _curve_traces(
    view: LawView, coordinate: str, shown: Mask, where: str, index: int, hover: str
) -> Iterator[Trace]:
    """Measured values, the whole curve and its leading form, over a coordinate."""
    order = np.flatnonzero(shown)[np.argsort(view.coordinates[coordinate][shown], kind="stable")]
    u = view.coordinates[coordinate][order]
    if len(view.data):
        sigma, values = view.sigma[order], view.data[order]
        measured = points(u, values, f"measured{where}", index + 1, sigma=sigma, hover=hover)
        yield measured | {"opacity": 0.65}
    whole, leading = view.law[order], view.leading[order]
    completed = not np.allclose(leading, whole, atol=VISIBLE * _size([view]))
    name = f"curve{', with what completes it' if completed else ''}{where}"
    yield _joined(u, whole, name, index, "solid", hover)
    if completed:
        yield _joined(u, leading, f"its leading form alone{where}", index + 3, "dot", hover)


def _joined(u: Array, values: Array, name: str, index: int, dash: str, hover: str) -> Trace:
    """A line where the values are a curve over the coordinate, else points.

    Args:
        u: coordinate, increasing, (n,).
        values: deviation, (n,).
        name: legend.
        index: number of the colour.
        dash: style of the line.
        hover: text at a point.
    """
    path = float(np.abs(np.diff(values)).sum())
    if path < WAVES * float(np.ptp(values)):
        return line(
            u, values, name, index, hover=hover, line={"color": colour(index), "dash": dash}
        )
    symbol = "diamond" if dash == "solid" else "diamond-open"
    marker = {"size": 5, "symbol": symbol, "color": colour(index)}
    return points(u, values, name, index, hover=hover, marker=marker)


def _where(view: LawView | View, views: Sequence[LawView] | Sequence[View]) -> str:
    """Recording and mounting, where there are several."""
    parts = []
    if len({v.recording for v in views}) > 1:
        parts.append(view.recording)
    if len({v.mount for v in views}) > 1:
        parts.append(f"mount {view.mount}")
    return f" ({', '.join(parts)})" if parts else ""


def _coordinate_of(known: Sequence[Mapping[str, Array]], coordinate: str) -> str | None:
    """The coordinate of a picture that shows what a finding follows, by its name with unit; time
    where there is none.
    """
    common = [name for name in known[0] if all(name in one for one in known)]
    wanted = FOLLOWED.get(coordinate, coordinate)
    fitting = [name for name in common if name.startswith(wanted)]
    return next(iter([*fitting, *(n for n in common if n == "time_s"), *common]), None)


def coordinate_title(name: str) -> str:
    """``table_outer_deg`` -> ``outer angle, °``."""
    words, unit = title_of(name)
    return f"{words}, {unit_sign(unit)}" if unit else words


def heldout_plots(views: Sequence[View]) -> list[Plot]:
    """Residuals of held-out blocks over time, before and after: a plot for each channel, each
    recording and mounting as a series of its own.
    """
    channels = list(dict.fromkeys(v.channel for v in views))
    return [_heldout_plot([v for v in views if v.channel == name]) for name in channels]


def _heldout_plot(views: Sequence[View]) -> Plot:
    unit = unit_sign(views[0].unit)
    traces = []
    for k, view in enumerate(v for v in views if "time_s" in v.coordinates):
        where = _where(view, views)
        label = f"%{{x:.4g}} s<br>%{{y:.4g}} {unit}"
        time = view.coordinates["time_s"]
        traces.append(points(time, view.before, f"before{where}", 2 * k + 1, hover=label))
        traces.append(
            points(time, view.after, f"after{where}", 2 * k, sigma=view.sigma, hover=label)
        )
    first, last = (_rms([getattr(v, side) for v in views]) for side in ("before", "after"))
    text = f"rms of the means {first:.3g} {unit} before, {last:.3g} {unit} after"
    return Plot(
        traces,
        f"{views[0].channel}: residual of blocks that were not fitted to; {text}.",
        f"Residual of {views[0].channel} in held-out blocks against time: {text}",
        axes("time, s", f"{views[0].channel}, {unit}", showlegend=True),
        height=280,
    )


def heldout_rows(views: Sequence[View]) -> list[dict[str, str]]:
    """Rms of the held-out residual of each channel and mounting, before and after."""
    return [
        {
            "channel": v.channel,
            "recording": v.recording,
            "mount": v.mount,
            "before": f"{_rms([v.before]):.4g}",
            "after": f"{_rms([v.after]):.4g}",
            "noise": f"{_rms([v.sigma]):.3g}",
            "unit": unit_sign(v.unit),
        }
        for v in views
    ]


def _rms(parts: Sequence[Array]) -> float:
    values = np.concatenate(parts)
    return float(np.sqrt(np.mean(values**2)))


def _names_of(spectra: Sequence[Spectrum]) -> list[str]:
    """Channels, with the number of the recording where several have the channel."""
    channels = [s.channel for s in spectra]
    return [
        f"{name}, recording {channels[: k + 1].count(name)}" if channels.count(name) > 1 else name
        for k, name in enumerate(channels)
    ]


def spectrum_plot(spectra: Sequence[Spectrum]) -> Plot | None:
    """Residual by frequency, before and after; None without any."""
    if not spectra:
        return None
    traces, names = [], _names_of(spectra)
    for k, s in enumerate(spectra[:MOST_SPECTRA]):
        scale = max(float(np.median(s.after[len(s.after) // 2 :])), np.finfo(float).tiny)
        label = "%{x:.3g} Hz<br>%{y:.3g} times its noise"
        thin = {"line": {"dash": "dot", "color": f"var(--c{k % 6})"}}
        traces.append(
            line(s.frequency, s.before / scale, f"{names[k]} before", k, hover=label, **thin)
        )
        traces.append(line(s.frequency, s.after / scale, f"{names[k]} after", k, hover=label))
    shown = ", ".join(names[:MOST_SPECTRA])
    layout = axes("Hz", "rms in the band / its noise", showlegend=True)
    layout["xaxis"] |= LOGARITHMIC
    layout["yaxis"] |= LOGARITHMIC
    return Plot(
        traces,
        "Spectrum of the residual, before (dotted) and after.",
        f"Spectrum of the residual of {shown}, before and after",
        layout,
        height=360,
    )


MEANING = {
    "match": "The recording agrees with the scenario.",
    "explained": "The scenario leaves out physics; every finding has one name.",
    "ambiguous": "The scenario leaves out physics; several effects fit.",
    "unlisted": "The scenario leaves out physics of no listed effect; it is modelled as a curve.",
    "cannot_tell": "The recording, or the check of the answer, leaves no judgement.",
}
SAME_FORM = 0.99  # cosine


def write_diagnosis(
    diagnosis: Diagnosis,
    path: Path,
    sources: str,
    poses: Sequence[Pose] = (),
    table: Plot | None = None,
) -> None:
    """Write the report of one diagnosis.

    Args:
        diagnosis: the answer.
        path: of the file.
        sources: names of its recordings.
        poses: of its recordings.
        table: in these poses.
    """
    write_page(
        path,
        "diagnosis",
        sources=sources,
        d=diagnosis,
        lead=lead(diagnosis),
        meaning=MEANING[diagnosis.verdict],
        contents=sections(
            *("Findings",) * bool(diagnosis.findings),
            "Record next",
            "Held-out data",
            "Poses" if poses else "",
            "Not visible",
            "Noise and residual",
        ),
        findings=[
            {"f": f, "laws": curve_plots(f), "rivals": _alternatives(f)} for f in diagnosis.findings
        ],
        heldout=heldout_plots(diagnosis.views),
        heldout_rows=heldout_rows(diagnosis.views),
        spectrum=spectrum_plot(diagnosis.spectra),
        scenes=[p for p in (sphere_plot(poses), table) if p is not None],
        unseen=_unseen(diagnosis),
        noise=_noise(diagnosis),
        figure=_figure,
    )


def lead(diagnosis: Diagnosis) -> str:
    """The result in one sentence."""
    before, after = (f.heldout_chi2_per_dof for f in (diagnosis.before, diagnosis.after))
    if diagnosis.verdict == "match":
        return "The recording agrees with the scenario."
    if not diagnosis.findings:
        return "The recording does not determine whether the scenario is complete."
    faults = [f for f in diagnosis.findings if f.stage == "data"]
    physics = [f for f in diagnosis.findings if f.stage != "data"]
    parts = [f"the recording has {_list(faults)}"] * bool(faults)
    parts += [f"the scenario leaves out {_list(physics)}"] * bool(physics)
    held = (
        "; chi-square per degree of freedom of held-out data goes from"
        f" {before:.3g} to {after:.3g} with the amended scenario"
        if before is not None and after is not None
        else ""
    )
    text = f"{', and '.join(parts)}{held}."
    if diagnosis.verdict == "cannot_tell":
        return f"Not confirmed: {text}"
    return text[:1].upper() + text[1:]


def _list(findings: Sequence[Finding]) -> str:
    """Findings as text; those of the same text together."""
    counts = Counter(map(_named, findings))
    texts = [f"{name}{f' ({n} times)' if n > 1 else ''}" for name, n in counts.items()]
    return " and ".join(texts)


def _named(finding: Finding) -> str:
    if finding.effect is None:
        what = f"a curve of no listed effect over {finding.where.coordinate}"
        what = " or ".join((what, *finding.names[1:]))
    else:
        what = " or ".join(in_words(finding.names))
    sizes = ", ".join(
        f"{name} {value:.4g} ± {sigma:.2g}"
        for name, (value, sigma) in list(finding.parameters.items())[:2]
    )
    channel = " ".join((*finding.sensors, ", ".join(finding.axes))).strip()
    return f"{what}{f' on {channel}' if channel else ''}{f' ({sizes})' if sizes else ''}"


def _alternatives(finding: Finding) -> list[dict[str, Any]]:
    """The alternatives of a finding, and the reason why each was excluded, or not."""
    rows = []
    for name, cosine, separation in finding.rivals:
        if name in finding.names:
            why = "not excluded: this recording cannot separate it from the finding"
        elif separation > 0:
            form = "nearly the same form" if cosine > SAME_FORM else "another form"
            better = f"{separation / 2:.1f} nats"
            why = f"{form}; the readings are better explained by the finding, by {better}"
        else:
            why = "explains less, or needs more numbers for it"
        chance = finding.name_probability.get(name, 0.0)
        rows.append(
            {"name": name, "p": chance, "cosine": cosine, "separation": separation, "why": why}
        )
    return rows


def _unseen(diagnosis: Diagnosis) -> dict[str, list[dict[str, Any]]]:
    """Effects that were not found: those that are not detectable at all, and the others with the
    size from which they are.
    """
    rows: list[dict[str, Any]] = [
        {
            "effect": u.effect,
            "place": " ".join(part for part in (u.sensor, u.axis) if part),
            "absorbed": u.absorbed,
            "size": _sizes(u.size),
        }
        for u in diagnosis.undetectable
    ]
    rows.sort(key=lambda row: -row["absorbed"])
    return {
        "never": [row for row in rows if not row["size"]],
        "from_size": [row for row in rows if row["size"]],
    }


def _sizes(size: Mapping[str, float]) -> str:
    return ", ".join(f"{k} {v:.3g}" for k, v in list(size.items())[:3])


def _noise(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """The noise of each channel, a row for each of its amplitudes."""
    return [
        {
            "channel": name,
            "kind": kind,
            "value": f"{a.value:.3g}",
            "interval": "" if a.low is None else f"{a.low:.3g} to {a.high:.3g}",
            "unit": c.units[kind],
            "share": f"{100 * c.share:.1f} %",
            "may_be": ", ".join(f"{id} ({p:.2f})" for id, p in c.may_be.items()),
        }
        for name, c in diagnosis.noise.channels.items()
        for kind, a in c.amplitudes.items()
    ]


def _figure(value: float | None, digits: int = 4) -> str:
    """A number as text; a dash where nothing was tested."""
    return "-" if value is None else f"{value:.{digits}f}"
