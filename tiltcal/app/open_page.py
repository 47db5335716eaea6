"""*Open*: files of the workspace and published recordings, the proposed import with its reasons,
the channels with what the checks found, and the scenario.
"""

import json
import tomllib
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
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
    Upload,
    action,
    choice,
    entry,
    follow,
    heading,
    number,
    problem,
    text,
    tick,
    watch,
)
from tiltcal.app.session import FILES, Session
from tiltcal.app.shell import RECORDING, SCENARIO, SEGMENTS, need
from tiltcal.app.transfers import LARGEST_UPLOAD
from tiltcal.app.workspace import Entry
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import write_text
from tiltcal.core.units import COLUMN_UNITS
from tiltcal.data_quality.check import Finding
from tiltcal.data_quality.registry import REPAIRS
from tiltcal.recordings.datasets import datasets
from tiltcal.recordings.proposal.statements import (
    Statement,
    notes_of,
    statements_of,
    with_values,
)
from tiltcal.report.series import series_plot, series_traces
from tiltcal.setup.tables import tables

LOG, FINDINGS = "open.log", "open.findings"
FINDING_COLUMNS: Sequence[Column] = (
    ("check", "short"),
    ("channel", "short"),
    ("times", "n"),
    ("finding", "long"),
    ("repair", "short"),
)
MOST_SHOWN = 40  # files listed


def build(session: Session) -> None:
    """The page."""
    with ui.element("div").classes("columns"):
        with ui.element("section"):
            heading("Files")
            label = "Drop a log here, or choose it (at most 1 GiB):"
            Upload(label, LARGEST_UPLOAD, lambda n: opened(session, n))
            _files(session)
        with ui.element("section"):
            heading("Published recordings")
            _published(session)
    follow(session, (LOG, FILES), lambda: _import(session), lambda: _log_known(session))
    heading("Channels and findings")
    Section(
        session,
        (RECORDING, SEGMENTS, FILES, FINDINGS),
        lambda: _inspected(session),
        _channels,
        lambda: (stamp_of(session, RECORDING, SEGMENTS), _is_inspected(session)),
    )
    Section(
        session,
        (RECORDING, FILES),
        lambda: _inspect(session),
        partial(_show_findings, session),
        lambda: stamp_of(session, RECORDING),
    )
    heading("Scenario")
    _scenario(session)


def stamp_of(session: Session, *keys: str) -> Hashable:
    """What changes when another file is chosen by these keys, or the chosen one is written."""
    return session.stamp(keys, *(session.text(key) for key in keys if session.text(key)))


def opened(session: Session, name: str) -> None:
    """Choose a file for what it is."""
    kinds = {e.name: e.kind for e in session.files()}
    kind = kinds.get(name, "other")
    if kind in (RECORDING, SCENARIO, SEGMENTS):
        session.set(kind, name)
    elif kind == "calibration":
        session.set("calibrate.calibration", name)
    elif kind in ("log", "other"):
        session.set(LOG, name)
        mapping = mapping_name(name)
        if mapping not in kinds:
            job = session.run("Propose", commands.propose(name, mapping))
            background_tasks.create(job, name="propose")


def mapping_name(log: str) -> str:
    """Where the mapping of a log is kept."""
    return f"{Path(log).name}.map.toml"


def _files(session: Session) -> None:
    found: list[Entry] = []
    table = Table(
        (("file", ""), ("kind", "short"), ("size", "n"), ("", "unit")),
        (),
        empty="The workspace is empty.",
        pick=lambda i: opened(session, found[i].name),
    )

    def update() -> None:
        found[:] = session.files()[:MOST_SHOWN]
        chosen = {session.text(key) for key in (LOG, RECORDING, SCENARIO)}
        rows = [[e.name, e.kind, *_size(e)] for e in found]
        table.show(rows, [k for k, e in enumerate(found) if e.name in chosen])

    watch(session, (FILES, LOG, RECORDING, SCENARIO), update, table)


def _size(entry: Entry) -> tuple[str, str]:
    if entry.size < 1000:
        return f"{entry.size}", "B"
    if entry.size < 1e6:
        return f"{entry.size / 1e3:.1f}", "kB"
    return f"{entry.size / 1e6:.1f}", "MB"


def _published(session: Session) -> None:
    known = list(datasets().values())
    rows = [
        [d.name, d.title, d.licence, f"{sum(f.bytes for f in d.file) / 1e6:.1f}"] for d in known
    ]

    def get(index: int) -> None:
        words = commands.get_dataset(known[index].name, known[index].name)
        background_tasks.create(session.run("Get", words), name="get")

    columns = (("name", "short"), ("what", "long"), ("licence", "short"), ("MB", "n"))
    Table(columns, rows, pick=get)
    text("A name gets the recording from its owner: the only use of the network.", "soft")
    CommandLine("tiltcal datasets get NAME -o NAME")


@dataclass(frozen=True)
class Proposed:
    """A mapping of the workspace.

    Args:
        name: of its file.
        content: its text.
        statements: its lines.
    """

    name: str
    content: str
    statements: Sequence[Statement]


