"""What follows a diagnosis that leaves several causes: the recording that separates them, how it
comes, and the diagnosis of all recordings together. It is `tiltcal investigate`, step by step.
"""

import csv
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from nicegui import ui

from tiltcal.app import commands
from tiltcal.app.elements import (
    Section,
    Table,
    Upload,
    action,
    choice,
    entry,
    follow,
    heading,
    number,
    problem,
    text,
)
from tiltcal.app.session import FILES, Session
from tiltcal.app.shell import RECORDING, SCENARIO, need
from tiltcal.app.transfers import LARGEST_UPLOAD
from tiltcal.core.read_back import read_json
from tiltcal.core.units import split_unit, unit_sign

BUDGET, RATE, ANGLES, NEW, OUTPUT, SERVED, SIMULATED = (
    f"next.{name}"
    for name in ("budget_s", "rate_deg_s", "angles", "new", "output", "served", "simulated")
)
MORE, STATIC, FOLDER = "diagnose.more", "diagnose.static", "diagnose.folder"
OPEN_VERDICTS = ("ambiguous", "unlisted", "cannot_tell")
"""Verdicts that a further recording may turn into a cause."""
PREDICTED = "predicted.csv"
"""What the amended model says that a recording should have read: none to be diagnosed."""


def folder_of(session: Session) -> str:
    """The folder of the results."""
    return session.text(FOLDER) or "diagnosis"


def diagnosis_name(session: Session) -> str:
    """The file of the diagnosis."""
    return f"{folder_of(session)}/diagnosis.json"


def load_diagnosis(session: Session) -> dict[str, Any] | None:
    """The diagnosis in that folder; None where there is none."""
    return _json(session, diagnosis_name(session), "diagnosis", "tiltcal diagnose")


def _json(session: Session, name: str, what: str, command: str) -> dict[str, Any] | None:
    path = session.workspace.path(name)
    if not path.is_file():
        return None
    need_text = f"the file that `{command}` writes"
    return session.read(name, what, partial(read_json, path, what, need_text))


def diagnosed(session: Session, found: Mapping[str, Any]) -> list[str]:
    """The recordings of a diagnosis that are files of the workspace."""
    folder = session.workspace.folder
    paths = [Path(p) for p in found.get("recordings", ())]
    inside = [p.relative_to(folder).as_posix() for p in paths if p.is_relative_to(folder)]
    return [name for name in inside if session.workspace.path(name).is_file()]


def offered(session: Session, without: Sequence[str]) -> tuple[str, ...]:
    """Recordings that may be diagnosed, without some."""
    names = session.names("recording")
    return tuple(n for n in names if n not in without and Path(n).name != PREDICTED)


def build(session: Session, diagnosed_anew: Callable[[], None]) -> None:
    """The part of the page, below the findings.

    Args:
        session: that it shows.
        diagnosed_anew: called when all recordings were diagnosed together.
    """
    heading("What to record next")
    same = lambda: session.stamp((FOLDER,), diagnosis_name(session))  # noqa: E731
    Section(
        session,
        (FOLDER, FILES),
        lambda: load_diagnosis(session),
        lambda found: _steps(session, found, diagnosed_anew),
        same,
    )


def _steps(session: Session, found: dict[str, Any] | None, then: Callable[[], None]) -> None:
    if found is None:
        need("A diagnosis says whether another recording is needed.")
        return
    if found["verdict"] not in OPEN_VERDICTS:
        text("No further recording is needed: no alternative is left.")
        return
    text(
        "This diagnosis leaves more than one possible cause. Another recording can separate them:"
        " plan it, record it, and diagnose all recordings together."
    )
    heading("1. Plan it", 3)
    _planning(session)
    heading("2. Record it", 3)
    plan = f"{plan_folder(session)}/next_block.json"
    same = lambda: session.stamp((FOLDER,), plan)  # noqa: E731
    Section(session, (FOLDER, FILES), lambda: _plan(session), partial(_recording, session), same)
    heading("3. Diagnose all recordings together", 3)
    _together(session, found, then)


def plan_folder(session: Session) -> str:
    """Where the plan of the next recording is."""
    return f"{folder_of(session)}/next"


def planning(session: Session) -> list[str] | None:
    """The command that plans; None where the scenario is missing."""
    scenario = session.chosen(SCENARIO)
    if not scenario:
        return None
    return commands.design_next(
        diagnosis_name(session),
        scenario,
        plan_folder(session),
        budget_s=session.number(BUDGET, 300.0),
        rate_deg_s=session.number(RATE, 20.0),
        angles=session.text(ANGLES).split(),
    )


def _planning(session: Session) -> None:
    with ui.element("div").classes("fields"):
        number(session, BUDGET, "At most this table time, s", 300.0, least=1, most=1e6)
        number(session, RATE, "Turning rate, °/s", 20.0, least=1e-3, most=1e6)
        entry(session, ANGLES, "Limits of the axes, °", hint="outer=-45:45 inner=0:90")
    keys = (BUDGET, RATE, ANGLES, SCENARIO, FOLDER, FILES)
    missing = "Choose the scenario that was diagnosed."
    action(session, "Plan the next recording", keys, lambda: planning(session), missing=missing)


@dataclass(frozen=True)
class Planned:
    """A plan of this diagnosis.

    Args:
        about: content of next_block.json.
        steps: of the sequence, by column; none where no block separates anything.
    """

    about: Mapping[str, Any]
    steps: Sequence[Mapping[str, str]]


