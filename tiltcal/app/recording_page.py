"""The recording: its channels with dwells, findings of the data checks, poses, and dwells to leave
out.
"""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from nicegui import ui

import tiltcal as tc
from tiltcal.app.bench import Bench
from tiltcal.app.parts import figure
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import split_unit
from tiltcal.recordings.quality import inspect_recording
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segment_files import write_segments
from tiltcal.recordings.segmentation import Segment
from tiltcal.report.poses import poses_of
from tiltcal.report.scenes import sphere_plot
from tiltcal.report.series import series_plot

MOST_DWELLS = 400  # that are listed


@lru_cache(maxsize=4)
def _read(path: Path, _stamp: float) -> tuple[Recording, list[Segment], list[str]]:
    """A recording, its segments, and what the checks say of it. _stamp: time of the last change."""
    recording = tc.read(path)
    found = [finding.statement for finding in inspect_recording(recording).findings]
    try:
        segments = tc.find_segments(recording)
    except TiltcalError as error:
        segments, found = [], [*found, str(error)]
    return recording, segments, found


def chosen_recording(bench: Bench) -> tuple[Recording, list[Segment], list[str]] | None:
    """The chosen recording, or None with a message on the page."""
    name = bench.workspace.chosen.recording
    if not name:
        ui.label("Choose a recording on the page Open.")
        return None
    path = bench.path(name)
    try:
        return _read(path, path.stat().st_mtime)
    except (TiltcalError, OSError) as error:
        ui.label(str(error)).classes("text-negative")
        return None


def recording_page(bench: Bench) -> None:
    """Channels, findings, poses and dwells."""
    if (found := chosen_recording(bench)) is None:
        return
    recording, segments, findings = found
    ui.label("Findings of the data checks").classes("text-h6")
    for text in findings or ["none"]:
        ui.label(text).classes("text-sm")
    for columns in groups_of(recording):
        _series(recording, columns, segments)
    _poses(bench, recording)
    _dwells(bench, recording, segments)


def groups_of(recording: Recording) -> list[list[str]]:
    """Columns that are drawn together: those of one unit."""
    groups: dict[str, list[str]] = {}
    for name in recording.column_names:
        groups.setdefault(split_unit(name)[1] or name, []).append(name)
    return list(groups.values())


def _series(recording: Recording, columns: Sequence[str], segments: Sequence[Segment]) -> None:
    place = ui.column().classes("w-full gap-0")

    def draw(low: float | None = None, high: float | None = None) -> None:
        span = None if low is None or high is None else (low, high)
        place.clear()
        with place:
            figure(series_plot(recording, columns, span, segments), on_zoom=draw)

    draw()


def _poses(bench: Bench, recording: Recording) -> None:
    name = bench.workspace.chosen.scenario
    if not name:
        return
    try:
        plot = sphere_plot(poses_of([recording], tc.load_scenario(bench.path(name))))
    except TiltcalError as error:
        ui.label(str(error)).classes("text-negative")
        return
    if plot is not None:
        ui.label("Poses").classes("text-h6")
        figure(plot)


def _dwells(bench: Bench, recording: Recording, segments: Sequence[Segment]) -> None:
    """The dwells, each to be left out; the list is what `calibrate --segments` takes."""
    dwells = [s for s in segments if s.kind == "dwell"][:MOST_DWELLS]
    if not dwells:
        return
    ui.label(f"{len(dwells)} dwells").classes("text-h6")
    kept = []
    with ui.element("div").classes("dwells"):
        for k, s in enumerate(dwells, 1):
            begin = s.start - recording.time[0]
            text = f"{k}: {begin:.2f} s, {s.end - s.start:.2f} s long {s.label or ''}"
            kept.append(ui.checkbox(text, value=True).props("dense"))

    name = bench.segments

    def save() -> None:
        marked = [s for s, box in zip(dwells, kept, strict=True) if box.value]
        with bench.path(name).open("w", newline="", encoding="utf-8") as file:
            write_segments(marked, file)
        ui.notify(f"{name} holds {len(marked)} dwells; calibrations of this recording use them")
        bench.draw()

    with ui.row():
        ui.button("Keep the marked dwells", on_click=save).props("dense no-caps")
        if bench.path(name).exists():
            ui.button("Use all again", on_click=lambda: _forget(bench)).props("flat dense no-caps")


def _forget(bench: Bench) -> None:
    bench.path(bench.segments).unlink(missing_ok=True)
    bench.draw()