def _log_known(session: Session) -> Hashable:
    """What changes when another log is chosen, or its mapping comes."""
    log = session.chosen(LOG)
    return log, bool(log) and (session.workspace.folder / mapping_name(log)).is_file()


def _import(session: Session) -> None:
    log = session.chosen(LOG)
    if not log:
        return
    heading(f"Import {Path(log).name}")
    mapping = mapping_name(log)
    topics = (FILES, LOG, "open.repairs")
    if not (session.workspace.folder / mapping).is_file():
        action(session, "Propose", topics, lambda: commands.propose(log, mapping))
        return
    Section(
        session, (), lambda: read_mapping(session, mapping), lambda found: _proposal(session, found)
    )
    with ui.element("div").classes("fields"):
        output = f"open.output.{log}"
        entry(session, output, "Recording to write", _recording_name(session, log))
    follow(session, (RECORDING,), lambda: _repairs(session))

    def words() -> list[str]:
        name = session.text(output) or "run.csv"
        return commands.import_log(log, mapping, name, _wanted_repairs(session))

    keys = tuple(f"open.repair.{name}" for name in REPAIRS)
    action(
        session,
        "Import",
        (output, *topics, *keys),
        words,
        lambda _: session.set(RECORDING, session.text(output)),
    )


def _recording_name(session: Session, log: str) -> str:
    stem = Path(log).stem
    return session.workspace.unused(
        f"{stem}.csv" if Path(log).suffix != ".csv" else f"{stem}_run.csv"
    )


def _wanted_repairs(session: Session) -> list[str]:
    return [name for name in REPAIRS if session.flag(f"open.repair.{name}")]


def _repairs(session: Session) -> None:
    title = "Repairs of the data, where a finding names one"
    with ui.expansion(title).props("dense"), ui.element("div").classes("fields"):
        for name in REPAIRS:
            tick(session, f"open.repair.{name}", name)


def read_mapping(session: Session, name: str) -> Proposed:
    """A mapping with its lines."""
    content = session.workspace.path(name).read_text(encoding="utf-8")
    return Proposed(name, content, statements_of(content))


def save_mapping(session: Session, name: str, changes: Mapping[int, Any]) -> None:
    """Write a mapping with other values on some of its lines, as it is now; by index of the
    line.
    """
    now = read_mapping(session, name)
    values = {s.line: s.value for s in now.statements}
    changed = [(line, value) for line, value in changes.items() if values[line] != value]
    if changed:
        path = session.workspace.path(name)
        write_text(path, with_values(now.content, changed))
        session.set("open.saved", path.stat().st_mtime_ns)


def _proposal(session: Session, found: Proposed) -> None:
    """The lines; what changes in one of them changes in place, in every tab."""
    open_box = ui.element("div")
    cells: dict[int, ui.input] = {}
    with ui.element("div").classes("wide"), ui.element("table").classes("grid"):
        with ui.element("thead"), ui.element("tr"):
            for label in ("part", "key", "value", "reason"):
                with ui.element("th").props('scope="col"'):
                    ui.label(label).classes("in")
        with ui.element("tbody"):
            for statement in found.statements:
                cells[statement.line] = _statement(session, found.name, statement)
    for kind, said in notes_of(found.content):
        text(f"{kind}: {said}", "soft")

    def update(now: Proposed) -> None:
        for s in now.statements:
            cell = cells.get(s.line)
            if cell is not None:
                cell.classes(add="open" if s.open else "", remove="" if s.open else "open")
                if value_of(str(cell.value)) != s.value:
                    cell.set_value(shown_value(s.value))
        _open_values(session, now)

    with open_box:
        Section(session, ("open.saved",), lambda: read_mapping(session, found.name), update)


def _open_values(session: Session, now: Proposed) -> None:
    missing = [s for s in now.statements if s.open]
    if missing:
        count = f"{len(missing)} values" if len(missing) > 1 else "1 value"
        text(f"{count} the file does not tell: fill in what is marked.", "strong")
    _units(session, now.name, missing)


def shown_value(value: Any) -> str:
    """A value as the cell shows it."""
    return value if isinstance(value, str) else json.dumps(value)


def _statement(session: Session, name: str, s: Statement) -> ui.input:
    with ui.element("tr"):
        for content in (s.part, s.key):
            with ui.element("td").classes("short"):
                ui.label(content).classes("in")
        with ui.element("td"):
            control = ui.input(value=shown_value(s.value)).props("dense borderless debounce=400")
            control.props["aria-label"] = f"{s.part} {s.key}"
            control.classes("cell")
            control.on_value_change(
                lambda event: save_mapping(session, name, {s.line: value_of(str(event.value))})
            )
        with ui.element("td").classes("long"):
            ui.label(s.reason).classes("in soft")
    return control


def value_of(typed: str) -> Any:
    """What was typed into a cell, as TOML reads it; a text otherwise."""
    try:
        return tomllib.loads(f"value = {typed}")["value"]
    except tomllib.TOMLDecodeError:
        return typed


