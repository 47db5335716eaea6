"""*Recording*: the channels with the dwells as bands, which can be moved, labelled, excluded and
split; the poses on the sphere and on the table.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from nicegui import ui

import tiltcal as tc
from tiltcal.app import commands
from tiltcal.app.elements import (
    Figure,
    Section,
    Table,
    action,
    entry,
    heading,
    text,
    tick,
)
from tiltcal.app.open_page import read_dwells, read_recording, stamp_of
from tiltcal.app.session import FILES, Session
from tiltcal.app.shell import RECORDING, SCENARIO, SEGMENTS, dwells_name, need
from tiltcal.core.errors import TiltcalError
from tiltcal.recordings.segment_files import save_segments
from tiltcal.recordings.segmentation import dwells
from tiltcal.report.plots import Plot
from tiltcal.report.series import series_plot, series_traces

AT, PICKED, OUTPUT = "recording.at", "recording.picked", "recording.output"
MOVABLE = "recording.movable"
AROUND = 1.0  # of the length of a dwell, shown on both sides of it


def build(session: Session) -> None:
    """The page."""
    heading("Channels and dwells")
    with ui.element("div").classes("fields"):
        tick(session, MOVABLE, "drag the edges of dwells")
        ui.button("Show all", color=None, on_click=lambda: session.set(AT, None)).props(
            "no-caps dense flat"
        ).classes("plain")
    topics = (RECORDING, SEGMENTS, FILES, MOVABLE, AT)
    chosen = partial(stamp_of, session, RECORDING, SEGMENTS)
    Section(
        session,
        topics,
        lambda: _loaded(session),
        lambda found: _series(session, found),
        lambda: (chosen(), session.stamp((MOVABLE, AT))),
    )
    heading("Dwells")
    with ui.element("div").classes("fields"):
        entry(session, OUTPUT, "List of dwells to write", hint="as the recording")
    action(
        session,
        "Find the dwells",
        (RECORDING, OUTPUT, FILES),
        lambda: finding(session),
        lambda _: session.set(SEGMENTS, _output(session)),
        missing="Choose a recording.",
    )
    Section(
        session,
        (RECORDING, SEGMENTS, FILES, PICKED),
        lambda: _loaded(session),
        lambda found: _dwells(session, found),
        lambda: (chosen(), session.stamp((PICKED,))),
    )
    heading("Poses")
    _pose_section(session)


def _pose_section(session: Session) -> None:
    same = partial(stamp_of, session, RECORDING, SCENARIO)
    Section(session, (RECORDING, SCENARIO, FILES), lambda: _poses(session), _scenes, same)


def finding(session: Session) -> list[str] | None:
    """The command that finds the dwells."""
    recording = session.chosen(RECORDING)
    return commands.segments(recording, _output(session)) if recording else None


def _output(session: Session) -> str:
    return session.text(OUTPUT) or dwells_name(session.text(RECORDING))


@dataclass(frozen=True)
class Loaded:
    """A recording with its segments."""

    recording: tc.Recording
    segments: Sequence[tc.Segment]


def _loaded(session: Session) -> Loaded | None:
    name = session.chosen(RECORDING)
    if not name:
        return None
    recording = read_recording(session, name)
    return Loaded(recording, read_dwells(session, recording))


def _series(session: Session, found: Loaded | None) -> None:
    if found is None:
        need("Choose a recording.")
        return
    at = session.values.get(AT)
    within = None
    if isinstance(at, list) and len(at) == 2:
        more = AROUND * (at[1] - at[0])
        within = (at[0] - more, at[1] + more)
    movable = session.flag(MOVABLE)
    Figure(
        series_plot(found.recording, (), found.segments, within, movable=movable),
        ranged=lambda range_s: series_traces(found.recording, range_s),
        moved=lambda index, start, end: _moved(session, found, index, start, end),
    )


def _dwells(session: Session, found: Loaded | None) -> None:
    if found is None or not session.chosen(SEGMENTS):
        need("Choose a list of dwells, or find them. Without one each method finds its own.")
        return
    still = dwells(found.segments)
    picked = int(session.number(PICKED, -1))
    if 0 <= picked < len(still):
        _editor(session, found, still[picked])
    Table(
        (("dwell", "n"), ("from, s", "n"), ("to, s", "n"), ("length, s", "n"), ("label", "")),
        [
            [str(k), f"{s.start:.3f}", f"{s.end:.3f}", f"{s.end - s.start:.3f}", s.label or ""]
            for k, s in enumerate(still, start=1)
        ],
        empty="No dwell of this list is in the recording.",
        pick=lambda index: session.set(PICKED, index),
        picked=picked,
    )
    name = session.text(SEGMENTS)
    text(f"This list is the file {name}; `tiltcal calibrate --segments {name}` reads it.", "soft")


def _editor(session: Session, found: Loaded, dwell: tc.Segment) -> None:
    key = f"dwell.{dwell.start:.6f}"
    with ui.element("div").classes("fields"):
        start = ui.number("From, s", value=dwell.start, format="%.4f")
        end = ui.number("To, s", value=dwell.end, format="%.4f")
        label = ui.input("Label", value=dwell.label or "", placeholder="+x or [0, 1, 1]")
        at = ui.number("Split at, s", value=(dwell.start + dwell.end) / 2, format="%.4f")
        for control in (start, end, label, at):
            control.props("dense outlined").classes("field short").mark(key)

    def changed() -> Sequence[tc.Segment]:
        given = (label.value or "").strip() or None
        return [replace(dwell, start=start.value, end=end.value, label=given)]

    def split() -> Sequence[tc.Segment]:
        return [replace(dwell, end=at.value), replace(dwell, start=_after(found, at.value))]

    with ui.element("div").classes("action"):
        _button("Save", lambda: _replaced(session, found, dwell, changed()))
        _button("Exclude", lambda: _excluded(session, found, dwell))
        _button("Split", lambda: _replaced(session, found, dwell, split()))
        _button("Show in the plot", lambda: session.set(AT, [dwell.start, dwell.end]))


def _after(found: Loaded, time: float) -> float:
    """The time of the first sample after one."""
    rows = found.recording.time
    row = int(np.searchsorted(rows, time, side="right"))
    return float(rows[min(row, len(rows) - 1)])


def _button(label: str, click: Callable[[], Any]) -> None:
    ui.button(label, color=None, on_click=click).props("no-caps dense flat").classes("plain")


def _replaced(session: Session, found: Loaded, dwell: tc.Segment, by: Sequence[tc.Segment]) -> None:
    """Write the list with other segments in place of one; it stays as it was where they do not fit
    the recording.
    """
    segments = [new for s in found.segments for new in (by if s is dwell else [s])]
    path = session.workspace.path(session.text(SEGMENTS))
    try:
        save_segments(segments, path, found.recording)
    except TiltcalError as error:
        ui.notify(str(error), type="negative", multi_line=True)
        return
    session.listed()


def _excluded(session: Session, found: Loaded, dwell: tc.Segment) -> None:
    session.values[PICKED] = -1
    _replaced(session, found, dwell, [replace(dwell, kind="move")])


def _moved(session: Session, found: Loaded, index: int, start: float, end: float) -> None:
    still = dwells(found.segments)
    if index < len(still):
        _replaced(session, found, still[index], [replace(still[index], start=start, end=end)])


def _poses(session: Session) -> Sequence[Plot]:
    from tiltcal.api.table_scene import table_in
    from tiltcal.report.poses import poses_of
    from tiltcal.report.scenes import sphere_plot

    name, scenario = session.chosen(RECORDING), session.chosen(SCENARIO)
    if not (name and scenario):
        return []
    recording = read_recording(session, name)
    bench = tc.load_scenario(session.workspace.path(scenario))
    poses = session.read(
        name, ("poses", bench.model_dump_json()), lambda: poses_of([recording], bench)
    )
    return [p for p in (sphere_plot(poses), table_in(poses, bench)) if p is not None]


def _scenes(plots: Sequence[Plot]) -> None:
    if not plots:
        text("Choose a recording and a scenario that determine poses.", "soft")
        return
    with ui.element("div").classes("columns"):
        for plot in plots:
            Figure(plot)
