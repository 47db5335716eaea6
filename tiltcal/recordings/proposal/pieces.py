"""What a proposal looks at: the tables of one file or of several, with their times and the rows of
one instrument.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tiltcal.core.errors import TiltcalError
from tiltcal.data_quality.check import Finding, in_words
from tiltcal.recordings.foreign_files import one_instance
from tiltcal.recordings.formats.budget import ReadBudget
from tiltcal.recordings.formats.dialect import Dialect, stated_values
from tiltcal.recordings.formats.raw_table import RawFile
from tiltcal.recordings.formats.registry import TEXT, format_of
from tiltcal.recordings.formats.text import text_dialect
from tiltcal.recordings.mapping import UNKNOWN, FileLayout, InstanceOf
from tiltcal.recordings.proposal.channels import Channel, channels_of
from tiltcal.recordings.proposal.column_names import proven_names
from tiltcal.recordings.proposal.instances import find_instances
from tiltcal.recordings.proposal.time_axis import TimeGuess, find_time, stated_rate

Origin = tuple[str, str]
"""File of a table, empty for the first one, and its name there."""


@dataclass(frozen=True)
class Pieces:
    """The tables.

    Args:
        file: all of them, by names of their own where there are several files.
        dialect: of a text; None for other formats.
        channels: columns of all tables.
        faults: cells that are no numbers.
        times: of each table, by its name.
        origins: of each table.
        instance: column that tells instruments apart, and the value chosen, ``?`` where none is.
        doubts: what cannot be known.
    """

    file: RawFile
    dialect: Dialect | None
    channels: Sequence[Channel]
    faults: Sequence[Finding]
    times: Mapping[str, TimeGuess]
    origins: Mapping[str, Origin]
    instance: tuple[int | str, int | str] | None = None
    doubts: Sequence[str] = ()


def pieces_of(paths: Sequence[Path], budget: ReadBudget, instance: int | None) -> Pieces:
    """The tables of files.

    Args:
        paths: of the files, one or more.
        budget: how much memory the values of one may take.
        instance: value of the instrument where several share a table; None: not chosen.

    Raises:
        TiltcalError: a file cannot be read, the files differ in layout, or there is no such
            instrument.
    """
    several = len(paths) > 1
    found = [_piece(path, budget, instance, path.name if several else "") for path in paths]
    first = found[0]
    if instance is not None and all(p.instance is None for p in found):
        raise TiltcalError(
            f"foreign recording {first.file.source}",
            found="no column that tells several instruments apart",
            need="a column such as I or instance, with 0, 1, ... in turn",
            do="leave out --instance",
        )
    layouts = {None if p.dialect is None else p.dialect.layout.model_dump_json() for p in found}
    if len(layouts) > 1:
        raise TiltcalError(
            "files of `tiltcal import`",
            found=f"{in_words([p.name for p in paths])} of different layout",
            need="one separator, decimal mark and header for all",
            do="import them one by one, or write them in one layout",
        )
    if not several:
        return first
    origins = {
        name: ("" if k == 0 else paths[k].name, table)
        for k, p in enumerate(found)
        for name, (_, table) in p.origins.items()
    }
    return Pieces(
        replace(first.file, tables=tuple(t for p in found for t in p.file.tables)),
        first.dialect,
        [c for p in found for c in p.channels],
        [f for p in found for f in p.faults],
        {name: time for p in found for name, time in p.times.items()},
        origins,
        next((p.instance for p in found if p.instance is not None), None),
        [d for p in found for d in p.doubts],
    )


def _piece(path: Path, budget: ReadBudget, instance: int | None, prefix: str) -> Pieces:
    """The tables of one file; a prefix goes before their names."""
    format = format_of(path)
    dialect = text_dialect(path) if format is TEXT else None
    layout = FileLayout() if dialect is None else dialect.layout
    file = format.read(path, layout.model_copy(update={"ragged_lines": "drop"}), budget)
    origins = {"/".join(filter(None, (prefix, t.name))): ("", t.name) for t in file.tables}
    tables = zip(origins, file.tables, strict=True)
    file = replace(file, tables=tuple(replace(t, name=name) for name, t in tables))
    plain = _looked_at(file, dialect, origins)
    for name, time in plain.times.items():
        shared = find_instances([c for c in plain.channels if c.table == name], time)
        if shared is not None:
            column, values = shared
            chosen = values[0] if instance is None else instance
            one = one_instance(file, InstanceOf(column=column.source, value=chosen))
            doubt = (
                f"which of {len(values)} instruments: column {column.name} alternates"
                f" {', '.join(map(str, values))}; choose one with --instance"
            )
            return replace(
                _looked_at(one, dialect, origins),
                instance=(column.source, UNKNOWN if instance is None else instance),
                doubts=[*plain.doubts, *([doubt] if instance is None else [])],
            )
    return plain


def _looked_at(file: RawFile, dialect: Dialect | None, origins: Mapping[str, Origin]) -> Pieces:
    """Channels and times of the tables of a file."""
    names: dict[int, str] = {}
    doubts = [] if dialect is None else list(dialect.doubts)
    if dialect is not None and dialect.misfit:
        names, known = proven_names(dialect.misfit, file.tables[0].columns)
        doubts.append(f"{dialect.reasons['header']}: {known}")
    decimal = "point" if dialect is None else dialect.layout.decimal
    channels, faults = channels_of(file, decimal, names)
    before = [] if dialect is None else dialect.before
    times = {
        t.name: find_time(
            [c for c in channels if c.table == t.name],
            stated_rate({**t.metadata, **stated_values(before)}, before),
        )
        for t in file.tables
    }
    return Pieces(file, dialect, channels, faults, times, origins, doubts=doubts)
