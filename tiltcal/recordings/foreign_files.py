"""Foreign files as recordings: raw columns, a mapping, and repairs where they are asked for."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.progress import Progress, silent
from tiltcal.core.units import COLUMN_UNITS
from tiltcal.data_quality.check import Finding
from tiltcal.data_quality.log import Log
from tiltcal.data_quality.registry import inspect_log, repair_log
from tiltcal.recordings.formats.bad_lines import find_bad_lines
from tiltcal.recordings.formats.budget import ReadBudget
from tiltcal.recordings.formats.cells import DATES, date_stamps, numbers_in
from tiltcal.recordings.formats.raw_table import Raw, RawFile, RawTable
from tiltcal.recordings.formats.registry import read_raw
from tiltcal.recordings.formats.text import bad_cell
from tiltcal.recordings.mapping import ColumnMapping, InstanceOf, Mapping, TimeSource
from tiltcal.recordings.means_table import is_a_row_a_pose
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.samples import Labels

READING, CHECKING, WRITING = "reading", "checking", "writing"
SHARES = {READING: 3.0, CHECKING: 4.0, WRITING: 2.0}
"""Of the time of an import, measured with 3e6 rows of eight columns of text."""
_FINE = 1e-8  # s; stamps so large that they resolve less are counted from the first second


@dataclass(frozen=True)
class Imported:
    """A recording with what was found on the way.

    Args:
        recording: as it is to be written.
        findings: faults of the data as they came, before any repair.
        repairs: description of each change.
    """

    recording: Recording
    findings: Sequence[Finding]
    repairs: Sequence[str]


_Files = dict[str | None, RawFile]  # None: the file that is imported; the others by their names
_Base = tuple[str | None, str, int | str | None]


@dataclass(frozen=True)
class _Part:
    """Channels of one time base: time, s, (n,), and columns by their new names, (n,) each."""

    time: Array
    zero: float
    columns: dict[str, Array]
    labels: Labels | None = None
    repairs: tuple[str, ...] = ()


def import_recording(
    path: Path | str, mapping: Mapping, budget: ReadBudget | None = None
) -> Recording:
    """A foreign file as a Recording.

    Raises:
        TiltcalError: a file is missing, a cell is no number, or files differ in length.
    """
    return import_file(path, mapping, budget).recording


def import_file(
    path: Path | str,
    mapping: Mapping,
    budget: ReadBudget | None = None,
    more: Sequence[Path | str] = (),
    begin: Progress = silent,
) -> Imported:
    """A foreign file as a Recording, with the faults of its data.

    Args:
        path: of the file.
        mapping: of its columns.
        budget: how much memory the values may take.
        more: files that columns name by ``file``; others are beside the first.
        begin: called with READING and CHECKING, as each begins.

    Raises:
        TiltcalError: as ``import_recording`` does, no column names one of ``more``, or a repair
            cannot be made.
    """
    path = Path(path)
    begin(READING)
    files = _files(path, mapping, budget, [Path(p) for p in more])
    begin(CHECKING)
    grouped: dict[_Base, list[ColumnMapping]] = {}
    for c in mapping.column:
        grouped.setdefault(_base(c, mapping, files), []).append(c)
    parts = [_part(files, base[0], wanted, mapping) for base, wanted in grouped.items()]
    findings = [f for file in files.values() for t in file.tables for f in find_bad_lines(t)]
    repaired: list[_Part] = []
    repairs: list[str] = []
    for part in parts:
        log = Log.of(part.time, part.columns, labels=part.labels, period=mapping.time.period)
        if not is_a_row_a_pose(part.labels):  # means are no log
            findings += inspect_log(log).findings
        log, done = repair_log(log, mapping.repair)
        repaired.append(_Part(log.time, part.zero, log.columns, log.labels))
        repairs += [*part.repairs, *done]
    metadata = {"imported from": path.name} | mapping.metadata
    repairs += [f"ragged_lines: {f.count} left out" for f in findings if f.kind == "ragged_lines"]
    if repairs:
        metadata["repairs"] = "; ".join(repairs)
    return Imported(_joined(repaired, metadata, f"recording {path.name}"), findings, repairs)


def _files(path: Path, mapping: Mapping, budget: ReadBudget | None, more: Sequence[Path]) -> _Files:
    """The file, and those that columns name, each with the rows of the chosen instance."""
    named = dict.fromkeys(c.file for c in mapping.column if c.file is not None)
    given = {p.name: p for p in more}
    unused = [name for name in given if name not in {Path(n).name for n in named}]
    if unused:
        raise TiltcalError(
            f"foreign recording {unused[0]}",
            found="no column of the mapping that is in it",
            need=f'file = "{unused[0]}" at its columns',
            do="`tiltcal import FILE FILE --propose` writes one mapping of several files",
        )
    paths = {name: given.get(Path(name).name, path.parent / name) for name in named}
    files: _Files = {None: read_raw(path, mapping.file, budget)}
    files |= {name: read_raw(p, mapping.file, budget) for name, p in paths.items()}
    chosen = mapping.file.instance
    if chosen is None:
        return files
    shared = [n for n, f in files.items() if any(t.has(chosen.column) for t in f.tables)]
    return files | {n: one_instance(files[n], chosen) for n in shared or [None]}


def one_instance(file: RawFile, instance: InstanceOf) -> RawFile:
    """A file with the rows of one of several instruments that share its tables.

    Args:
        file: as read.
        instance: column that tells the instruments apart, and the value of one; tables without
            that column stay whole.

    Raises:
        TiltcalError: no row has that value, or no table the column.
    """
    tables = [_of_instance(t, instance, file.source) for t in file.tables]
    if all(old is new for old, new in zip(file.tables, tables, strict=True)):
        file.tables[0].column(instance.column, file.source)
    return replace(file, tables=tuple(tables))


def _of_instance(table: RawTable, instance: InstanceOf, source: str) -> RawTable:
    if not table.has(instance.column):
        return table
    raw = table.column(instance.column, source)
    if raw.dtype.kind in "if" and isinstance(instance.value, int):
        rows = np.flatnonzero(raw == instance.value)
    else:
        rows = np.flatnonzero(raw.astype(str) == str(instance.value))
    if not len(rows):
        raise TiltcalError(
            f"foreign recording {source}, column {instance.column}",
            found=f"no row with {instance.value}",
            need=f"one of {', '.join(np.unique(raw.astype(str))[:_SHOWN])}",
            do="choose one of these with --instance",
        )
    return replace(table, columns=tuple((n, values[rows]) for n, values in table.columns))


_SHOWN = 8  # values that a message lists


def _table(column: ColumnMapping, mapping: Mapping, file: RawFile) -> RawTable:
    """The table of a file that a column is in."""
    if column.file is not None and column.table is None and len(file.tables) == 1:
        return file.tables[0]
    return file.table(mapping.table_of(column))


def _base(column: ColumnMapping, mapping: Mapping, files: _Files) -> _Base:
    """The file that has the time of a column, its table and its time column: one base for all
    columns that share these.
    """
    home = column.file if _has_own_time(column, mapping, files) else None
    return home, mapping.table_of(column), column.time


def _has_own_time(column: ColumnMapping, mapping: Mapping, files: _Files) -> bool:
    """Whether the file that a column names has the time of its rows: a column by that name, or by
    that number where it has other rows than the first file.
    """
    clock = mapping.time.column if column.time is None else column.time
    if column.file is None or clock is None:
        return False
    own = _table(column, mapping, files[column.file])
    if isinstance(clock, int) and column.time is None:
        return own.has(clock) and len(own) != len(files[None].table(mapping.table_of(column)))
    return own.has(clock)


def _part(
    files: _Files, home: str | None, wanted: Sequence[ColumnMapping], mapping: Mapping
) -> _Part:
    main = files[home]
    table = _table(wanted[0], mapping, main)
    own = wanted[0].time
    clock = mapping.time if own is None else mapping.time.model_copy(update={"column": own})
    time, zero = time_of(table, clock, main.source)
    columns: dict[str, Array] = {}
    repairs: list[str] = []
    labels = None
    for c in wanted:
        file = files[c.file]
        source = table if c.file == home else _table(c, mapping, file)
        if len(source) != len(table):
            raise TiltcalError(
                f"foreign recording {c.file}",
                found=f"{len(source)} rows",
                need=f"{len(table)} as in {main.source}, or a column of times",
                do='name its time column at each of its columns: time = "..."',
            )
        raw = source.column(c.from_, file.source)
        if c.to == "label":
            labels = np.array([None if t is None else str(t) for t in raw], dtype=object)
        else:
            values, repaired = _numbers(raw, c.to, file.source, mapping)
            columns[c.to] = _scaled(values, c, file.source)
            repairs += repaired
    return _Part(time, zero, columns, labels, tuple(repairs))


def _scaled(values: Array, column: ColumnMapping, source: str) -> Array:
    """Values times their scale, and with their offset.

    Raises:
        TiltcalError: a value is no number any more.
    """
    with np.errstate(over="ignore"):
        scaled = values if column.scale == 1.0 else column.scale * values
        scaled = scaled + column.offset if column.offset else scaled
    beyond = np.isinf(scaled) & np.isfinite(values)
    if beyond.any():
        row = int(np.argmax(beyond))
        raise TiltcalError(
            f"foreign recording {source}, column {column.from_}, data row {row + 1}",
            found=f"{values[row]:g}",
            need="a number that its scale leaves one",
            do="correct that cell, or the scale of the mapping",
        )
    return scaled


def _numbers(raw: Raw, name: str, source: str, mapping: Mapping) -> tuple[Array, list[str]]:
    """A column as numbers, and a description of the repair that made it so."""
    if raw.dtype.kind == "M":
        raise bad_cell(raw.astype(str).astype(object), source, mapping.file.decimal)
    if raw.dtype != object:
        return np.asarray(raw, dtype=float), []
    values, bad = numbers_in(raw, mapping.file.decimal)
    if len(bad) and "empty_text" not in mapping.repair:
        raise bad_cell(raw, source, mapping.file.decimal)
    repairs = [f"empty_text: {len(bad)} cells of {name} emptied"] if len(bad) else []
    return values, repairs


def time_of(table: RawTable, spec: TimeSource, source: str) -> tuple[Array, float]:
    """The time of a table, s, (n,), counted from a zero, s, which is 0 unless the stamps are so
    large that they would resolve less than 10 ns.

    Raises:
        TiltcalError: the column contains no times.
    """
    if spec.column is None:
        return np.arange(len(table)) / (spec.rate_hz or 1.0), 0.0
    raw = table.column(spec.column, source)
    if spec.unit in DATES or raw.dtype.kind == "M":
        counts, factor = date_stamps(raw, source, spec.unit).astype(np.int64), 1e-9
    elif raw.dtype == object:
        raise bad_cell(raw, source, "point")
    else:
        counts, factor = raw, spec.tick_s or COLUMN_UNITS[spec.unit].factor
    if not np.isfinite(counts).all():
        raise TiltcalError(
            f"foreign recording {source}, data row {int(np.argmin(np.isfinite(counts))) + 1}",
            found=f"no time in column {spec.column}",
            need="a number",
            do="fill it in, or leave out that row",
        )
    first = counts[0] if len(counts) else 0
    exact = counts.dtype.kind == "i"
    if not exact or np.spacing(abs(float(first)) * factor) < _FINE:
        return np.asarray(counts * factor, dtype=float), 0.0
    second = round(1 / factor)
    zero = int(first) // second * second
    return np.asarray((counts - zero) * factor, dtype=float), zero * factor


def _joined(parts: Sequence[_Part], metadata: dict[str, str], source: str) -> Recording:
    """One recording of parts that may have time bases of their own."""
    zero = min(p.zero for p in parts)
    if zero:
        metadata = metadata | {"time zero": f"{zero:.0f} s"}
    times = [p.time + (p.zero - zero) for p in parts]
    labels = next((p.labels for p in parts if p.labels is not None), None)
    if all(np.array_equal(t, times[0]) for t in times[1:]):
        columns = {name: values for p in parts for name, values in p.columns.items()}
        return Recording.from_columns(
            times[0], columns, labels=labels, metadata=metadata, source=source
        )
    union = np.unique(np.concatenate(times))
    columns = {}
    full_labels = None
    for t, p in zip(times, parts, strict=True):
        rows = np.searchsorted(union, t)
        for name, values in p.columns.items():
            columns[name] = np.full(len(union), np.nan)
            columns[name][rows] = values
        if p.labels is not None:
            full_labels = np.full(len(union), None, dtype=object)
            full_labels[rows] = p.labels
    return Recording.from_columns(
        union, columns, labels=full_labels, metadata=metadata, source=source
    )
