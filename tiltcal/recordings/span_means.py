"""Long recordings as means over short spans of time, in memory that does not grow with their rows.

A recording of more than ``LONGEST`` rows is read piece by piece. Of each sensor the readings within
a span are averaged, and with them the table's readout and the temperature of the same rows: to the
first order a mean of readings is what the mean angle predicts. Shorter recordings are taken as they
are.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.core.budget import require_within
from tiltcal.core.progress import Progress, report_pieces, silent
from tiltcal.core.quantisation import lsb_grid
from tiltcal.core.units import split_unit
from tiltcal.recordings.means_table import read_log_or_means
from tiltcal.recordings.pieces import estimated_rows, joined, part_of, read_pieces
from tiltcal.recordings.recording import Recording, is_reading
from tiltcal.statistics.dwell_noise import second_difference_noise

LONGEST = 500_000  # rows of a recording that is taken sample by sample
AVERAGED = "averaged over"  # metadata: the length of the spans
ENOUGH = 0.5  # share of a span's usual samples below which it is left out: next to a gap
COPIES = 6  # of a recording's columns in memory while it is taken sample by sample
GRID_SAMPLES = 20_000  # samples from which the LSB is determined


@dataclass(frozen=True)
class Spans:
    """Consecutive spans of time.

    Args:
        samples: in each of the most frequent channel.
        step: between samples, s.
    """

    samples: int
    step: float

    @property
    def text(self) -> str:
        """Length of each, for messages."""
        return f"{self.samples * self.step:.4g} s ({self.samples} samples)"

    def numbers(self, time: Array) -> Index:
        """The span that each stamp lies in, (n,); a stamp is the middle of its step. time: s."""
        return np.floor((time / self.step + 0.5) / self.samples).astype(np.intp)


def read_averaged(path: Path | str, progress: Progress = silent) -> Recording:
    """A recording, or a table of means; where it is long, averaged over spans of time.

    Args:
        path: of the recording.
        progress: callback, receives the share of a long one that was read.

    Raises:
        TiltcalError: as ``read_log_or_means`` and ``read_pieces`` do; or its quantisation is
            coarse, with more rows than there is memory for.
    """
    spans = spans_of(path)
    if spans is None:
        require_memory(path)
        return read_log_or_means(path)
    pieces = report_pieces(read_pieces(path), estimated_rows(path), progress)
    return joined([averaged(piece, spans) for piece in whole_spans(pieces, spans)])


def require_memory(path: Path | str) -> None:
    """Refuse a long recording that is taken sample by sample, where that needs more memory than is
    allowed.

    Raises:
        TiltcalError: stating how much it would be.
    """
    rows = estimated_rows(path)
    if rows <= LONGEST:
        return
    cells = rows * len(next(read_pieces(path, ordered=False)).written_names)
    require_within(
        f"recording {Path(path).name}, whose quantisation is coarse, so that it is not averaged",
        size=COPIES * 8 * cells,
        less="cut it into shorter recordings",
    )


def averaging_note(recording: Recording) -> str | None:
    """Note on a recording that was averaged; None for others."""
    spans = recording.metadata.get(AVERAGED)
    return None if spans is None else f"{recording.source} was read as averages over {spans}"


def spans_of(path: Path | str, rows: int | None = None) -> Spans | None:
    """The spans that a file is averaged over; None where it is taken sample by sample.

    Coarsely quantised readings are not averaged: single samples show what rounding leaves in a
    mean.

    Args:
        path: of the recording.
        rows: that are left of it, at most; ``LONGEST`` unless given.
    """
    all_rows = estimated_rows(path)
    if all_rows <= LONGEST:
        return None
    first = next(read_pieces(path, ordered=False))
    if any(_coarse(first.column(name)) for name in first.column_names if is_reading(name)):
        return None
    return Spans(-(-all_rows // (rows or LONGEST)), float(np.median(np.diff(first.time))))


def _coarse(values: Array) -> bool:
    """Whether the noise of a column is below one LSB."""
    known = values[~np.isnan(values)][:GRID_SAMPLES]
    lsb = lsb_grid(known) if len(known) > 2 else None
    return lsb is not None and second_difference_noise(known) < lsb


def whole_spans(pieces: Iterable[Recording], spans: Spans, rows: int = 1) -> Iterator[Recording]:
    """The same recording in pieces that end where a span ends.

    Args:
        pieces: of a recording, one after another.
        spans: at whose ends the pieces end.
        rows: that each piece has at least, but the only one of a shorter recording.
    """
    ready: list[Recording] = []
    kept: list[Recording] = []
    for piece in pieces:
        kept.append(piece)
        if sum(len(p) for p in kept) <= rows:
            continue
        whole = joined(kept)
        numbers = spans.numbers(whole.time)
        last = int(np.searchsorted(numbers, numbers[-1]))
        kept = [part_of(whole, last, len(whole))]
        if last:
            yield from ready
            ready = [part_of(whole, 0, last)]
    if ready or kept:
        yield joined([*ready, *kept])


def averaged(piece: Recording, spans: Spans) -> Recording:
    """Means over spans, one row for each span and for each set of sensors that were sampled
    together.

    A row also has the means of the columns that were read on every one of these sensors' rows, such
    as angles of the table; other columns have rows of their own. Texts are those of the row in the
    middle.
    """
    groups = list(_groups(piece))
    parts = [_means(piece, names, rows, spans) for names, rows in groups]
    time, where = np.unique(np.concatenate([p.time for p in parts]), return_inverse=True)
    starts = np.cumsum([0, *(len(p) for p in parts)])
    columns = {name: np.full(len(time), np.nan) for name in piece.column_names}
    texts = {name: np.full(len(time), None, dtype=object) for name in piece.texts}
    for k, part in enumerate(parts):
        rows = where[starts[k] : starts[k + 1]]
        for name in part.column_names:
            columns[name][rows] = part.column(name)
        for name, texts_of_part in part.texts.items():
            texts[name][rows] = texts_of_part
    labels = texts.pop("label", None)
    metadata = {**piece.metadata, AVERAGED: spans.text}
    return Recording.from_columns(
        time, columns, labels=labels, extra=texts, metadata=metadata, source=piece.source
    )


def _groups(piece: Recording) -> Iterator[tuple[list[str], Index]]:
    """Columns that are averaged together, and the rows they are averaged over, (m,)."""
    there = {n: ~np.isnan(piece.column(n)) for n in piece.column_names}
    together: dict[bytes, tuple[list[str], Mask]] = {}
    states = [n for n in there if not is_reading(n) and there[n].any()]
    for sensor in dict.fromkeys(_sensor(n) for n in there if is_reading(n)):
        names = [n for n in there if is_reading(n) and _sensor(n) == sensor and there[n].any()]
        if names:
            complete = np.logical_and.reduce([there[n] for n in names])
            together.setdefault(complete.tobytes(), ([], complete))[0].extend(names)
    used: set[str] = set()
    for names, complete in list(together.values()):
        with_them = [n for n in states if there[n][complete].all()]
        used.update(with_them)
        yield names + with_them, np.flatnonzero(complete)
    for name in states:
        if name not in used:
            yield [name], np.flatnonzero(there[name])


def _sensor(column: str) -> str:
    """The sensor whose column it is: its channel without the axis."""
    return split_unit(column)[0].rpartition("_")[0]


def _means(piece: Recording, names: list[str], rows: Index, spans: Spans) -> Recording:
    """Means of columns over spans of these rows."""
    if not len(rows):
        return Recording(np.zeros(0))
    numbers = spans.numbers(piece.time[rows])
    starts = np.flatnonzero(np.diff(numbers, prepend=numbers[0] - 1))
    counts = np.diff(starts, append=len(rows))
    full = counts >= ENOUGH * np.median(counts)
    origin = piece.time[rows[0]]

    def mean(values: Array) -> Array:
        sums = np.add.reduceat(values if len(rows) == len(values) else values[rows], starts)
        return np.asarray(sums / counts)[full]

    middle = rows[starts + counts // 2][full]
    return Recording.from_columns(
        origin + mean(piece.time - origin),
        {name: mean(piece.column(name)) for name in names},
        labels=None if piece.labels is None else piece.labels[middle],
        extra={name: values[middle] for name, values in piece.extra.items()},
    )
