"""Recordings read from files: CSV, Parquet, NPZ. What ``saving`` writes reads back exactly."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import require_file
from tiltcal.recordings.csv_files import read_csv
from tiltcal.recordings.npz_files import read_npz
from tiltcal.recordings.parquet_files import read_parquet
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.samples import Labels
from tiltcal.recordings.saving import SUFFIXES


def read_recording(path: Path | str) -> Recording:
    """Read a recording.

    Raises:
        TiltcalError: the file is missing, empty, of another format, or a cell is not a number.
    """
    path = require_file(Path(path), "recording")
    if path.stat().st_size == 0:
        raise TiltcalError(
            f"recording {path.name}",
            found="an empty file",
            need="a header and rows",
            do="record it again",
        )
    if path.suffix == ".csv":
        columns, metadata = read_csv(path)
    elif path.suffix == ".parquet":
        columns, metadata = read_parquet(path)
    elif path.suffix == ".npz":
        columns, metadata = read_npz(path)
    else:
        raise TiltcalError(
            f"recording {path.name}",
            found=f"the ending '{path.suffix}'",
            need="one of " + ", ".join(SUFFIXES),
            do="rename it, or bring a foreign format in with `tiltcal import`",
        )
    return assemble(columns, metadata, path.name)


def assemble(
    columns: Mapping[str, Array | Labels],
    metadata: Mapping[str, str],
    source: str,
    before: int = 0,
) -> Recording:
    """A recording from columns as read, (n,) each: floats, or objects for text.

    Args:
        columns: (n,) each.
        metadata: of the file.
        source: where it comes from.
        before: rows of the file before these, for messages.

    Raises:
        TiltcalError: there is no time column, a stamp is missing, or there are no rows.
    """
    subject = f"recording {source}"
    if "time_s" not in columns:
        raise TiltcalError(
            subject,
            found="columns " + ", ".join(list(columns)[:8]),
            need="a column time_s",
            do="name the time column so, or bring a foreign format in with `tiltcal import`",
        )
    time = np.asarray(columns["time_s"], dtype=float)
    if len(time) == 0:
        raise TiltcalError(
            subject, found="a header and no rows", need="at least one row", do="record it again"
        )
    if np.isnan(time).any():
        row = before + int(np.argmax(np.isnan(time))) + 1
        raise TiltcalError(
            f"{subject}, data row {row}, column time_s",
            found="no time",
            need="a number",
            do="fill it in",
        )
    numbers = {
        n: np.asarray(v, dtype=float)
        for n, v in columns.items()
        if v.dtype != object and n != "time_s"
    }
    texts = {n: _without_blanks(v) for n, v in columns.items() if v.dtype == object}
    labels = texts.pop("label", None)
    return Recording.from_columns(
        time, numbers, labels=labels, extra=texts, metadata=metadata, source=subject
    )


def _without_blanks(texts: Array | Labels) -> Labels:
    """The texts of a column; spaces only are an empty cell, as they are among numbers."""
    return np.array([t if t and t.strip(" ") else None for t in texts], dtype=object)
