"""Long recordings read and written piece by piece, in memory that does not grow with their length.

CSV comes by blocks of text, Parquet by batches of rows, NPZ by pieces of every array. An NPZ file
is written in one piece: each column is stored whole.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.budget import require_within
from tiltcal.core.files import replacing, require_file
from tiltcal.recordings.csv_files import csv_head, csv_pieces, csv_writer, estimated_csv_rows
from tiltcal.recordings.npz_files import npz_head, npz_pieces, npz_rows
from tiltcal.recordings.parquet_files import (
    parquet_head,
    parquet_pieces,
    parquet_writer,
    stated_rows,
)
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.recording_files import assemble, read_recording
from tiltcal.recordings.samples import Labels
from tiltcal.recordings.saving import SUFFIXES, require_suffix, write_recording
from tiltcal.recordings.stamps import require_onward

COPIES = 3  # of an NPZ archive's columns in memory: its pieces, the whole, and what is written
Write = Callable[[Recording], None]
"""Appends a piece of a recording to a file."""


def read_pieces(path: Path | str, ordered: bool = True) -> Iterator[Recording]:
    """The pieces of a recording in their order: together what ``read_recording`` reads.

    Args:
        path: of the recording.
        ordered: whether time has to run forward.

    Raises:
        TiltcalError: as ``read_recording`` and ``Recording.require_increasing`` do.
    """
    path = require_file(Path(path), "recording")
    if path.suffix not in SUFFIXES or path.stat().st_size == 0:
        read_recording(path)  # raises the error
    if path.suffix == ".csv":
        metadata, names, _ = csv_head(path)
        pieces = csv_pieces(path)
    elif path.suffix == ".parquet":
        metadata, names = parquet_head(path)
        pieces = parquet_pieces(path)
    else:
        metadata, names = npz_head(path)
        pieces = npz_pieces(path)
    yield from _ahead(_assembled(pieces, names, metadata, path.name, ordered))


def estimated_rows(path: Path | str) -> int:
    """About how many rows a recording has, without reading it: as Parquet and NPZ state, by the
    length of the first lines of CSV; 0 where that is not known.

    Raises:
        TiltcalError: the file is missing, or no recording.
    """
    path = require_file(Path(path), "recording")
    if path.suffix == ".parquet":
        return stated_rows(path)
    if path.suffix == ".npz":
        return npz_rows(path)
    return estimated_csv_rows(path) if path.suffix == ".csv" else 0


def _assembled(
    pieces: Iterator[dict[str, Array | Labels]],
    names: Sequence[str],
    metadata: Mapping[str, str],
    source: str,
    ordered: bool,
) -> Iterator[Recording]:
    """Recordings of columns as read, piece by piece; the row numbers continue from piece
    to piece.
    """
    rows, last = 0, -np.inf
    for columns in pieces:
        if not len(next(iter(columns.values()))):
            continue
        piece = assemble(columns, metadata, source, rows)
        if ordered:
            require_onward(piece.time, piece.source, rows, last)
        yield piece
        rows, last = rows + len(piece), float(piece.time[-1])
    if rows == 0:  # raises the error of what is missing
        assemble({name: np.zeros(0) for name in names}, metadata, source)


def _ahead(pieces: Iterator[Recording]) -> Iterator[Recording]:
    """The same; while one piece is used a thread reads the next."""
    with ThreadPoolExecutor(1) as reader:
        coming = reader.submit(next, pieces, None)
        while (piece := coming.result()) is not None:
            coming = reader.submit(next, pieces, None)
            yield piece


@contextmanager
def _behind(write: Write) -> Iterator[Write]:
    """The same; while a thread writes one piece the next is made."""
    with ThreadPoolExecutor(1) as writer:
        going: list[Future[None]] = []

        def pass_on(piece: Recording) -> None:
            if going:
                going.pop().result()
            going.append(writer.submit(write, piece))

        yield pass_on
        for last in going:
            last.result()


@contextmanager
def writing(path: Path | str) -> Iterator[Write]:
    """What appends pieces to a recording's file, each with the columns of the first; the file takes
    its name when the block ends well, and not before.

    Raises:
        TiltcalError: the ending is unknown or the path cannot be written.
    """
    path = require_suffix(Path(path))
    if path.suffix == ".npz":
        pieces: list[Recording] = []

        def keep(piece: Recording) -> None:
            pieces.append(piece)
            cells = sum(len(p) for p in pieces) * len(piece.written_names)
            less = "write it as Parquet, which takes it piece by piece"
            require_within(f"output {path}", size=COPIES * 8 * cells, less=less)

        yield keep
        write_recording(joined(pieces), path)
        return
    with replacing(path) as temporary:
        if path.suffix == ".parquet":
            with parquet_writer(temporary) as write, _behind(write) as pass_on:
                yield pass_on
        else:
            with temporary.open("wb") as out, csv_writer(out) as write, _behind(write) as pass_on:
                yield pass_on


def joined(pieces: Sequence[Recording]) -> Recording:
    """One recording of consecutive pieces that have the same columns."""
    first = pieces[0]

    def labels(columns: Sequence[Labels | None]) -> Labels:
        return np.concatenate([c for c in columns if c is not None])

    return Recording.from_columns(
        np.concatenate([p.time for p in pieces]),
        {name: np.concatenate([p.column(name) for p in pieces]) for name in first.column_names},
        labels=None if first.labels is None else labels([p.labels for p in pieces]),
        extra={name: labels([p.extra[name] for p in pieces]) for name in first.extra},
        metadata=first.metadata,
        source=first.source,
    )


def part_of(recording: Recording, first: int, last: int) -> Recording:
    """The rows of a recording from ``first`` to before ``last``."""
    return Recording.from_columns(
        recording.time[first:last],
        {name: recording.column(name)[first:last] for name in recording.column_names},
        labels=None if recording.labels is None else recording.labels[first:last],
        extra={name: texts[first:last] for name, texts in recording.extra.items()},
        metadata=recording.metadata,
        source=recording.source,
    )
