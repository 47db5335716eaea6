"""Faults of a foreign file's data, each with its count and its rows; nothing is changed here."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.core.units import COLUMN_UNITS, split_unit
from tiltcal.recordings.formats.raw_table import CUT, DAMAGED, RAGGED, RawTable

_GAP = 2.5  # steps of the usual length
_SHOWN = 3  # rows that a statement names
_RUN = 20  # equal readings that are never called frozen, below it
_CHANCE = 1e-6  # of a run of equal readings in a whole recording
_LEVELS = 5  # next to the end of the range, for comparison
_AT_END = 5  # readings at the end of the range that make a channel clipped


@dataclass(frozen=True)
class Finding:
    """A fault.

    Args:
        kind: time_back, time_repeated, time_wrap, gap, missing, dead, frozen, clipped or wrap.
        column: where; ``time_s`` for stamps.
        count: of rows, or of events.
        rows: the first data rows it stands in, from 1.
        statement: one sentence.
        repair: the repair that mends it; empty where there is none.
    """

    kind: str
    column: str
    count: int
    rows: Sequence[int]
    statement: str
    repair: str = ""


def find_faults(time: Array, columns: Mapping[str, Array]) -> list[Finding]:
    """All faults of a table.

    Args:
        time: s, (n,).
        columns: name with unit -> values, (n,) each.
    """
    found = list(_time_faults(time))
    with np.errstate(all="ignore"):  # of infinite readings
        for name, values in columns.items():
            found += _channel_faults(name, values)
    return found


def find_bad_lines(table: RawTable) -> list[Finding]:
    """The findings of a file of which lines or messages are left out."""
    found = []
    if RAGGED in table.metadata:
        count = int(table.metadata[RAGGED])
        text = f"lines with another number of cells, left out: {count}"
        found.append(Finding("ragged_lines", "time_s", count, (), text))
    if DAMAGED in table.metadata:
        text = f"the file is damaged: {table.metadata[DAMAGED]}; what could be read is here"
        found.append(Finding("damaged", "time_s", 1, (), text))
    if CUT in table.metadata:
        row, line = len(table) + 1, table.metadata[CUT][:40]
        text = f"the last line is cut off and left out: '{line}', data row {row}"
        found.append(Finding("cut_line", "time_s", 1, (row,), text))
    return found


def _time_faults(time: Array) -> Iterator[Finding]:
    step = np.diff(time)
    if not len(step):
        return
    back = step < 0
    wraps = back & wrap_mask(time)
    if wraps.any():
        yield _found(
            "time_wrap",
            "time_s",
            wraps,
            "a counter starts again from its lowest value",
            "unwrap_time",
        )
    if (back & ~wraps).any():
        yield _found("time_back", "time_s", back & ~wraps, "time goes back", "sort_time")
    if (step == 0).any():
        yield _found(
            "time_repeated", "time_s", step == 0, "a stamp is repeated", "drop_repeated_time"
        )
    onward = step[step > 0]
    if len(onward):
        usual = float(np.median(onward))
        gaps = step > _GAP * usual
        if gaps.any():
            lost = int(np.sum(np.round(step[gaps] / usual) - 1))
            yield _found(
                "gap",
                "time_s",
                gaps,
                f"a gap; about {lost} samples are missing at {usual:.6g} s a sample",
            )


def wrap_mask(time: Array) -> Mask:
    """Steps at which a counter falls from near its highest to near its lowest value, (n - 1,).
    time: in the unit of the counter.
    """
    step, low, high = np.diff(time), float(np.min(time)), float(np.max(time))
    span = high - low
    falls = (step < -span / 2) & (time[:-1] > high - span / 20) & (time[1:] < low + span / 20)
    return np.asarray(falls, dtype=bool)


def _channel_faults(name: str, values: Array) -> Iterator[Finding]:
    missing = np.isnan(values)
    if missing.any() and not missing.all() and not _at_slower_rate(missing):
        yield _found("missing", name, missing, "no value", rows_shift=0)
    known = values[~missing]
    if not len(known):
        yield Finding("dead", name, len(values), (1,), f"{name}: no value in any row")
        return
    angle = is_angle(name)
    if len(known) > 1 and known.min() == known.max():
        if not angle:
            text = f"{name}: {known[0]:g} in all {len(known)} rows"
            yield Finding("dead", name, len(known), (1,), text)
        return
    if angle:
        jumps = angle_jumps(name, values)
        if jumps.any():
            yield _found("wrap", name, jumps, "the angle wraps", "unwrap_angles")
        return
    if not (values[1:] == values[:-1]).any():
        return
    ended = clipped(values)
    for kind, mask, description in (
        ("clipped", ended, "the reading stays at the end of its range"),
        ("frozen", frozen(values) & ~ended, "the reading is repeated too often for its noise"),
    ):
        if mask.any():
            yield _found(kind, name, mask, description, f"empty_{kind}", rows_shift=0)


def _at_slower_rate(missing: Mask) -> bool:
    """Whether values stand at every so many rows, without exception."""
    apart = np.diff(np.flatnonzero(~missing))
    return bool(len(apart)) and bool(apart[0] > 1) and bool(np.all(apart == apart[0]))


def is_angle(name: str) -> bool:
    """Whether a column is a table angle."""
    unit = split_unit(name)[1]
    return name.startswith("table_") and COLUMN_UNITS[str(unit)].quantity == "angle"


def angle_jumps(name: str, values: Array) -> Mask:
    """Steps of an angle by more than half a turn, (n - 1,)."""
    turn = 2 * np.pi / COLUMN_UNITS[str(split_unit(name)[1])].factor
    return np.abs(np.nan_to_num(np.diff(values))) > turn / 2


def frozen(values: Array) -> Mask:
    """Rows of runs of equal readings that are too long to be chance, (n,)."""
    first, last = _runs(values)
    length = last - first
    same = (len(values) - len(length)) / max(len(values), 1)
    if not 0 < same < 1:
        return np.zeros(len(values), dtype=bool)
    # a frozen stretch makes equal neighbours look frequent: they are counted without it
    usual = length[length <= np.quantile(length, 0.999)]
    same = min(same, max((usual.sum() - len(usual)) / max(usual.sum(), 1), 1 / len(values)))
    least = max(_RUN, 1 + np.log(_CHANCE / len(values)) / np.log(same))
    return _rows_of(first, last, length >= least, len(values))


def clipped(values: Array) -> Mask:
    """Rows in which a reading stays at the highest or lowest value of its channel, (n,)."""
    found = np.zeros(len(values), dtype=bool)
    first, last = _runs(values)
    levels = values[first]
    for end in (np.nanmax(values), np.nanmin(values)):
        at_end = (levels == end) & (last - first >= 3)
        if np.sum((last - first)[at_end]) < _AT_END:
            continue
        inside = np.abs(values[~np.isnan(values)] - end)
        count = np.unique(inside[inside <= _level_below(inside)], return_counts=True)[1]
        if count[0] > 3 * np.mean(count[1:] if len(count) > 1 else 0):
            found |= _rows_of(first, last, at_end, len(values))
    return found


def _level_below(distance: Array) -> float:
    """The distance from the end of the range that some further levels lie within."""
    wide = np.unique(distance)
    return float(wide[min(_LEVELS, len(wide) - 1)])


def _runs(values: Array) -> tuple[Index, Index]:
    """First row, and row after the last, of each run of equal values."""
    edges = np.flatnonzero(np.diff(values) != 0) + 1
    return np.append(0, edges), np.append(edges, len(values))


def _rows_of(first: Index, last: Index, chosen: Mask, n: int) -> Mask:
    rows = np.zeros(n, dtype=bool)
    for a, b in zip(first[chosen], last[chosen], strict=True):
        rows[a:b] = True
    return rows


def _found(
    kind: str, column: str, mask: Mask, description: str, repair: str = "", rows_shift: int = 1
) -> Finding:
    """A finding at the rows of a mask; ``rows_shift`` 1 where the mask is of steps."""
    rows = np.flatnonzero(mask) + rows_shift + 1
    count = len(rows)
    row_list = ", ".join(map(str, rows[:_SHOWN])) + (", ..." if count > _SHOWN else "")
    times = "once" if count == 1 else f"{count} times"
    return Finding(
        kind,
        column,
        count,
        tuple(int(r) for r in rows[:_SHOWN]),
        f"{column}: {description}, {times}, in data row {row_list}",
        repair,
    )
