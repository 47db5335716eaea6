"""A mapping proposed for a foreign file: derived from its names, its units and its numbers, written
as TOML with a reason on each line and a mark for what cannot be known.
"""

import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import split_unit
from tiltcal.data_quality.check import Finding, in_words
from tiltcal.data_quality.log import Log
from tiltcal.data_quality.registry import inspect_log
from tiltcal.recordings.foreign_files import time_of
from tiltcal.recordings.formats.bad_lines import find_bad_lines
from tiltcal.recordings.formats.budget import ReadBudget
from tiltcal.recordings.formats.dialect import Dialect
from tiltcal.recordings.formats.raw_table import RawFile
from tiltcal.recordings.means_table import is_a_row_a_pose
from tiltcal.recordings.proposal.channels import ANGLES, REMARKS, Channel, channels_of
from tiltcal.recordings.proposal.gravity import norm_at_rest
from tiltcal.recordings.proposal.pairs import find_pairs, follows
from tiltcal.recordings.proposal.pieces import Origin, Pieces, pieces_of
from tiltcal.recordings.proposal.sensors import (
    Sensor,
    Triad,
    find_labels,
    find_others,
    find_triads,
    with_units,
)
from tiltcal.recordings.proposal.table_kind import TableGuess, find_table
from tiltcal.recordings.proposal.time_axis import TABLE_OF_MEANS, TimeGuess

_LISTED = 8  # columns that a doubt names
_ABREAST = 28  # columns that a value takes before its reason


def proposal_text(proposal: "MappingProposal") -> str:
    """The text of the mapping."""
    lines = [
        f"# Mapping of {proposal.source}, proposed by `tiltcal import --propose`: check each line.",
        f"# {proposal.format}, {proposal.rows} rows.",
    ]
    lines += [f"# note: {note}" for note in proposal.notes]
    lines += _file(proposal)
    lines += _time(proposal)
    for column in proposal.columns:
        lines += _column(column, proposal)
    if proposal.table is not None and proposal.table.table:
        lines += ["[metadata]", _line("table", proposal.table.table, proposal.table.reason)]
    lines += [""]
    lines += [f"# cannot know: {doubt}" for doubt in proposal.doubts]
    lines += [f"# found: {finding.with_repair()}" for finding in proposal.findings]
    if proposal.left_out:
        lines.append(f"# left out: {', '.join(proposal.left_out)}")
    return "\n".join(lines) + "\n"


def _line(key: str, value: object, reason: str) -> str:
    text = f"{key} = {json.dumps(value, ensure_ascii=False)}"
    return f"{text:<{_ABREAST}} # {reason}" if reason else text


def _file(proposal: "MappingProposal") -> list[str]:
    main = proposal.origins[_main(proposal)][1]
    shared = _shared(proposal)
    if proposal.dialect is None:
        lines = [_line("table", main, "most channels are in it")] if main else []
        return ["[file]", *lines, *shared] if lines or shared else []
    layout, reasons = proposal.dialect.layout, proposal.dialect.reasons
    stated = layout.model_dump(exclude={"table", "ragged_lines", "instance"})
    always = ("separator", "decimal", "encoding", "header")
    shown = {k: v for k, v in stated.items() if k in always or v}
    lines = ["[file]", *(_line(k, v, reasons.get(k, "")) for k, v in shown.items())]
    if any(f.kind == "ragged_lines" for f in proposal.findings):
        why = 'some lines have another number of cells; "drop" leaves them out'
        lines.append(_line("ragged_lines", "refuse", why))
    return lines + shared


def _shared(proposal: "MappingProposal") -> list[str]:
    """The line of one of several instruments in a table."""
    if proposal.instance is None:
        return []
    column, value = (json.dumps(v, ensure_ascii=False) for v in proposal.instance)
    text = f"instance = {{ column = {column}, value = {value} }}"
    return [f"{text:<{_ABREAST}} # rows of one of several instruments"]


def _main(proposal: "MappingProposal") -> str:
    """The table of the first file with most of the channels."""
    names = [c.channel.table for c in proposal.columns if not proposal.origins[c.channel.table][0]]
    return max(names, key=names.count)


