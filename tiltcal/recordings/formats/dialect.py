"""The dialect of a text file, determined from its first lines: separator, decimal mark, lines
before the header, header and unit row.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from tiltcal.recordings.formats.cells import (
    comment_of,
    kind_of,
    splitter,
    without_mark,
)
from tiltcal.recordings.formats.unit_words import unit_of
from tiltcal.recordings.mapping import FileLayout

_NUMERIC = {"number", "time", "empty"}
_MOSTLY = 0.8  # share of a column's cells that makes its kind


@dataclass(frozen=True)
class Dialect:
    """How a text is to be read.

    Args:
        layout: as a mapping states it.
        reasons: key of ``layout`` -> reason.
        doubts: properties that the first lines do not determine.
        before: lines before the data.
        misfit: names of a line that has one too few or too many for the columns.
    """

    layout: FileLayout
    reasons: Mapping[str, str]
    doubts: Sequence[str] = ()
    before: Sequence[str] = ()
    misfit: Sequence[str] = ()


@dataclass(frozen=True)
class Grid:
    """The lines cut in one way.

    Args:
        separator, decimal: how.
        rows: (cells of a line) for each line.
        width: the most frequent number of cells in the later lines.
        score: share of cells in lines of that width that are numbers.
    """

    separator: str
    decimal: str
    rows: Sequence[Sequence[str]]
    width: int
    score: float


def find_dialect(head: str, encoding: str, why: str) -> Dialect | None:
    """The dialect of a text; None where no table of numbers is found.

    Args:
        head: whole lines from its beginning.
        encoding, why: as guessed, and the reason.
    """
    lines = head.split("\n")
    content = [line for line in lines if line.strip() and not comment_of(line)]
    if not content:
        return None
    grids = [g for g in _grids(content, '"' in head) if g.score > 0]
    if not grids:
        return None
    best = max(grids, key=lambda g: round(g.score, 3))
    start = _first_data(lines, best)
    if start is None:
        return None
    head_layout, reasons, misfit = _head(lines, start, best)
    layout = FileLayout.model_validate(
        {
            "separator": best.separator,
            "decimal": best.decimal,
            "encoding": encoding,
            "comment": _comment_inside(lines[start:]),
            **head_layout,
        }
    )
    share = f"{best.score:.0%} of the cells of {len(best.rows)} lines are numbers"
    reasons |= {
        "separator": f"cut so, {share} in {best.width} columns",
        "decimal": _decimal_reason(best),
        "encoding": why,
    }
    doubts = [*_decimal_doubts(best)]
    return Dialect(layout, reasons, doubts, lines[:start], misfit)


def _grids(content: Sequence[str], quoted: bool) -> list[Grid]:
    found = []
    for separator in ("tab", "semicolon", "comma", "pipe", "space"):
        for decimal in ("point", "comma"):
            if separator == decimal == "comma" and not quoted:
                continue
            cut = splitter(separator)
            rows = [cut(line) for line in content]
            later = rows[len(rows) // 3 :]
            width = Counter(map(len, later)).most_common(1)[0][0]
            cells = [kind_of(c, decimal) for row in later if len(row) == width for c in row]
            numbers = sum(kind in _NUMERIC for kind in cells) / max(len(cells), 1)
            same = sum(len(row) == width for row in later) / len(later)
            filled = any(kind == "number" for kind in cells)
            score = numbers * same * (1.0 if width > 1 else 0.9) * filled
            found.append(Grid(separator, decimal, rows, width, score))
    return found


def _kinds(grid: Grid) -> list[str]:
    """Most frequent kind of the cells of each column in the later lines."""
    later = [row for row in grid.rows[len(grid.rows) // 3 :] if len(row) == grid.width]
    kinds = []
    for k in range(grid.width):
        cells = [kind_of(row[k], grid.decimal) for row in later]
        held = [c for c in cells if c != "empty"]
        numeric = sum(c in _NUMERIC for c in held) >= _MOSTLY * max(len(held), 1)
        kinds.append("number" if numeric else "text")
    return kinds


def _first_data(lines: Sequence[str], grid: Grid) -> int | None:
    """The line that the data begin in."""
    cut, kinds = splitter(grid.separator), _kinds(grid)
    for number, line in enumerate(lines):
        cells = cut(line)
        if not line.strip() or comment_of(line) or len(cells) != grid.width:
            continue
        held = [kind_of(c, grid.decimal) for c, kind in zip(cells, kinds) if kind == "number"]
        if all(kind in _NUMERIC for kind in held) and "number" in held:
            return number
    return None


def _head(
    lines: Sequence[str], start: int, grid: Grid
) -> tuple[dict[str, int | bool], dict[str, str], list[str]]:
    """skip_lines, header and unit_row, with their reasons, and the names of a line that has not
    one for each column.
    """
    before = [k for k in range(start) if lines[k].strip()]
    named = [k for k in before[-2:] if _fits(lines[k], grid)]
    none = {"header": f"line {start + 1} holds numbers, no line of names stands before it"}
    if not named or named[-1] != before[-1]:
        if before:
            none["skip_lines"] = f"{start} lines before the data, none with a name a column"
        return {"skip_lines": start, "header": False}, none, []
    units = len(named) == 2 and _are_units(lines[named[1]], grid)
    at = named[0] if units else named[-1]
    names = _names(lines[at], grid)
    reason = f"line {at + 1} holds {len(names)} names"
    if len(names) != grid.width:
        none = {
            "header": f"{reason} for {grid.width} columns",
            "skip_lines": f"{start} lines before the data",
        }
        return {"skip_lines": start, "header": False}, none, names
    layout: dict[str, int | bool] = {"skip_lines": at, "header": True}
    reasons = {"header": reason, "skip_lines": f"{at} lines stand before it"}
    if units:
        layout["unit_row"] = True
        reasons["unit_row"] = f"line {named[1] + 1} holds units"
    return layout, reasons, []


def _names(line: str, grid: Grid) -> list[str]:
    """The names in a line; separators that end the line, or the lines of the data, add none."""
    names = [c.strip('"') for c in splitter(grid.separator)(without_mark(line))]
    while len(names) > grid.width and not names[-1]:
        names.pop()
    rows = [row for row in grid.rows if len(row) == grid.width]
    rows = rows[len(rows) // 3 :]
    if len(names) == grid.width - 1 and not any(row[-1] for row in rows):
        names.append(str(grid.width))
    return names


def _fits(line: str, grid: Grid) -> bool:
    """Whether a line has a name for each column; a trailing separator may be missing."""
    cells = splitter(grid.separator)(without_mark(line))
    named = [c for c in cells if c]
    texts = sum(kind_of(c, grid.decimal) == "text" for c in named)
    return abs(len(cells) - grid.width) <= (grid.width > 1) and 2 * texts > len(named) > 0


def _are_units(line: str, grid: Grid) -> bool:
    cells = [c for c in splitter(grid.separator)(without_mark(line)) if c]
    known = sum(unit_of(c) is not None or c.startswith(("[", "(")) for c in cells)
    return known > len(cells) / 2


def _comment_inside(data: Sequence[str]) -> str:
    """The mark of comments among the data."""
    marks = [mark for line in data if (mark := comment_of(line))]
    return marks[0] if marks else ""


def _decimal_reason(grid: Grid) -> str:
    mark = {"point": ".", "comma": ","}[grid.decimal]
    seen = any(mark in cell for row in grid.rows for cell in row if cell)
    return f"numbers hold '{mark}'" if seen else "no number has decimals"


def _decimal_doubts(grid: Grid) -> list[str]:
    if grid.decimal == "point":
        return []
    parts = [
        c.partition(",")[2] for row in grid.rows for c in row if "," in c and kind_of(c, "comma")
    ]
    if parts and all(len(p) == 3 for p in parts):
        return [
            "whether the comma is a decimal mark or groups thousands:"
            " three digits follow it everywhere"
        ]
    return []


def stated_values(lines: Sequence[str]) -> dict[str, str]:
    """``key: value`` and ``key = value`` of lines before the data."""
    found = {}
    for line in lines:
        text = without_mark(line)
        for mark in (":", "="):
            key, there, value = text.partition(mark)
            if there and 0 < len(key.strip()) <= 40 and value.strip():
                found[key.strip()] = value.strip()
                break
    return found
