"""*Calibrate*: the methods that the recording allows, the result with its tests and residuals, the
certificate, and what is made of a calibration.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

from nicegui import background_tasks, ui

import tiltcal as tc
from tiltcal.app import commands
from tiltcal.app.elements import (
    Column,
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
    tick,
)
from tiltcal.app.jobs import Job
from tiltcal.app.open_page import read_dwells, read_recording, stamp_of
from tiltcal.app.session import FILES, Session
from tiltcal.app.shell import RECORDING, SCENARIO, SEGMENTS, need, report_frame
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import signs_in, unit_sign
from tiltcal.report.tables import parameter_rows

METHOD, OPTIONS, BUDGET, OUTPUT, MORE = (
    f"calibrate.{name}" for name in ("method", "options", "budget", "output", "more")
)
CALIBRATION, TRIALS, OTHERS = "calibrate.calibration", "calibrate.trials", "calibrate.others"
CERTIFICATE, DCC = "calibrate.certificate", "calibrate.dcc"
DATA = (RECORDING, SCENARIO, SEGMENTS, MORE)
INPUTS = (*DATA, METHOD, OPTIONS, BUDGET, OUTPUT)
PARAMETERS: Sequence[Column] = (
    ("parameter", "short"),
    ("value", "n"),
    ("σ", "n"),
    ("unit", "unit"),
    ("95 % interval", "n"),
)
TESTS: Sequence[Column] = (("test", "short"), ("", "mark"), ("statement", "long"))
FORMATS = {"c": "h", "px4": "px4.params", "ardupilot": "ardupilot.param"}
"""Ending of the file of each form of `tiltcal export` that a calibration has."""
PLOT_PX = 260
MOST_TEXT = 20_000  # characters of an export that are shown


def build(session: Session) -> None:
    """The page."""
    heading("Method")
    follow(session, (*DATA, TRIALS, METHOD), lambda: _methods(session))
    _inputs(session)
    heading("Result")
    calibrations = partial(session.names, "calibration")
    follow(session, (FILES,), lambda: _choose(session), calibrations)
    Section(
        session,
        (CALIBRATION, *DATA, FILES),
        lambda: _loaded(session),
        _result(session),
        lambda: stamp_of(session, CALIBRATION, RECORDING, SEGMENTS),
    )
    heading("Certificate")
    _certificate(session)
    heading("Compare and combine")
    _others(session)
    heading("Export")
    follow(session, (CALIBRATION,), lambda: _exports(session))


def calibrating(session: Session) -> list[str] | None:
    """The command that calibrates; None where something is missing."""
    recording, scenario = session.chosen(RECORDING), session.chosen(SCENARIO)
    method = session.text(METHOD)
    if not (recording and scenario and method):
        return None
    return commands.calibrate(
        [recording, *(name for name in session.texts(MORE) if name != recording)],
        scenario,
        method,
        session.text(OUTPUT) or "CAL.json",
        options=session.text(OPTIONS).split(),
        dwells=session.chosen(SEGMENTS),
        budget=session.flag(BUDGET),
    )


def _methods(session: Session) -> None:
    recording, scenario = session.chosen(RECORDING), session.chosen(SCENARIO)
    if not (recording and scenario):
        need("Choose a recording and a scenario.")
        return
    words = commands.methods(recording, scenario, session.chosen(SEGMENTS))

    async def run() -> None:
        job = await session.run("Try the methods", [*words, "--json"])
        _keep(session, words, job)

    kept = session.values.get(TRIALS)
    trials = kept["rows"] if isinstance(kept, dict) and kept.get("words") == words else []
    if not trials:
        with ui.element("div").classes("action"):
            button = ui.button("Try the methods", color=None).classes("primary")
            button.props("no-caps unelevated dense")
            button.on_click(lambda: background_tasks.create(run(), name="methods"))
            CommandLine(commands_line(words))
        return
    names = [t["method"] for t in trials]
    chosen = session.text(METHOD)
    Table(
        (("method", "short"), ("", "mark"), ("does, or why it refuses", "long")),
        [[t["method"], t["verdict"], t["reason"] or t["does"]] for t in trials],
        pick=lambda i: session.set(METHOD, names[i]),
        picked=names.index(chosen) if chosen in names else -1,
    )
    CommandLine(commands_line(words))


def commands_line(words: Sequence[str]) -> str:
    """The line that does the same in a shell."""
    from tiltcal.app.jobs import as_command

    return as_command(words)


def _keep(session: Session, words: list[str], job: Job) -> None:
    """Keep what the methods said, and choose one that is good where none was chosen."""
    try:
        rows = json.loads(job.output)
    except ValueError:
        return
    allowed = [t["method"] for t in rows if t["verdict"] != "refused"]
    good = [t["method"] for t in rows if t["verdict"] == "good"]
    if session.text(METHOD) not in allowed and allowed:
        session.set(METHOD, [*good, *allowed][0])
    session.set(TRIALS, {"words": words, "rows": rows})


def _inputs(session: Session) -> None:
    with ui.element("div").classes("fields"):
        entry(session, METHOD, "Method")
        entry(session, OPTIONS, "Options, KEY=VALUE", hint="terms=9")
        entry(session, OUTPUT, "Calibration to write", "CAL.json")
        tick(session, BUDGET, "uncertainty budget")
    recordings = partial(session.names, "recording")
    same = lambda: (recordings(), session.text(RECORDING))  # noqa: E731
    follow(session, (FILES, RECORDING), lambda: _more(session), same)
    action(
        session,
        "Calibrate",
        (*INPUTS, FILES),
        lambda: calibrating(session),
        lambda _: session.set(CALIBRATION, session.text(OUTPUT)),
        missing="Choose a recording, a scenario and a method.",
    )


def _more(session: Session) -> None:
    names = [e.name for e in session.files("recording") if e.name != session.text(RECORDING)]
    if names:
        with ui.element("div").classes("fields"):
            label = "Further recordings of the same set-up"
            choice(session, MORE, label, names, several=True)


def _choose(session: Session) -> None:
    with ui.element("div").classes("fields"):
        names = [e.name for e in session.files("calibration")]
        choice(session, CALIBRATION, "Calibration to look at", names)


@dataclass(frozen=True)
class Result:
    """A calibration with what its recording shows of it.

    Args:
        name: of its file.
        certificate: with poses, where a recording is chosen.
        note: why they are missing.
    """

    name: str
    certificate: tc.Certificate
    note: str = ""


def _loaded(session: Session) -> Result | None:
    from tiltcal.api.certifying import Certificate
    from tiltcal.report.certificate import make_certificate

    name = session.chosen(CALIBRATION)
    if not name:
        return None
    path = session.workspace.path(name)
    calibration = session.read(name, "calibration", lambda: tc.load_calibration(path))
    of = session.chosen(RECORDING)
    if not of:
        made = make_certificate(calibration)
        return Result(name, Certificate.of(made), "Choose the recording for its residuals.")
    recording = read_recording(session, of)
    dwells = read_dwells(session, recording) or None
    try:
        made = make_certificate(calibration, tc.Stated(), recording, None, dwells)
    except TiltcalError as error:
        return Result(name, Certificate.of(make_certificate(calibration)), str(error))
    return Result(name, Certificate.of(made))


def _result(session: Session) -> Any:
    def show(found: Result | None) -> None:
        if found is None:
            need("Calibrate, or choose a calibration of the workspace.")
            return
        calibration = found.certificate.calibration
        text(calibration.headline(), "lead")
        if found.note:
            text(found.note, "soft")
        rows = parameter_rows(calibration, {})
        with ui.element("div").classes("columns"):
            Table(
                PARAMETERS,
                [
                    [r["name"], r["value"], r["sigma"], unit_sign(r["unit"]), r["interval"]]
                    for r in rows
                ],
            )
            tests = [
                [t.name, "passed" if t.passed else "FAILED", signs_in(t.statement)]
                for t in calibration.tests
            ]
            Table(TESTS, tests, empty="This method has no test of its own.")
        for warning in calibration.warnings:
            text(f"Note: {signs_in(warning)}", "soft")
        if found.certificate.poses:
            text("Click a point to see its dwell in the recording.", "soft")
        with ui.element("div").classes("columns"):
            for plot in found.certificate.plots():
                Figure(replace(plot, height=PLOT_PX), picked=_dwell(session, found))
        CommandLine(f'print(tc.load_calibration("{found.name}").headline())', "in Python")

    return show


def _dwell(session: Session, found: Result) -> Any:
    """Where a dwell is clicked, the recording shows it."""

    def clicked(index: int) -> None:
        poses = found.certificate.poses or []
        if index < len(poses):
            session.set("recording.at", [poses[index].start_s, poses[index].end_s])
            ui.navigate.to("/recording")

    return clicked


def _certificate(session: Session) -> None:
    labels = [f for f in fields(tc.Stated) if f.name not in ("number", "traceability")]
    with ui.element("div").classes("fields"):
        for f in labels:
            hint = "YYYY-MM-DD" if f.name in ("date", "issued") else ""
            entry(session, f"stated.{f.name}", f.name.capitalize(), hint=hint)
        entry(session, "stated.traceability", "Traceability")
        entry(session, "stated.number", "Number, if not that of its digest")
    with ui.element("div").classes("fields"):
        entry(session, CERTIFICATE, "Certificate to write, HTML", "certificate.html")
        entry(session, DCC, "Digital certificate (DCC), XML; needs the date", "")
    keys = tuple(f"stated.{f.name}" for f in fields(tc.Stated))

    def words() -> list[str] | None:
        calibrated = calibrating(session)
        if calibrated is None:
            return None
        stated = [(f.name, session.text(f"stated.{f.name}")) for f in fields(tc.Stated)]
        page = session.text(CERTIFICATE) or "certificate.html"
        return commands.certify(calibrated, page, session.text(DCC), stated)

    action(
        session,
        "Certify",
        (*INPUTS, *keys, CERTIFICATE, DCC, FILES),
        words,
        lambda _: session.set("calibrate.shown", session.text(CERTIFICATE)),
        missing="A certificate needs what a calibration needs.",
    )
    same = lambda: stamp_of(session, "calibrate.shown", DCC)  # noqa: E731
    follow(session, ("calibrate.shown", FILES), lambda: _shown(session), same)


def _shown(session: Session) -> None:
    name = session.chosen("calibrate.shown")
    if name:
        report_frame(name, "Calibration certificate")
    dcc = session.chosen(DCC)
    if dcc:
        ui.link(f"Download {dcc}", f"/files/{dcc}?download=true")


def _others(session: Session) -> None:
    calibrations = partial(session.names, "calibration")
    follow(session, (FILES,), lambda: _choose_others(session), calibrations)
    folder, joined = "calibrate.compared", "calibrate.combined"
    with ui.element("div").classes("fields"):
        entry(session, folder, "Folder of the comparison", "compared")
        entry(session, joined, "Combined calibration", "COMBINED.json")

    def names() -> list[str]:
        chosen = [session.chosen(CALIBRATION), *session.texts(OTHERS)]
        return list(dict.fromkeys(name for name in chosen if name))

    def comparing() -> list[str] | None:
        found = names()
        return commands.compare(found, session.text(folder)) if len(found) > 1 else None

    def combining() -> list[str] | None:
        found = names()
        return commands.combine(found, session.text(joined)) if len(found) > 1 else None

    keys = (CALIBRATION, OTHERS, folder, joined, FILES)
    action(session, "Compare", keys, comparing, missing="Choose two calibrations or more.")
    done = lambda _: session.set(CALIBRATION, session.text(joined))  # noqa: E731
    action(session, "Combine", keys, combining, done, missing="Choose two calibrations or more.")
    report = lambda: session.stamp((), f"{session.text(folder)}/report.html")  # noqa: E731
    follow(session, (folder, FILES), lambda: _comparison(session, session.text(folder)), report)


def _choose_others(session: Session) -> None:
    with ui.element("div").classes("fields"):
        names = [e.name for e in session.files("calibration")]
        choice(session, OTHERS, "With these calibrations", names, several=True)


def _comparison(session: Session, folder: str) -> None:
    session.values["calibrate.report"] = f"{folder}/report.html"
    name = session.chosen("calibrate.report")
    if name:
        report_frame(name, "Comparison of calibrations")


def _exports(session: Session) -> None:
    name = session.chosen(CALIBRATION)
    if not name:
        need("Choose a calibration.")
        return
    for form, ending in FORMATS.items():
        output = f"{Path(name).stem}.{ending}"
        action(session, f"Export {form}", (), partial(commands.export, name, form, output))
        same = partial(session.stamp, (), output)
        follow(session, (FILES,), partial(_exported, session, output), same)


def _exported(session: Session, output: str) -> None:
    path = session.workspace.folder / output
    if path.is_file():
        ui.link(f"Download {output}", f"/files/{output}?download=true")
        with ui.expansion(output).props("dense"), ui.element("pre").classes("code"):
            content = path.read_text(encoding="utf-8", errors="replace")[:MOST_TEXT]
            ui.label(content).classes("in")
