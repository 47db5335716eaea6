"""Lines in which a name stands before each number, as programs print them to a serial monitor:
``x: 1 y: 2 z: 3`` or ``ax=1, ay=2``.
"""

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tiltcal.core.errors import TiltcalError
from tiltcal.recordings.formats.budget import ReadBudget
from tiltcal.recordings.formats.raw_table import RAGGED, Raw, RawFile, RawTable, typed
from tiltcal.recordings.formats.unit_words import unit_of

_PAIR = re.compile(
    r"\s*([^\W\d][^:=]{0,40}?)\s*[:=]\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(?=[\s,;|]|[^\W\d]|$)"
)
_BETWEEN = " \t,;|"
_CLOCK = re.compile(r"\s*(\d\d):(\d\d):(\d\d(?:\.\d+)?)\s*->\s*")
"""Time of day that the Arduino serial monitor puts before a line."""
_RECEIVED = "received"
_MOSTLY = 0.8  # share of the lines that have the same names
_HEAD = 1 << 14  # bytes that the lines are recognised by
_LEAST = 3  # lines

Cells = tuple[tuple[str, ...], tuple[str, ...], dict[str, str]]
"""Names, numbers and units of a line."""


def are_labelled_lines(path: Path) -> bool:
    """Whether most of the first lines of a file name each of their numbers, and the same ones."""
    with path.open("rb") as file:
        head = file.read(_HEAD)
        whole = len(head) < _HEAD
    lines = [x for x in _lines(head if whole else head.rpartition(b"\n")[0]) if x.strip()]
    found = [cells[0] for x in lines if (cells := _cells(x)) is not None]
    if len(found) < _LEAST:
        return False
    return Counter(found).most_common(1)[0][1] > _MOSTLY * len(lines)


def read_labelled_lines(path: Path, budget: ReadBudget) -> RawFile:
    """A column for each name; lines with other names are left out.

    Raises:
        TiltcalError: it is above the budget, or no line has two names.
    """
    budget.require(path.stat().st_size, path.name)
    lines = [x for x in _lines(path.read_bytes()) if x.strip()]
    cells = [c for x in lines if (c := _cells(x)) is not None]
    if not cells:
        raise TiltcalError(
            f"foreign recording {path.name}",
            found="no line with a name before each number",
            need="lines such as x: 1 y: 2 z: 3",
            do="check the file",
        )
    names = Counter(c[0] for c in cells).most_common(1)[0][0]
    rows = [c for c in cells if c[0] == names]
    columns = tuple((n, _column([r[1][k] for r in rows])) for k, n in enumerate(names))
    lost = len(lines) - len(rows)
    return RawFile(
        path.name,
        "lines of names and numbers",
        (RawTable("", columns, rows[0][2], {RAGGED: str(lost)} if lost else {}),),
    )


def _lines(data: bytes) -> list[str]:
    return data.decode(errors="replace").lstrip("\ufeff").splitlines()


def _column(texts: Sequence[str]) -> Raw:
    whole = all(re.fullmatch(r"[+-]?\d{1,18}", t) for t in texts)
    values = typed(np.array([int(t) for t in texts] if whole else [float(t) for t in texts]))
    assert values is not None
    return values


def _cells(line: str) -> Cells | None:
    """The cells of a line that has nothing but names, numbers and units, two at least."""
    clock = _CLOCK.match(line)
    names, values = ([], []) if clock is None else ([_RECEIVED], [_seconds(clock)])
    units: dict[str, str] = {} if clock is None else {_RECEIVED: "s"}
    at, owner = (0 if clock is None else clock.end()), ""
    while found := _PAIR.match(line, at):
        unit, name = _unit_before(found[1].strip(_BETWEEN))
        if unit:
            units[names[-1] if names else ""] = unit
        axis = name.lower() in ("x", "y", "z")
        name, owner = (owner + name, owner) if axis else (name, _owner(name))
        names.append(name)
        values.append(found[2])
        at = found.end()
        while at < len(line) and line[at] in _BETWEEN:
            at += 1
    tail = line[at:].strip(_BETWEEN)
    if len(names) < 2 or (tail and unit_of(tail) is None) or len(set(names)) < len(names):
        return None
    return tuple(names), tuple(values), units | ({names[-1]: tail} if tail else {})


def _seconds(clock: re.Match[str]) -> str:
    return str(3600 * int(clock[1]) + 60 * int(clock[2]) + float(clock[3]))


def _unit_before(text: str) -> tuple[str, str]:
    """The unit of the number before, and the name: ``g y`` in ``x: 1 g y: 2``."""
    first, _, name = text.partition(" ")
    if not name.strip() and "," in text:
        first, _, name = text.partition(",")
    first = first.strip(_BETWEEN)
    return (first, name.strip(_BETWEEN)) if name and unit_of(first) else ("", text)


def _owner(name: str) -> str:
    """What stands before the axis of a name: ``Accel `` of ``Accel X``."""
    found = re.fullmatch(r"(.*[^a-zA-Z])[xyzXYZ]", name)
    return found[1] if found else ""