def _units(session: Session, name: str, missing: Sequence[Statement]) -> None:
    """One choice of the unit for all axes of a sensor."""
    names = [s for s in missing if s.key == "to"]
    sensors = dict.fromkeys(str(s.value).partition("_")[0] for s in names)
    with ui.element("div").classes("fields"):
        for sensor in sensors:
            mine = [s for s in names if str(s.value).partition("_")[0] == sensor]

            def chosen(event: Any, mine: list[Statement] = mine) -> None:
                unit = str(event.value)
                save_mapping(session, name, {s.line: f"{str(s.value)[:-1]}{unit}" for s in mine})

            made = ui.select(list(COLUMN_UNITS), label=f"Unit of {sensor}", on_change=chosen)
            made.props("dense outlined options-dense").classes("field short")


@dataclass(frozen=True)
class Inspected:
    """A recording, what the checks find in it, and its dwells."""

    recording: tc.Recording
    findings: Sequence[Finding]
    segments: Sequence[tc.Segment]


def _is_inspected(session: Session) -> bool:
    return stamp_of(session, RECORDING) in session.inspected


def _inspected(session: Session) -> Inspected | None:
    """What is drawn: at once without the findings, and again with them when they are known."""
    name = session.chosen(RECORDING)
    if not name:
        return None
    recording = read_recording(session, name)
    findings = _inspect(session) if _is_inspected(session) else ()
    return Inspected(recording, findings or (), read_dwells(session, recording))


def _inspect(session: Session) -> Sequence[Finding] | None:
    name = session.chosen(RECORDING)
    if not name:
        return None
    recording = read_recording(session, name)
    found = session.read(name, "findings", lambda: tc.inspect(recording))
    session.inspected.add(stamp_of(session, RECORDING))
    return found


def read_recording(session: Session, name: str) -> tc.Recording:
    """A recording of the workspace, kept."""
    return session.read(name, "recording", lambda: tc.read(session.workspace.path(name)))


def read_dwells(session: Session, recording: tc.Recording) -> Sequence[tc.Segment]:
    """The segments of the chosen file; none where they are of another recording."""
    from tiltcal.recordings.segment_files import read_segments

    name = session.chosen(SEGMENTS)
    if not name:
        return ()
    try:
        return read_segments(session.workspace.path(name), recording)
    except TiltcalError:
        return ()


def _channels(found: Inspected | None) -> None:
    if found is None:
        need("Choose a recording, or import a log.")
        return
    plot = series_plot(found.recording, found.findings, found.segments)
    Figure(plot, ranged=lambda within: series_traces(found.recording, within))


def _show_findings(session: Session, found: Sequence[Finding] | None) -> None:
    if found is None:
        return
    rows = [[f.kind, ", ".join(f.columns), str(f.count), f.statement, f.repair] for f in found]
    Table(FINDING_COLUMNS, rows, empty="The checks of the data find nothing.")
    CommandLine(f"tc.inspect(tc.read({session.text(RECORDING)!r}))", "in Python")
    if found:
        session.tell(FINDINGS)


def _scenario(session: Session) -> None:
    with ui.element("div").classes("fields"):
        number(session, "init.latitude", "Latitude, °", 48.0, least=-90, most=90)
        number(session, "init.height", "Height, m", 0.0)
        label = "How it is turned: the table, if not as the recording shows"
        choice(session, "init.table", label, list(tables()))
        entry(session, "init.output", "Scenario to write", "bench.toml")
    keys = ("init.latitude", "init.height", "init.table", "init.output", RECORDING)

    def words() -> list[str]:
        return commands.init(
            session.chosen(RECORDING),
            session.number("init.latitude", 48.0),
            session.number("init.height", 0.0),
            session.text("init.table"),
            session.text("init.output") or "bench.toml",
        )

    done = lambda _: session.set(SCENARIO, session.text("init.output"))  # noqa: E731
    action(session, "Make a scenario", keys, words, done)
    Section(
        session,
        (SCENARIO, FILES),
        lambda: _scenario_text(session),
        _edit(session),
        lambda: stamp_of(session, SCENARIO),
    )


def _scenario_text(session: Session) -> tuple[str, str, str]:
    """Name and text of the chosen scenario, and what is wrong with it."""
    name = session.chosen(SCENARIO)
    if not name:
        return "", "", ""
    path = session.workspace.path(name)
    content = path.read_text(encoding="utf-8", errors="replace")
    try:
        session.read(name, "scenario", lambda: tc.load_scenario(path))
    except TiltcalError as error:
        return name, content, str(error)
    return name, content, ""


def _edit(session: Session) -> Any:
    def show(found: tuple[str, str, str]) -> None:
        name, content, wrong = found
        if not name:
            need(
                "A scenario says which sensors there are and how they are turned. Choose one, or"
                " make one: from the recording, or, for the live guide, without any."
            )
            return
        if wrong:
            problem(wrong)
        area = ui.textarea(f"{name}", value=content).props("outlined dense autogrow")
        area.classes("code field wide")

        def save() -> None:
            write_text(session.workspace.path(name), area.value or "")
            session.listed()
            session.tell(SCENARIO)

        ui.button("Save", color=None, on_click=save).props("no-caps dense flat").classes("plain")

    return show
