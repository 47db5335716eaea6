"""Cells of a text file: splitting of lines, kinds of cells, text that is meant as a number, and
ISO 8601 time stamps with or without a zone.
"""

import csv
import re
import warnings
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from tiltcal.core.arrays import Array, Index
from tiltcal.core.errors import TiltcalError, shown
from tiltcal.recordings.formats.raw_table import Raw

SEPARATORS: dict[str, str | None] = {
    "tab": "\t",
    "semicolon": ";",
    "comma": ",",
    "pipe": "|",
    "space": None,
}
EMPTY_TEXTS = (
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
DATES = ("iso", "dmy", "mdy")
"""Orders of year, month and day in a date: year first as in ISO 8601, or last."""
_DAY_LAST = re.compile(r"(\d\d?)([-/.])(\d\d?)\2(\d{4})(?=[T ])")
STAMP = re.compile(
    r"(\d{4}[-/]\d\d?[-/]\d\d?|\d\d?([-/.])\d\d?\2\d{4})[T ]+\d\d?:\d\d(:\d\d([.,]\d+)?)?"
    r"\s*(Z|UTC|[+-]\d\d:?\d\d)?"
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
    if cell.lower() in EMPTY_TEXTS:
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


def numbers_in(texts: Raw, decimal: str) -> tuple[Array, Index]:
    """The numbers of a column, (n,), NaN for every other cell, and the rows of cells that are
    neither numbers nor empty.

    Args:
        texts: objects, (n,).
        decimal: point or comma.
    """
    values = np.full(len(texts), np.nan)
    bad = []
    for k, item in enumerate(texts):
        cell = "" if item is None else str(item).strip()
        kind = kind_of(cell, decimal)
        if kind == "number":
            values[k] = float(cell.replace(",", "."))
        elif kind != "empty":
            bad.append(k)
    return values, np.array(bad, dtype=np.intp)


_ZONE = re.compile(r"\s*(?:(Z|UTC)|([+-])(\d\d):?(\d\d))$")
_PARTS = re.compile(r"(\d{4})-(\d\d?)-(\d\d?)T(\d\d?):(.*)")
_MINUTE = 60 * 10**9  # ns


def order_of_dates(texts: Raw) -> str:
    """One of ``DATES``; empty where no date tells the day from the month.

    Args:
        texts: dates with a time of day, objects, (n,).
    """
    found = [d for t in texts if t is not None and (d := _DAY_LAST.match(str(t).strip()))]
    if not found:
        return "iso"
    if any(int(d[1]) > _MONTHS for d in found):
        return "dmy"
    if any(int(d[3]) > _MONTHS for d in found):
        return "mdy"
    return "dmy" if found[0][2] == "." else ""  # points stand in day.month.year alone (CLDR)


_MONTHS = 12  # of a year: a larger number is a day


def date_stamps(raw: Raw, source: str, order: str = "iso") -> npt.NDArray[np.datetime64]:
    """Stamps in UTC, datetime64[ns], (n,); those without a zone are taken as they are.

    Args:
        raw: dates with a time of day, (n,).
        source: of the file, for messages.
        order: of year, month and day, one of ``DATES``.

    Raises:
        TiltcalError: naming the first one that is no date with a time of day.
    """
    if raw.dtype.kind == "M":
        return raw.astype("datetime64[ns]")
    texts, shifts = [], np.zeros(len(raw), dtype=np.int64)
    for k, item in enumerate(raw):
        text = _year_first(str(item).strip(), order)
        zone = _ZONE.search(text)
        if zone:
            text = text[: zone.start()]
            if zone[2]:
                minutes = 60 * int(zone[3]) + int(zone[4])
                shifts[k] = (1 if zone[2] == "+" else -1) * minutes * _MINUTE
        texts.append(text.replace("/", "-").replace(",", ".").replace(" ", "T", 1))
    try:
        stamps = _dates(texts)
    except (ValueError, UserWarning) as error:
        raise _no_stamp(texts, source) from error
    return (stamps.astype(np.int64) - shifts).astype("datetime64[ns]")


def _year_first(text: str, order: str) -> str:
    """A date with its year first; unchanged where its order is not the one stated."""
    found = _DAY_LAST.match(text)
    if found is None or order == "iso":
        return text
    first, _, second, year = found.groups()
    month, day = (second, first) if order == "dmy" else (first, second)
    return f"{year}-{month}-{day}{text[found.end() :]}"


def _dates(texts: list[str]) -> npt.NDArray[np.datetime64]:
    with warnings.catch_warnings():  # numpy reads a zone that is left, and warns
        warnings.simplefilter("error")
        try:
            return np.array(texts, dtype="datetime64[ns]")
        except ValueError:
            return np.array([_padded(t) for t in texts], dtype="datetime64[ns]")


def _padded(text: str) -> str:
    """A date whose month, day and hour have two digits each."""
    found = _PARTS.fullmatch(text)
    if found is None:
        return text
    year, month, day, hour, remainder = found.groups()
    return f"{year}-{int(month):02d}-{int(day):02d}T{int(hour):02d}:{remainder}"


def _no_stamp(texts: list[str], source: str) -> TiltcalError:
    for number, text in enumerate(texts, start=1):
        try:
            _dates([text])
        except (ValueError, UserWarning):
            return TiltcalError(
                f"foreign recording {source}, data line {number}",
                found=f"the text {shown(text)}",
                need="a time such as 2026-05-04T12:30:00.250",
                do="correct that cell, or set time.column, and time.unit to iso, dmy or mdy",
            )
    return TiltcalError(
        f"foreign recording {source}", found="no time stamps", need="ISO 8601", do="check the file"
    )
