"""The report of a diagnosis: the result in one sentence, the law of each finding, held-out data
before and after, rejected alternatives, the next measurement, what could not be seen.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tiltcal.diagnosis.conclusions.finding import Diagnosis, Finding, in_words
from tiltcal.report.page import sections, write_page
from tiltcal.report.plots import Plot
from tiltcal.report.poses import Pose
from tiltcal.report.residuals import heldout_plots, heldout_rows, law_plots, spectrum_plot
from tiltcal.report.scenes import sphere_plot

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
        findings=[{"f": f, "laws": law_plots(f), "rivals": _rivals(f)} for f in diagnosis.findings],
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
        return "The recording does not tell whether the scenario is complete."
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
    words = f"{', and '.join(parts)}{held}."
    if diagnosis.verdict == "cannot_tell":
        return f"Not confirmed: {words}"
    return words[:1].upper() + words[1:]


def _list(findings: Sequence[Finding]) -> str:
    """Findings in words; those of the same words together."""
    counts = Counter(map(_named, findings))
    words = [f"{name}{f' ({n} times)' if n > 1 else ''}" for name, n in counts.items()]
    return " and ".join(words)


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
    place = " ".join((*finding.sensors, ", ".join(finding.axes))).strip()
    return f"{what}{f' on {place}' if place else ''}{f' ({sizes})' if sizes else ''}"


def _rivals(finding: Finding) -> list[dict[str, Any]]:
    """The alternatives of a finding, and why each lost, or did not."""
    rows = []
    for name, cosine, separation in finding.rivals:
        if name in finding.names:
            why = "not excluded: this recording cannot tell it from the finding"
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
        }
        for name, c in diagnosis.noise.channels.items()
        for kind, a in c.amplitudes.items()
    ]


def _figure(value: float | None, digits: int = 4) -> str:
    """A number as text; a dash where nothing was tested."""
    return "-" if value is None else f"{value:.{digits}f}"