def _time(proposal: "MappingProposal") -> list[str]:
    time = proposal.time[_main(proposal)]
    if time.channel is None:
        if time.rate:
            return ["[time]", _line("rate_hz", time.rate, time.reason)]
        return ["[time]", _line("rate_hz", "?", f"cannot know: {time.doubts[0]}")]
    lines = ["[time]", _line("column", time.channel.source, time.reason)]
    if time.tick_s:
        lines.append(_line("tick_s", time.tick_s, time.unit_reason))
        return [*lines, _line("wraps_at", time.wraps_at, "it has 32 bits")]
    if not time.unit:
        return [*lines, _line("unit", "?", f"cannot know: {time.doubts[0]}")]
    return [*lines, _line("unit", time.unit, time.unit_reason)]


def _column(column: "ColumnGuess", proposal: "MappingProposal") -> list[str]:
    channel, main = column.channel, _main(proposal)
    lines = ["[[column]]", _line("from", channel.source, "")]
    if channel.table != main:
        file, table = proposal.origins[channel.table]
        lines += [_line("file", file, "")] if file else []
        lines += [_line("table", table, "")] if table else []
        lines += _own_time(proposal.time[channel.table], proposal.time[main])
    mark = "cannot know the unit, see the end; " if column.to.endswith("_?") else ""
    lines.append(_line("to", column.to, mark + column.reason))
    if column.scale != 1.0:
        lines.append(_line("scale", column.scale, ""))
    if column.offset:
        lines.append(_line("offset", column.offset, ""))
    return lines


def _own_time(own: "TimeGuess", main: "TimeGuess") -> list[str]:
    """The time column of another table where it has another name."""
    if own.channel is None or main.channel is None or own.channel.source == main.channel.source:
        return []
    return [_line("time", own.channel.source, own.reason)]


MEANS_NOTE = (
    "each row has a label and no label stays: a table of means, one row a pose; `tiltcal calibrate`"
    " takes the rows as poses"
)
_EVEN = 0.12  # relative spread of the norm of gravity over the standstills
FRAMES = (
    "how the instrument is mounted, and whether a positive reading is specific force (+g with the"
    " axis up) or gravity: record a face that is known and compare with"
    " `tiltcal explain-frames`"
)


@dataclass(frozen=True)
class ColumnGuess:
    """A proposed channel.

    Args:
        channel: the column.
        to: its name here; ends in ``_?`` where the unit cannot be known.
        reason: for the comment on its line.
        scale, offset: to its unit.
    """

    channel: Channel
    to: str
    reason: str
    scale: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class MappingProposal:
    """A proposed mapping.

    Args:
        source, format, rows: of the file.
        dialect: of a text; None for other formats.
        time: of each table that has channels, by its name.
        columns: proposed channels.
        table: that turned the instrument.
        left_out: columns that are not proposed, with a remark on each.
        doubts: what cannot be known.
        findings: faults of the data.
        origins: of each table.
        instance: column that tells instruments apart, and the value chosen.
        notes: on the file as a whole.
    """

    source: str
    format: str
    rows: int
    dialect: Dialect | None
    time: dict[str, TimeGuess]
    columns: Sequence[ColumnGuess]
    table: TableGuess | None
    left_out: Sequence[str] = ()
    doubts: Sequence[str] = ()
    findings: Sequence[Finding] = field(default_factory=tuple)
    origins: Mapping[str, Origin] = field(default_factory=dict)
    instance: tuple[int | str, int | str] | None = None
    notes: Sequence[str] = ()

    def toml(self) -> str:
        """The mapping as commented TOML."""
        return proposal_text(self)


def propose_mapping(
    path: Path | str,
    budget: ReadBudget | None = None,
    more: Sequence[Path | str] = (),
    instance: int | None = None,
) -> MappingProposal:
    """The proposed mapping of a file, or of several files of one recording.

    Args:
        path: of the file.
        budget: how much memory the values of a file may take.
        more: further files, joined with the first by their times.
        instance: value of the instrument where several share a table; None: not chosen.

    Raises:
        TiltcalError: a file cannot be read, or has no table of numbers.
    """
    paths = [Path(path), *map(Path, more)]
    pieces = pieces_of(paths, budget or ReadBudget(), instance)
    with warnings.catch_warnings():  # columns may contain anything
        warnings.simplefilter("ignore", RuntimeWarning)
        found = _proposal(pieces)
    used = {c.channel.name for c in found.columns}
    faults = [f for f in pieces.faults if f.column in used]
    source = in_words([p.name for p in paths])
    return replace(found, source=source, findings=[*faults, *found.findings])


