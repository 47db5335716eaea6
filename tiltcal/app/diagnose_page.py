"""*Diagnose*: what the scenario leaves out, with the progress of the search, a card for each
finding, and the amended model applied to the recording.
"""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from nicegui import background_tasks, ui

import tiltcal as tc
from tiltcal.app import commands, next_recording
from tiltcal.app.elements import (
    CommandLine,
    Figure,
    Section,
    Table,
    action,
    choice,
    entry,
    follow,
    heading,
    text,
)
from tiltcal.app.jobs import as_command
from tiltcal.app.next_recording import (
    FOLDER,
    MORE,
    PREDICTED,
    STATIC,
    folder_of,
    load_diagnosis,
    offered,
)
from tiltcal.app.open_page import read_recording, stamp_of
from tiltcal.app.session import FILES, Session
from tiltcal.app.shell import RECORDING, SCENARIO, need, report_frame
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import PARAMETER_UNITS, signs_in, split_unit, unit_sign
from tiltcal.diagnosis.hypotheses.priors import UNLISTED
from tiltcal.effects import CATALOGUE
from tiltcal.report.diagnosis import MEANING
from tiltcal.report.series import series_plot, series_traces

INPUTS = (RECORDING, SCENARIO, MORE, STATIC, FOLDER)
SHOWN_PROBABILITY = 0.005  # of an alternative, as in the report


def build(session: Session) -> None:
    """The page."""
    heading("Recordings and scenario")
    recordings = lambda: (session.names("recording"), session.text(RECORDING))  # noqa: E731
    follow(session, (FILES, RECORDING), lambda: _inputs(session), recordings)
    with ui.element("div").classes("fields"):
        entry(session, FOLDER, "Folder of the results", "diagnosis")
    action(
        session,
        "Diagnose",
        (*INPUTS, FILES),
        lambda: diagnosing(session),
        lambda _: _apply(session),
        missing="Choose a recording and a scenario.",
    )
    heading("Findings")
    found = partial(_stamp, session, "diagnosis.json")
    Section(
        session,
        (FOLDER, FILES),
        lambda: load_diagnosis(session),
        _findings,
        found,
    )
    next_recording.build(session, partial(_apply, session))
    heading("The amended model on the recording")
    Section(
        session,
        (FOLDER, RECORDING, FILES),
        lambda: _residual(session),
        lambda residual: _left(session, residual),
        lambda: (_stamp(session, PREDICTED), stamp_of(session, RECORDING)),
    )
    heading("Report")
    report = partial(_stamp, session, "report.html")
    follow(session, (FOLDER, FILES), lambda: _report(session), report)


def _stamp(session: Session, name: str) -> Hashable:
    """What changes when a file of the results does."""
    return session.stamp((FOLDER,), f"{folder_of(session)}/{name}")


def diagnosing(session: Session) -> list[str] | None:
    """The command that diagnoses; None where something is missing."""
    recording, scenario = session.chosen(RECORDING), session.chosen(SCENARIO)
    if not (recording and scenario):
        return None
    more = [name for name in session.texts(MORE) if name != recording]
    folder = folder_of(session)
    return commands.diagnose([recording, *more], scenario, session.chosen(STATIC), folder)


def predicted_name(session: Session) -> str:
    """The file of what the amended model predicts."""
    return f"{folder_of(session)}/{PREDICTED}"


def predicting(session: Session) -> list[str]:
    """The command that applies the amended model to the recording."""
    amended = f"{folder_of(session)}/amended.toml"
    return commands.predict(amended, session.chosen(RECORDING), predicted_name(session))


def _apply(session: Session) -> None:
    background_tasks.create(session.run("Apply the amended model", predicting(session)))


def _inputs(session: Session) -> None:
    others = offered(session, [session.text(RECORDING)])
    if others:
        with ui.element("div").classes("fields"):
            choice(session, MORE, "Further recordings, explained together", others, several=True)
            choice(session, STATIC, "Recording at standstill, for the noise", others)