def _plan(session: Session) -> Planned | None:
    name = f"{plan_folder(session)}/next_block.json"
    about = _json(session, name, "plan", "tiltcal design --split")
    if about is None:
        return None
    plan = session.workspace.path(name)
    of = session.workspace.path(diagnosis_name(session))
    if plan.stat().st_mtime_ns < of.stat().st_mtime_ns:  # of an earlier diagnosis
        return None
    if about["block"] is None:
        return Planned(about, ())
    with session.workspace.path(sequence_name(session)).open(encoding="utf-8") as file:
        return Planned(about, list(csv.DictReader(file)))


def sequence_name(session: Session) -> str:
    """The file of the steps."""
    return f"{plan_folder(session)}/sequence.csv"


def _recording(session: Session, plan: Planned | None) -> None:
    if plan is None:
        need("Plan it first.")
        return
    text(str(plan.about["statement"]), "lead")
    if not plan.steps:
        return
    used = [k for k in plan.steps[0] if any(row[k] for row in plan.steps)]
    Table([(_label(k), "short") for k in used], [[row[k] for k in used] for row in plan.steps])
    with ui.element("div").classes("links"):
        ui.link("Download the steps", f"/files/{sequence_name(session)}?download=true")
        report = f"/files/{plan_folder(session)}/report.html"
        ui.link("Open the report of the plan", report, new_tab=True)
    text(
        "Let your table do these steps in one recording, and bring its file in step 3; an empty"
        " cell is as before. A table of `tiltcal serve`, or a simulated laboratory, records from"
        " here:"
    )
    _laboratories(session)


def _label(column: str) -> str:
    stem, unit = split_unit(column)
    return f"{stem}, {unit_sign(unit)}" if unit else column


def _laboratories(session: Session) -> None:
    with ui.element("div").classes("fields"):
        entry(session, SERVED, "Address of the table", hint="127.0.0.1:5025")
        others = [n for n in session.names("scenario") if n != session.text(SCENARIO)]
        choice(session, SIMULATED, "Scenario of a simulated laboratory", others)
        key = f"{OUTPUT}.{folder_of(session)}"
        entry(session, key, "Recording to write", _output(session))

    def output() -> str:
        return session.text(key) or _output(session)

    def recording() -> list[str] | None:
        table = session.text(SERVED).strip()
        return commands.record(table, sequence_name(session), output()) if table else None

    def simulating() -> list[str] | None:
        lab = session.chosen(SIMULATED)
        sequence = sequence_name(session)
        return commands.simulate_sequence(lab, sequence, output()) if lab else None

    done = lambda _: session.set(NEW, output())  # noqa: E731
    keys = (SERVED, SIMULATED, key, FILES)
    missing = "Type the address of the table."
    action(session, "Record on the table", keys, recording, done, missing=missing)
    missing = "Choose the scenario of the laboratory."
    action(session, "Record in simulation", keys, simulating, done, missing=missing)


def _output(session: Session) -> str:
    stem = Path(session.text(RECORDING) or "run.csv").stem
    return session.workspace.unused(f"{stem}-next.csv")


def _together(session: Session, found: Mapping[str, Any], then: Callable[[], None]) -> None:
    before = diagnosed(session, found)

    def done() -> None:
        _go_on(session, before)
        then()

    Upload("Drop the new recording here, or choose it:", LARGEST_UPLOAD, partial(_came, session))

    def choose() -> None:
        names = offered(session, before)
        if not names:
            need("There is no further recording in the workspace yet.")
            return
        with ui.element("div").classes("fields"):
            choice(session, NEW, "The new recording", names)

    follow(session, (FILES,), choose, lambda: offered(session, before))
    if not before:
        problem("The recordings of this diagnosis are no longer in the workspace.")
    action(
        session,
        "Diagnose together",
        (NEW, SCENARIO, STATIC, FILES),
        lambda: together(session, before),
        lambda _: done(),
        missing="Choose the new recording.",
    )


def _came(session: Session, name: str) -> None:
    """Take an upload for the new recording, where it is one."""
    if name in session.names("recording"):
        session.set(NEW, name)
    else:
        ui.notify(f"{name} is no recording yet: import it on the page Open.", type="warning")


def together(session: Session, before: Sequence[str]) -> list[str] | None:
    """The command that diagnoses the recordings so far and the new one; None: one is missing."""
    new, scenario = session.chosen(NEW), session.chosen(SCENARIO)
    if not (before and new and scenario) or new in before:
        return None
    folder = following_folder(folder_of(session), len(before) + 1)
    return commands.diagnose([*before, new], scenario, session.chosen(STATIC), folder)


def following_folder(folder: str, count: int) -> str:
    """The folder for a diagnosis of so many recordings: the results so far are kept."""
    return f"{re.sub('-[0-9]+$', '', folder)}-{count}"


def _go_on(session: Session, before: Sequence[str]) -> None:
    """Show the result of all recordings together."""
    new, folder = session.text(NEW), folder_of(session)
    if session.text(RECORDING) not in before:
        session.set(RECORDING, before[0])
    session.set(MORE, [n for n in (*before, new) if n != session.text(RECORDING)])
    session.set(FOLDER, following_folder(folder, len(before) + 1))
