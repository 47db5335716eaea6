"""Cells of a text file: where a line is cut, and what a cell holds."""

import csv
import re
from collections.abc import Callable

SEPARATORS: dict[str, str | None] = {
    "tab": "\t",
    "semicolon": ";",
    "comma": ",",
    "pipe": "|",
    "space": None,
}
EMPTY_WORDS = (
    "",
    "nan",
    "-nan",
    "na",
    "n/a",
    "#n/a",
    "null",
    "none",
    "-",
    "--",
    "1.#qnan",
    "-1.#ind",
)
"""Cells that hold no number, in small letters."""
COMMENTS = ("//", "#", "%", "!", ";")
STAMP = re.compile(
    r"\d{4}[-/]\d\d?[-/]\d\d?[T ]+\d\d?:\d\d(:\d\d([.,]\d+)?)?\s*(Z|UTC|[+-]\d\d:?\d\d)?"
)
_NUMBERS = {
    "point": re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?"),
    "comma": re.compile(r"[+-]?(\d+,?\d*|,\d+)([eE][+-]?\d+)?"),
}


def splitter(separator: str) -> Callable[[str], list[str]]:
    """What cuts a line into stripped cells."""
    mark = SEPARATORS[separator]
    if mark is None:
        return str.split

    def cut(line: str) -> list[str]:
        if '"' in line:
            return [c.strip() for c in next(csv.reader([line], delimiter=mark))]
        return [c.strip() for c in line.split(mark)]

    return cut


def kind_of(cell: str, decimal: str) -> str:
    """``number``, ``time`` (a date with a time of day), ``empty`` or ``text``."""
    if cell.lower() in EMPTY_WORDS:
        return "empty"
    if _NUMBERS[decimal].fullmatch(cell) or cell.lower() in ("inf", "-inf", "+inf"):
        return "number"
    return "time" if STAMP.fullmatch(cell) else "text"


def comment_of(line: str) -> str:
    """The comment mark that a line begins with; empty when it has none."""
    return next((c for c in COMMENTS if line.lstrip().startswith(c)), "")


def without_mark(line: str) -> str:
    """A line without the comment mark it may begin with."""
    mark = comment_of(line)
    return line.lstrip()[len(mark) :].strip() if mark else line