def _findings(found: dict[str, Any] | None) -> None:
    if found is None:
        need("Nothing was diagnosed in this folder yet.")
        return
    names = [Path(p).name for p in found.get("recordings", ())]
    text(f"Diagnosed: {', '.join(names)}", "soft")
    with ui.element("p").classes("verdict"):
        ui.label(str(found["verdict"]).replace("_", " ")).classes("in")
    text(MEANING.get(found["verdict"], ""), "soft")
    text(signs_in(str(found["statement"])), "lead")
    for number, finding in enumerate(found["findings"], start=1):
        _card(number, finding)
    for note in found["notes"]:
        text(f"Note: {note}", "soft")


def _card(number: int, f: Mapping[str, Any]) -> None:
    with ui.element("article").classes("card"):
        heading(f"{number}. {title_of(f['effect'] or UNLISTED)}", 3)
        text(signs_in(str(f["statement"])))
        where = f["where"]
        channel = " ".join([*f["sensors"], ", ".join(f["axes"])]).strip()
        text(f"On {channel or f['stage']}, following {where['coordinate']}.", "soft")
        sizes = [
            (name, value["value"], value["sigma"])
            for name, value in (f["parameters"] or {}).items()
        ]
        if sizes:
            rows = [_size(*size) for size in sizes]
            Table((("parameter", "short"), ("value", "n"), ("σ", "n"), ("", "unit")), rows)
        names = {k: p for k, p in (f.get("names") or {}).items() if p >= SHOWN_PROBABILITY}
        if len(names) > 1:
            rows = [[title_of(name), name, f"{p:.3f}"] for name, p in names.items()]
            Table((("may be", "long"), ("id", "short"), ("probability", "n")), rows)
        if f["next_measurement"]:
            text(f"Record next: {f['next_measurement']}", "strong")


def title_of(effect: str) -> str:
    """An effect in words."""
    return CATALOGUE[effect].title if effect in CATALOGUE else "Nothing that the catalogue lists"


def _size(key: str, value: float, sigma: float) -> list[str]:
    """A parameter of a finding as cells. value, sigma: in the unit of the key."""
    name, unit = split_unit(key, PARAMETER_UNITS)
    return [name, f"{value:.5g}", f"{sigma:.2g}", unit_sign(unit or "")]


@dataclass(frozen=True)
class Applied:
    """The recording less what the amended model predicts, and the rms of each channel.

    Args:
        residual: of the readings.
        rms: channel, rms and unit.
    """

    residual: tc.Recording
    rms: Sequence[tuple[str, str, str]]


def _residual(session: Session) -> Applied | None:
    recording, name = session.chosen(RECORDING), predicted_name(session)
    if not recording or not session.workspace.path(name).is_file():
        return None
    measured, predicted = read_recording(session, recording), read_recording(session, name)
    residual = tc.residual(measured, predicted)
    rms = []
    for column in residual.column_names:
        stem, unit = split_unit(column)
        value = float(np.sqrt(np.nanmean(residual.column(column) ** 2)))
        rms.append((stem, f"{value:.4g}", unit_sign(unit or "")))
    return Applied(residual, rms)


def _left(session: Session, found: Applied | None) -> None:
    if found is None:
        need("It is applied as soon as a diagnosis has ended.")
        return
    plot = series_plot(found.residual)
    Figure(plot, ranged=lambda within: series_traces(found.residual, within))
    columns = (("channel", "short"), ("rms of the residual", "n"), ("", "unit"))
    Table(columns, found.rms)
    CommandLine(as_command(predicting(session)))


def _report(session: Session) -> None:
    name = f"{folder_of(session)}/report.html"
    try:
        there = session.workspace.path(name).is_file()
    except TiltcalError:
        there = False
    if there:
        report_frame(name, "Report of the diagnosis")
    else:
        need("There is no report in this folder yet.")