def _proposal(pieces: Pieces) -> MappingProposal:
    file, times = pieces.file, dict(pieces.times)
    means = [t.name for t in file.tables if _is_of_means(pieces.channels, t.name)]
    times |= dict.fromkeys(means, TABLE_OF_MEANS)
    taken = [id(t.channel) for t in pieces.times.values() if t.channel is not None]
    remaining = [c for c in pieces.channels if id(c) not in taken]
    triads = [
        triad if name not in means else replace(triad, windows=None)
        for name, time in times.items()
        for triad in find_triads([c for c in remaining if c.table == name], time.rate)
    ]
    sensors = with_units(triads, {name: time.rate for name, time in times.items()})
    columns, table, doubts = _columns_of(remaining, triads, sensors)
    if not columns or all(pieces.origins[c.channel.table][0] for c in columns):
        raise _nothing(file)
    used = {id(c.channel) for c in columns}
    doubts += _unexplained([c for c in remaining if id(c) not in used])
    tables = list(dict.fromkeys(c.channel.table for c in columns))
    clocks = {name: times[name] for name in tables}
    doubts = [*pieces.doubts, *_doubts(list(clocks.values()), sensors, table, doubts)]
    return MappingProposal(
        file.source,
        file.format,
        max(len(t) for t in file.tables if t.name in tables),
        pieces.dialect,
        clocks,
        columns,
        table,
        _left_out([c for c in remaining if id(c) not in used], triads),
        list(dict.fromkeys(doubts)),
        [*(f for t in file.tables for f in find_bad_lines(t)), *_findings(file, columns, times)],
        pieces.origins,
        pieces.instance,
        [MEANS_NOTE] if set(means) & set(tables) else [],
    )


def _is_of_means(channels: Sequence[Channel], table: str) -> bool:
    """Whether the labels of a table show that each row is a pose."""
    labels = find_labels([c for c in channels if c.table == table])
    return bool(labels) and is_a_row_a_pose(labels[0][0].raw)


def _columns_of(
    remaining: Sequence[Channel], triads: Sequence[Triad], sensors: Sequence[Sensor]
) -> tuple[list[ColumnGuess], TableGuess | None, list[str]]:
    """The columns of all sensors, of the table and of labels; the table; what cannot be known."""
    table, angles = _table(remaining, triads)
    columns = [guess for s in sensors for guess in _columns(s)]
    used = {id(c) for s in sensors for c in s.triad.channels}
    columns += _angles(table, angles)
    used |= {id(c.channel) for c in columns}
    paired, doubts = _pairs([c for c in remaining if id(c) not in used], columns)
    columns += paired
    used |= {id(c.channel) for c in columns}
    others, more = find_others([c for c in remaining if id(c) not in used])
    columns += [ColumnGuess(*o) for o in others]
    doubts += more
    columns += [ColumnGuess(*o) for o in find_labels([c for c in remaining if id(c) not in used])]
    return columns, table, doubts


def _pairs(
    remaining: Sequence[Channel], columns: Sequence[ColumnGuess]
) -> tuple[list[ColumnGuess], list[str]]:
    """Two-axis sensors that follow an angle of the table, or have one in their name; and what
    cannot be known of them.
    """
    angles = [c for c in columns if c.to.startswith("table_") and not c.to.endswith("?")]
    found: list[ColumnGuess] = []
    doubts: list[str] = []
    for pair in find_pairs(remaining):
        near = [a for a in angles if len(a.channel.raw) == len(pair[0].raw)]
        read = [a for a in near if follows(pair, a.channel, str(split_unit(a.to)[1]))]
        in_angle = all(c.unit in ANGLES for c in pair)
        if not (read or in_angle or pair[0].meaning.role == "incl"):
            continue
        name = f"incl{len(found) // 2 + 1}" if found else "incl"
        reason = f"one of two axes follows {read[0].channel.name}" if read else "its name or unit"
        for c, axis in zip(pair, "xy", strict=True):
            unit = c.unit or ("LSB" if c.whole else "?")
            found.append(ColumnGuess(c, f"{name}_{axis}_{unit}", reason))
        if not in_angle:
            doubts.append(f"{name}: its zero and scale, and whether it reads the tilt or its sine")
    return found, doubts


