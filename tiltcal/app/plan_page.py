"""*Plan*: the poses that give most information in a table time, with the sigmas to expect."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from nicegui import ui

from tiltcal.app import commands
from tiltcal.app.elements import (
    CommandLine,
    Section,
    Table,
    action,
    choice,
    entry,
    follow,
    heading,
    number,
    text,
)
from tiltcal.app.jobs import as_command
from tiltcal.app.session import FILES, Session
from tiltcal.app.shell import SCENARIO, need, report_frame
from tiltcal.core.read_back import read_json
from tiltcal.core.units import unit_sign

FOLDER, ANGLES, GRADE, CRITERION, GOALS = (
    f"plan.{n}" for n in ("folder", "angles", "grade", "criterion", "goals")
)
NUMBERS: Mapping[str, tuple[str, float, float, float]] = {
    "budget_s": ("Table time, s", 300.0, 1.0, 1e6),
    "rate_deg_s": ("Rate of moves, °/s", 20.0, 1e-3, 1e6),
    "settle_s": ("Settling time, s", 5.0, 0.0, 1e4),
    "shortest_s": ("Shortest reading, s", 5.0, 0.0, 1e5),
    "longest_s": ("Longest reading, s", 60.0, 0.0, 1e5),
    "range_deg": ("Working range, ±°", 180.0, 0.01, 180.0),
}
"""Label, default and limits of each, as `tiltcal design` has them."""
GRADES = ("precision", "mid_mems", "consumer")
CRITERIA = ("both", "tilt", "D", "A")
EXPORTS = ("steps.csv", "steps.txt", "design.toml", "segments.csv")


def build(session: Session) -> None:
    """The page."""
    heading("Limits and goal")
    with ui.element("div").classes("fields"):
        for name, (label, default, least, most) in NUMBERS.items():
            number(session, f"plan.{name}", label, default, least=least, most=most)
    session.values.setdefault(GRADE, "mid_mems")
    session.values.setdefault(CRITERION, "both")
    with ui.element("div").classes("fields"):
        choice(session, GRADE, "Grade of the instrument", GRADES, clearable=False)
        choice(session, CRITERION, "Criterion", CRITERIA, clearable=False)
        entry(session, ANGLES, "Limits of axes", hint="outer=-45:45 inner=0:90")
        entry(session, GOALS, "Goals, in the least time", hint="accel.bias=30ug U=0.01deg")
        entry(session, FOLDER, "Folder of the plan", "plan")
    entered = (GRADE, CRITERION, ANGLES, GOALS, FOLDER)
    keys = (*(f"plan.{n}" for n in NUMBERS), *entered, SCENARIO, FILES)
    missing = "Choose a scenario."
    action(session, "Design", keys, lambda: designing(session), missing=missing)
    heading("What to expect")
    same = lambda: session.stamp((FOLDER,), f"{_folder(session)}/report.html")  # noqa: E731
    Section(session, (FOLDER, FILES), lambda: _loaded(session), lambda d: _plan(session, d), same)
    heading("Poses and report")
    follow(session, (FOLDER, FILES), lambda: _report(session), same)


def designing(session: Session) -> list[str] | None:
    """The command that designs; None where something is missing."""
    scenario = session.chosen(SCENARIO)
    if not scenario:
        return None
    value = {n: session.number(f"plan.{n}", default) for n, (_, default, *_) in NUMBERS.items()}
    return commands.design(
        scenario,
        _folder(session),
        budget_s=value["budget_s"],
        rate_deg_s=value["rate_deg_s"],
        settle_s=value["settle_s"],
        dwell_s=(value["shortest_s"], value["longest_s"]),
        range_deg=value["range_deg"],
        grade=session.text(GRADE) or "mid_mems",
        criterion=session.text(CRITERION) or "both",
        angles=session.text(ANGLES).split(),
        goals=session.text(GOALS).split(),
    )


def _folder(session: Session) -> str:
    return session.text(FOLDER) or "plan"


def _loaded(session: Session) -> dict[str, Any] | None:
    name = f"{_folder(session)}/design.json"
    path = session.workspace.path(name)
    if not path.is_file():
        return None
    need_text = "the file that `tiltcal design` writes"
    return session.read(name, "design", partial(read_json, path, "design", need_text))


def _plan(session: Session, found: dict[str, Any] | None) -> None:
    if found is None:
        need("Nothing was designed in this folder yet.")
        return
    poses = found["poses"]
    text(
        f"{len(poses)} poses in {found['total_s']:.1f} s of {found['budget_s']:g} s: expected rms"
        f" tilt error per axis {found['tilt_rms_arcsec']:.3g} arcsec;"
        f" efficiency at least {100 * found['efficiency']:.0f} %",
        "lead",
    )
    _goals(found.get("goals") or ())
    with ui.element("div").classes("columns"):
        Table(
            (("parameter", "short"), ("known before", "n"), ("σ after", "n"), ("", "unit")),
            [
                [p["name"], f"{p['prior']:.6g}", f"{p['sigma']:.3g}", unit_sign(p["unit"])]
                for p in found["parameters"]
                if p["interest"]
            ],
        )
        axes = [key for key in poses[0] if key.endswith("_deg")]
        Table(
            (
                ("step", "n"),
                *((f"{a.removesuffix('_deg')}, °", "n") for a in axes),
                ("read, s", "n"),
            ),
            [
                [str(k), *(f"{p[a]:.3f}" for a in axes), f"{p['dwell_s']:.2f}"]
                for k, p in enumerate(poses, start=1)
            ],
        )
    with ui.element("div").classes("links"):
        for name in EXPORTS:
            ui.link(f"Download {name}", f"/files/{_folder(session)}/{name}?download=true")
    CommandLine(
        as_command(["simulate", f"{_folder(session)}/design.toml", "-o", "run.csv"]), "to try it"
    )


def _goals(goals: Sequence[Mapping[str, Any]]) -> None:
    if goals:
        Table(
            (("goal", "short"), ("at most", "n"), ("expected", "n"), ("", "unit"), ("", "mark")),
            [
                [
                    goal["name"],
                    f"{goal['limit']:.4g}",
                    f"{goal['expected']:.3g}",
                    unit_sign(goal["unit"]),
                    "reached" if goal["reached"] else "missed",
                ]
                for goal in goals
            ],
        )


def _report(session: Session) -> None:
    name = f"{_folder(session)}/report.html"
    if Path(session.workspace.folder / name).is_file():
        report_frame(name, "Report of the plan")
    else:
        need("There is no report in this folder yet.")
