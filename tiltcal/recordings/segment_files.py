"""Files of segments: CSV, as ``tiltcal segments`` writes them and a user edits them."""

import csv
from itertools import pairwise
from pathlib import Path
from typing import TextIO

import numpy as np

from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import replacing, require_document
from tiltcal.core.safe_text import cell_of, text_of
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment, dwells, majority


def write_segments(found: list[Segment], out: TextIO) -> None:
    """Segments as CSV: start_s, end_s, kind, label."""
    rows = [[repr(s.start), repr(s.end), s.kind, cell_of(s.label or "")] for s in found]
    csv.writer(out, lineterminator="\n").writerows([["start_s", "end_s", "kind", "label"], *rows])


def save_segments(found: list[Segment], path: Path, recording: Recording | None = None) -> None:
    """Write segments to a CSV file, whole or not at all.

    Args:
        found: segments.
        path: of the file.
        recording: that they have to fit; None: they come from it.

    Raises:
        TiltcalError: the file cannot be written, or they do not fit: then it stays as it was.
    """
    with replacing(path) as temporary:
        with temporary.open("w", newline="", encoding="utf-8") as out:
            write_segments(found, out)
        if recording is not None:
            read_segments(temporary, recording)


def read_segments(path: Path, recording: Recording) -> list[Segment]:
    """An edited list of segments: start_s, end_s, kind and an optional label.

    Raises:
        TiltcalError: a column is missing, a cell is wrong, or two dwells overlap.
    """
    names, rows = _rows(require_document(path, "segments"))
    missing = {"start_s", "end_s"} - set(names)
    if missing:
        raise TiltcalError(
            f"segments {path.name}",
            found="no column " + ", ".join(sorted(missing)),
            need="start_s, end_s, kind, label",
            do="start from `tiltcal segments -o`",
        )
    found = [
        _segment(row, number, path.name, recording) for number, row in enumerate(rows, start=2)
    ]
    for before, after in pairwise(sorted(dwells(found), key=lambda s: s.start)):
        if after.first < before.last:
            raise TiltcalError(
                f"segments {path.name}",
                found=f"dwells that overlap from {after.start:g} to {before.end:g} s",
                need="each sample in one dwell",
                do="correct their times",
            )
    return found


def _rows(path: Path) -> tuple[list[str], list[dict[str, str]]]:
    """Column names and rows of a CSV file."""
    try:
        with path.open(newline="", encoding="utf-8-sig", errors="replace") as lines:
            reader = csv.DictReader(lines)
            return list(reader.fieldnames or ()), list(reader)
    except csv.Error as error:
        raise TiltcalError(
            f"segments {path.name}", found=str(error), need="a CSV table", do="check the file"
        ) from error


def _segment(row: dict[str, str], line: int, source: str, recording: Recording) -> Segment:
    kind = (row.get("kind") or "dwell").strip()
    try:
        start, end = float(row["start_s"]), float(row["end_s"])
    except (TypeError, ValueError) as error:
        raise TiltcalError(
            f"segments {source}, line {line}",
            found=str(error),
            need="two times in s",
            do="correct that line",
        ) from error
    if kind not in ("dwell", "move") or not end >= start:  # a move may be one sample
        raise TiltcalError(
            f"segments {source}, line {line}",
            found=f"{kind} from {start:g} to {end:g} s",
            need="dwell or move, end after start",
            do="correct that line",
        )
    first, last = (
        int(i) for i in np.searchsorted(recording.time, [start, np.nextafter(end, np.inf)])
    )
    if last == first:
        raise TiltcalError(
            f"segments {source}, line {line}",
            found=f"no sample from {start:g} to {end:g} s",
            need=f"times within the recording, {recording.time[0]:g} to {recording.time[-1]:g} s",
            do="correct that line",
        )
    label = text_of((row.get("label") or "").strip()) or majority(recording, first, last)
    return Segment(start, end, first, last, kind, label)