def _unexplained(channels: Sequence[Channel]) -> list[str]:
    """Columns that vary, and that nothing explains."""
    named = [c for c in channels if c.numeric and c.meaning.role == ""]
    unknown = [c.name for c in named if np.nanmin(c.values) < np.nanmax(c.values)]
    if len(unknown) > _LISTED:
        unknown = [*unknown[:_LISTED], f"{len(unknown) - _LISTED} more columns"]
    return [f"what {in_words(unknown)} hold: no name, unit or motion says"] if unknown else []


def _table(
    remaining: Sequence[Channel], triads: Sequence[Triad]
) -> tuple[TableGuess | None, list[Channel]]:
    """The table, and the columns that may be its angles."""
    roles = ("outer", "middle", "inner", "angle")
    angles = [c for c in remaining if c.numeric and c.meaning.role in roles and not c.meaning.axis]
    if not 1 <= len(angles) <= 3:
        return None, []
    angles = [c for c in angles if c.table == angles[0].table]
    even = [
        t
        for t in triads
        if t.kind == "accel"
        and t.windows is not None
        and norm_at_rest(t.windows)[1] < _EVEN
        and len(t.values) == len(angles[0].raw)
    ]
    if not even:
        return find_table(angles, None, None), angles
    return find_table(angles, even[0].values, even[0].windows), angles


def _columns(sensor: Sensor) -> list[ColumnGuess]:
    triad, unit = sensor.triad, sensor.unit
    reason = f"{triad.reason}; {unit.reason}" if unit.reason else triad.reason
    return [
        ColumnGuess(c, f"{sensor.name}_{axis}_{unit.unit or '?'}", reason, unit.scale)
        for c, axis in zip(triad.channels, "xyz", strict=True)
    ]


def _angles(table: TableGuess | None, angles: Sequence[Channel]) -> list[ColumnGuess]:
    if table is None:
        return []
    return [
        ColumnGuess(c, f"table_{table.axes[c.name]}_{table.unit or '?'}", table.reason)
        for c in angles
        if c.name in table.axes
    ]


def _left_out(channels: Sequence[Channel], triads: Sequence[Triad]) -> list[str]:
    unknown = {id(c) for t in triads if not t.kind for c in t.channels}
    entries = []
    for c in channels:
        if id(c) in unknown:
            what = "cannot know: accelerometer or magnetometer"
        else:
            role = REMARKS.get(c.meaning.role, c.meaning.role)
            what = role or ("text" if not c.numeric else "not recognised")
        entries.append(f"{c.table + ': ' if c.table else ''}{c.name} ({what})")
    return entries


def _doubts(
    times: Sequence[TimeGuess],
    sensors: Sequence[Sensor],
    table: TableGuess | None,
    more: Sequence[str],
) -> list[str]:
    found = [d for t in times for d in t.doubts]
    units = list(dict.fromkeys(t.unit for t in times if t.unit))
    if len(units) > 1:
        found.append(f"one unit for all times: they are in {in_words(units)}")
    for s in sensors:
        if s.unit.doubt:
            found.append(f"{s.name}: {s.unit.doubt}")
        if not s.triad.axes_known:
            found.append(f"{s.name}: that its columns are x, y and z in this order")
        if s.triad.kind == "accel" and s.unit.unit == "LSB" and not s.triad.axes_known:
            found.append(f"{s.name}: that it is no magnetometer, which depends on attitude as well")
    if table is not None and table.doubt:
        found.append(table.doubt)
    found += more
    if sensors:
        found.append(FRAMES)
    return found


def _findings(
    file: RawFile, columns: Sequence[ColumnGuess], times: dict[str, TimeGuess]
) -> list[Finding]:
    found: list[Finding] = []
    for name in dict.fromkeys(c.channel.table for c in columns):
        if times[name] is TABLE_OF_MEANS:
            continue
        inside = [c for c in columns if c.channel.table == name and c.channel.numeric]
        spec = times[name].spec
        time, _ = time_of(file.table(name), spec, file.source)
        values = {_plain(c.to): c.channel.values for c in inside}
        found += inspect_log(Log.of(time, values, period=spec.period)).findings
    return found


def _plain(name: str) -> str:
    """A name that ends in a unit, for the checks."""
    return name.replace("_?", "_LSB")


def _nothing(file: RawFile) -> TiltcalError:
    names = [c.name for c in channels_of(file)[0]]
    return TiltcalError(
        f"foreign recording {file.source}",
        found=f"columns {', '.join(names[:8])}, none of which is like a sensor",
        need="three columns of an accelerometer or a gyro, or angles of a table",
        do="write the mapping yourself: see `tiltcal import --help`",
    )
