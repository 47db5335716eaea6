"""Text files: CSV and its relatives, whatever separates their cells and whatever their encoding,
which is guessed by their bytes.
"""

import codecs
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np

from tiltcal.core.errors import TiltcalError, shown
from tiltcal.recordings.csv_files import require_few
from tiltcal.recordings.formats.budget import ReadBudget
from tiltcal.recordings.formats.cells import (
    EMPTY_TEXTS,
    SEPARATORS,
    kind_of,
    splitter,
    without_mark,
)
from tiltcal.recordings.formats.dialect import Dialect, find_dialect, stated_values
from tiltcal.recordings.formats.raw_table import CUT, RAGGED, Raw, RawFile, RawTable
from tiltcal.recordings.mapping import FileLayout

_MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
_HIGH = 0x80
_GB2312 = 0xA1  # both bytes of a character of GB 2312 are at least this


def guess_encoding(head: bytes) -> tuple[str, str]:
    """The encoding of a text, and the reason.

    Args:
        head: the beginning of the file.
    """
    for mark, name in _MARKS:
        if head.startswith(mark):
            return name, "a byte order mark states it"
    pairs = head[: len(head) // 2 * 2]
    if pairs and pairs[1::2].count(0) > len(pairs) / 8:
        return "utf-16-le", "every second byte is zero"
    if pairs and pairs[::2].count(0) > len(pairs) / 8:
        return "utf-16-be", "every first byte of two is zero"
    if head.isascii():
        return "utf-8", "all characters are ASCII"
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        if _in_pairs(head):
            return "gb18030", "no UTF-8; high bytes stand in pairs as in GBK"
        return "cp1252", "no UTF-8; single high bytes as in Western European text"
    return "utf-8", "all bytes are valid UTF-8"


def _in_pairs(head: bytes) -> bool:
    """Whether all bytes above ASCII stand in pairs of GB 2312."""
    k, end = 0, len(head) - 1
    while k < end:
        if head[k] >= _HIGH:
            if head[k] < _GB2312 or head[k + 1] < _GB2312:
                return False
            k += 1
        k += 1
    return True


def to_utf8(data: bytes, encoding: str, source: str) -> bytes:
    """The text in UTF-8 without a byte order mark, line ends as ``\\n``.

    Raises:
        TiltcalError: the encoding has no such name, or the text is not written in it.
    """
    for mark, name in _MARKS:
        if data.startswith(mark):
            encoding = name
    try:
        codec = codecs.lookup(encoding)
        if codec.name == "utf-8":
            data = data.removeprefix(codecs.BOM_UTF8)
            if not data.isascii():
                data = data.decode("utf-8", errors="replace").encode()
        else:
            data = data.decode(encoding).encode("utf-8", errors="replace")
    except (LookupError, UnicodeError) as error:
        raise TiltcalError(
            f"foreign recording {source}",
            found=str(error),
            need=f"text in {encoding}",
            do="set file.encoding in the mapping: utf-8, utf-16, gb18030, cp1252",
        ) from error
    return data.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in data else data


_HEAD = 1 << 16  # bytes that a dialect is found by


def read_text(path: Path, layout: FileLayout, budget: ReadBudget) -> RawFile:
    """A text file in a stated layout.

    Raises:
        TiltcalError: there are no rows, fewer lines than are to be skipped, or a line has another
            number of cells than the first.
    """
    budget.require(path.stat().st_size, path.name)
    data = to_utf8(path.read_bytes(), layout.encoding, path.name)
    start = 0
    before: list[str] = []
    while len(before) < layout.skip_lines and start < len(data):
        line, start = _line(data, start)
        before.append(line)
    if len(before) < layout.skip_lines:
        raise TiltcalError(
            f"foreign recording {path.name}",
            found=f"{len(before)} lines",
            need=f"more than the {layout.skip_lines} of skip_lines",
            do="correct file.skip_lines in the mapping",
        )
    names, units, start = _titles(data, start, layout)
    if layout.comment and layout.comment.encode() in data:
        data, start = _without_comments(data[start:], layout.comment.encode()), 0
    width = _width(data, start, layout, path.name)
    require_few(width, path)
    data, cut = _without_cut_line(data, start, layout, width)
    names = (names + [str(k + 1) for k in range(len(names), width)])[:width]
    ragged: list[int] = []
    values = _columns(data, start, layout, width, path.name, ragged)
    columns = tuple(zip(names, values, strict=True))
    metadata = stated_values(before) | ({CUT: cut} if cut else {})
    metadata |= {RAGGED: str(len(ragged))} if ragged else {}
    return RawFile(path.name, "text", (RawTable("", columns, units, metadata),))


def text_dialect(path: Path) -> Dialect:
    """The dialect that the first lines of a text show.

    Raises:
        TiltcalError: no table of numbers is found.
    """
    with path.open("rb") as file:
        head = file.read(_HEAD)
        whole = not file.read(1)
    encoding, why = guess_encoding(head)
    usable = head if len(head) % 2 == 0 else head[:-1]
    text = (
        to_utf8(usable, encoding, path.name).decode(errors="replace")
        if encoding.startswith("utf-16")
        else head.decode(encoding, errors="replace").lstrip("\ufeff").replace("\r\n", "\n")
    )
    lines = text if whole else text.rpartition("\n")[0]
    dialect = find_dialect(lines.replace("\r", "\n"), encoding, why)
    if dialect is None:
        raise TiltcalError(
            f"foreign recording {path.name}",
            found="no table of numbers in its first lines",
            need="rows of cells that a separator divides",
            do="check the file, or describe it in a mapping",
        )
    return dialect


def _line(data: bytes, start: int) -> tuple[str, int]:
    """The line that begins at a byte, and the byte after it."""
    end = data.find(b"\n", start)
    end = len(data) if end < 0 else end
    return data[start:end].decode(), min(end + 1, len(data))


def _titles(data: bytes, start: int, layout: FileLayout) -> tuple[list[str], dict[str, str], int]:
    """Names and units of the columns, and the byte after them."""
    if not layout.header:
        return [], {}, start
    cut = splitter(layout.separator)
    head, start = _line(data, start)
    names = [name.strip('"') for name in cut(without_mark(head))]
    if not layout.unit_row:
        return names, {}, start
    row, start = _line(data, start)
    stated = [unit.strip('"') for unit in cut(without_mark(row))]
    return names, {n: u for n, u in zip(names, stated) if u}, start


def _without_comments(data: bytes, mark: bytes) -> bytes:
    return b"\n".join(x for x in data.split(b"\n") if not x.lstrip().startswith(mark))


def _without_cut_line(data: bytes, start: int, layout: FileLayout, width: int) -> tuple[bytes, str]:
    """The text without a last line that ends before its last cell, and that line."""
    if data.endswith(b"\n"):
        return data, ""
    begin = max(data.rfind(b"\n"), start - 1) + 1
    last = data[begin:].decode(errors="replace")
    if begin <= start or len(splitter(layout.separator)(last)) >= width:
        return data, ""
    return data[:begin], last


def _width(data: bytes, start: int, layout: FileLayout, source: str) -> int:
    """The number of cells of the first line that is not blank."""
    while start < len(data):
        line, start = _line(data, start)
        if line.strip():
            return len(splitter(layout.separator)(line))
    raise TiltcalError(
        f"foreign recording {source}", found="no rows", need="at least one", do="check the file"
    )


def _columns(
    data: bytes, start: int, layout: FileLayout, width: int, source: str, ragged: list[int]
) -> list[Raw]:
    """All columns, (n,) each; their types follow from their cells."""
    import pyarrow as pa
    from pyarrow import csv as pacsv

    mark = SEPARATORS[layout.separator]
    if mark is None:
        lines = data[start:].split(b"\n")
        data, start, mark = b"\n".join(b"\t".join(line.split()) for line in lines), 0, "\t"
    empty = sorted({e for w in EMPTY_TEXTS for e in (w, w.upper(), w.capitalize(), "NaN", "N/a")})
    try:
        table = pacsv.read_csv(
            cast(Any, pa.BufferReader(memoryview(data)[start:])),
            read_options=pacsv.ReadOptions(column_names=[str(k) for k in range(width)]),
            parse_options=pacsv.ParseOptions(
                delimiter=mark,
                invalid_row_handler=_dropping(ragged) if layout.ragged_lines == "drop" else None,
            ),
            convert_options=pacsv.ConvertOptions(
                null_values=[*empty, *(" " * k for k in range(1, 9))],
                strings_can_be_null=True,
                decimal_point="," if layout.decimal == "comma" else ".",
            ),
        )
    except pa.ArrowInvalid as error:
        raise _ragged(data[start:], layout, width, source, str(error)) from error
    return [arrow_to_numpy(table.column(k)) for k in range(width)]


def arrow_to_numpy(column: Any) -> Raw:
    """An Arrow column as int64, float64, datetime64[ns] or objects, (n,)."""
    import pyarrow as pa

    kind = column.type
    if pa.types.is_timestamp(kind):
        return np.asarray(column.to_numpy().astype("datetime64[ns]"))
    if pa.types.is_integer(kind) and not column.null_count:
        return np.asarray(column.to_numpy(), dtype=np.int64)
    if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_null(kind):
        return np.asarray(column.cast(pa.float64()).to_numpy(), dtype=float)
    return np.array(column.cast(pa.string()).to_pylist(), dtype=object)


def _dropping(ragged: list[int]) -> Callable[[Any], Any]:
    """What leaves out a line of another width, and counts it."""

    def drop(row: Any) -> str:
        ragged.append(row.actual_columns)
        return "skip"

    return drop


def _ragged(data: bytes, layout: FileLayout, width: int, source: str, reason: str) -> TiltcalError:
    """The first line with another number of cells, found slowly because it is needed once."""
    cut = splitter("tab" if layout.separator == "space" else layout.separator)
    for number, line in enumerate(data.decode(errors="replace").split("\n"), start=1):
        if line.strip() and len(cut(line)) != width:
            return TiltcalError(
                f"foreign recording {source}, data line {number}",
                found=f"{len(cut(line))} cells",
                need=f"{width} as in the first",
                do="correct that line, set separator in the mapping, or drop such lines"
                " (ragged_lines)",
            )
    return TiltcalError(
        f"foreign recording {source}", found=reason, need="a text table", do="check the file"
    )


def bad_cell(texts: Raw, source: str, decimal: str) -> TiltcalError:
    """The error of a column that ought to hold numbers: its first cell that is none.

    Args:
        source: of the table.
        decimal: sign of the file.
        texts: (n,), objects.
    """
    number, cell = next(
        (
            (k, str(t))
            for k, t in enumerate(texts, start=1)
            if t is not None and kind_of(str(t).strip(), decimal) not in ("number", "empty")
        ),
        (1, str(texts[0])),
    )
    return TiltcalError(
        f"foreign recording {source}, data line {number}",
        found=f"the text {shown(cell.strip())}",
        need="a number",
        do="correct that cell, or set header or skip_lines in the mapping",
    )
