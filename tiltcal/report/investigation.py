"""The report of an investigation: where it ended, what was recorded and why, and how the names of
the findings became fewer.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tiltcal.diagnosis.conclusions.finding import in_words
from tiltcal.diagnosis.investigation.progress_log import Investigation
from tiltcal.report.page import sections, write_page
from tiltcal.report.plots import Plot, axes, line
from tiltcal.report.poses import Pose
from tiltcal.report.scenes import sphere_plot

LEAST = 0.005  # probability of a name that is drawn
MOST_NAMES = 12


def write_investigation(
    state: Investigation,
    answers: Sequence[Mapping[str, Any]],
    path: Path,
    poses: Sequence[Pose] = (),
    table: Plot | None = None,
) -> None:
    """Write the report of an investigation.

    Args:
        state: where it stands.
        answers: diagnosis.json of each diagnosis, the first one first.
        path: of the file; its diagnoses lie next to it.
        poses: of all recordings.
        table: in these poses.
    """
    write_page(
        path,
        "investigation",
        lead=lead(state),
        state=state,
        contents=sections("Recorded", "Names", "Poses" if poses else "", "Record next"),
        steps=_steps(state, answers),
        names=_names(answers),
        findings=[_finding(f) for f in answers[-1]["findings"]] if answers else [],
        scenes=[p for p in (sphere_plot(poses), table) if p is not None],
        unseen=_unseen(answers[-1]) if answers else [],
    )


def lead(state: Investigation) -> str:
    """The result in one sentence."""
    blocks = "block" if len(state.entries) == 1 else "blocks"
    after = f"{len(state.entries)} recorded {blocks} and {state.minutes:.1f} min of table time"
    if state.explained:
        return f"Explained after {after}: the verdict is {state.verdicts[-1]}."
    verdict = state.verdicts[-1].replace("_", " ") if state.verdicts else "not reached"
    return f"Not explained after {after}: the verdict is {verdict}."


def _finding(stored: Mapping[str, Any]) -> dict[str, Any]:
    """A finding of diagnosis.json; what it does not have is empty."""
    return {
        "names": " or ".join(in_words(stored["class"])) or "no named effect",
        "class": stored["class"],
        "statement": stored.get("statement", ""),
        "rivals": stored.get("rivals", ()),
        "next": stored.get("next_measurement", ""),
    }


def _unseen(stored: Mapping[str, Any]) -> list[str]:
    """Effects that recordings cannot show at any size, on any sensor and axis."""
    known = stored.get("undetectable", ())
    shown = {u.get("effect") for u in known if u.get("detectable_size")}
    return list(dict.fromkeys(str(u["effect"]) for u in known if u["effect"] not in shown))


def _steps(state: Investigation, answers: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """A row for each diagnosis, with the block that was recorded for it."""
    entries = [None, *state.entries] if state.given else list(state.entries)
    found = []
    for k, answer in enumerate(answers):
        entry = entries[k] if k < len(entries) else None
        found.append(
            {
                "entry": entry,
                "given": ", ".join(Path(name).name for name in state.given),
                "verdict": answer["verdict"],
                "findings": [_finding(f)["names"] for f in answer["findings"]],
                "report": f"diagnosis_{k if state.given else k + 1}/report.html",
            }
        )
    return found


def _names(answers: Sequence[Mapping[str, Any]]) -> Plot | None:
    """Probability of each name after each diagnosis; None where there are no names."""
    chances = [
        {
            name: max(p, 0.0)
            for f in answer["findings"]
            for name, p in (f.get("names") or {}).items()
        }
        for answer in answers
    ]
    largest: dict[str, float] = {}
    for one in chances:
        for name, p in one.items():
            largest[name] = max(p, largest.get(name, 0.0))
    shown = sorted((n for n in largest if largest[n] >= LEAST), key=lambda n: -largest[n])
    if not shown:
        return None
    steps = list(range(1, len(answers) + 1))
    traces = [
        line(
            steps,
            [one.get(name, 0.0) for one in chances],
            name,
            k,
            mode="lines+markers",
            hover="diagnosis %{x}: probability %{y:.3f}",
        )
        for k, name in enumerate(shown[:MOST_NAMES])
    ]
    layout = axes("diagnosis", "probability", showlegend=True)
    layout["xaxis"]["dtick"], layout["yaxis"]["range"] = 1, [-0.03, 1.03]
    return Plot(
        traces,
        "Probability of each name after each diagnosis.",
        f"Probability of {', '.join(shown[:MOST_NAMES])} after each of {len(steps)} diagnoses",
        layout,
        height=360,
    )
