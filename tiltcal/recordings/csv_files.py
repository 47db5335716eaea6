"""Recordings as CSV files, with metadata lines before the header."""

import csv
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import islice
from pathlib import Path
from typing import IO, Any

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError, shown
from tiltcal.core.safe_text import cell_of, comment_of, text_of
from tiltcal.core.units import split_unit
from tiltcal.recordings.arrow_columns import arrow_table, to_numpy
from tiltcal.recordings.samples import Columns, Labels

MOST_COLUMNS = 4096
LONGEST = 1 << 22  # characters of a line before the first row
HEAD = 1 << 18  # bytes from which the length of a line is estimated


def is_number(name: str) -> bool:
    """Whether a column of that name is numeric (its name ends in a unit)."""
    return name != "label" and split_unit(name)[1] is not None


def require_few(columns: int, path: Path) -> None:
    """Refuse a file with more columns than any instrument has.

    Raises:
        TiltcalError: stating how many.
    """
    if columns > MOST_COLUMNS:
        raise TiltcalError(
            f"recording {path.name}",
            found=f"{columns} columns",
            need=f"at most {MOST_COLUMNS}",
            do="leave out those that are no channel",
        )


def csv_head(path: Path) -> tuple[dict[str, str], list[str], int]:
    """Metadata, column names and the number of lines before the first data row.

    Raises:
        TiltcalError: there is no header, or a name stands twice.
    """
    metadata: dict[str, str] = {}
    with path.open(newline="", encoding="utf-8-sig", errors="replace") as lines:
        for number, line in enumerate(iter(partial(lines.readline, LONGEST), ""), start=1):
            if len(line) == LONGEST:
                raise TiltcalError(
                    f"recording {path.name}, line {number}",
                    found=f"{LONGEST} characters and more",
                    need="lines of metadata, and a header",
                    do="check the file",
                )
            if line.startswith("#"):
                key, colon, value = line[1:].partition(":")
                if colon:
                    metadata[key.strip()] = value.strip()
            elif line.strip():
                names = _names(line, path, number)
                require_few(len(names), path)
                twice = sorted(name for name, count in Counter(names).items() if count > 1)
                if twice:
                    raise TiltcalError(
                        f"recording {path.name}, line {number}",
                        found=f"column {twice[0]} twice",
                        need="each column once",
                        do="rename one of them",
                    )
                return metadata, names, number
    raise TiltcalError(
        f"recording {path.name}", found="no header line", need="column names", do="add the header"
    )


def _names(line: str, path: Path, number: int) -> list[str]:
    """The column names of a header."""
    try:
        return [text_of(name.strip()) for name in next(csv.reader([line]))]
    except csv.Error as error:
        raise TiltcalError(
            f"recording {path.name}, line {number}",
            found=str(error),
            need="column names",
            do="check the file",
        ) from error


def read_csv(path: Path) -> tuple[dict[str, Array | Labels], dict[str, str]]:
    """All columns, (n,) each, and the metadata.

    Raises:
        TiltcalError: a cell is no number, naming its row and column.
    """
    import pyarrow as pa
    from pyarrow import csv as pacsv

    metadata, names, skip = csv_head(path)
    try:
        table = pacsv.read_csv(path, **_options(names, skip))
    except pa.ArrowInvalid as error:
        if "Empty CSV" in str(error) or "skip initial" in str(error):
            return {name: np.zeros(0) for name in names}, metadata
        raise _bad_cell(path, names, skip, str(error)) from error
    return {name: _column(table.column(i), name) for i, name in enumerate(names)}, metadata


def csv_pieces(path: Path) -> Iterator[dict[str, Array | Labels]]:
    """The columns of a CSV file piece by piece, (n,) each; nothing where there are no rows.

    Raises:
        TiltcalError: naming the first line that does not read.
    """
    import pyarrow as pa
    from pyarrow import csv as pacsv

    _, names, skip = csv_head(path)
    options = _options(names, skip, use_threads=False)
    try:
        with pacsv.open_csv(path, **options) as reader:
            for batch in reader:
                yield {n: _column(batch.column(i), n) for i, n in enumerate(names)}
    except pa.ArrowInvalid as error:
        if not ("Empty CSV" in str(error) or "skip initial" in str(error)):
            raise _bad_cell(path, names, skip, str(error)) from error


def estimated_csv_rows(path: Path) -> int:
    """About how many rows a CSV file has: its size over the mean length of its first lines."""
    with path.open("rb") as file:
        head = file.read(HEAD)
    lines = [line for line in head.split(b"\n")[:-1] if not line.startswith(b"#")]
    return path.stat().st_size * len(lines) // max(len(head), 1)


def _options(names: list[str], skip: int, use_threads: bool = True) -> dict[str, Any]:
    """How a CSV file is read, after so many lines."""
    import pyarrow as pa
    from pyarrow import csv as pacsv

    return {
        "read_options": pacsv.ReadOptions(
            skip_rows=skip, column_names=names, encoding="utf8", use_threads=use_threads
        ),
        "parse_options": pacsv.ParseOptions(newlines_in_values=False),
        "convert_options": pacsv.ConvertOptions(
            column_types={n: pa.float64() if is_number(n) else pa.string() for n in names},
            null_values=EMPTY,
            strings_can_be_null=True,
            quoted_strings_can_be_null=True,
        ),
    }


def _column(cells: Any, name: str) -> Array | Labels:
    """A column of cells as floats or text."""
    if is_number(name):
        return to_numpy(cells, number=True)
    texts = to_numpy(cells, number=False)
    decoded = {text: text if text is None else text_of(text) for text in set(texts)}
    return np.array([decoded[text] for text in texts], dtype=object)


def _bad_cell(path: Path, names: list[str], skip: int, reason: str) -> TiltcalError:
    """The first line that does not read, found slowly because it is only needed once."""
    try:
        return _first_bad_line(path, names, skip, reason)
    except csv.Error as error:
        return TiltcalError(
            f"recording {path.name}", found=str(error), need="a CSV table", do="check the file"
        )


def _first_bad_line(path: Path, names: list[str], skip: int, reason: str) -> TiltcalError:
    with path.open(newline="", encoding="utf-8-sig", errors="replace") as lines:
        for number, row in enumerate(csv.reader(islice(lines, skip, None)), start=skip + 1):
            if row and len(row) != len(names):
                return TiltcalError(
                    f"recording {path.name}, line {number}",
                    found=f"{len(row)} cells",
                    need=f"{len(names)} as in the header",
                    do="complete or remove that line",
                )
            for name, cell in zip(names, row, strict=False):
                if is_number(name) and cell.strip() and not _reads_as_number(cell):
                    return TiltcalError(
                        f"recording {path.name}, line {number}, column {name}",
                        found=f"the text {shown(cell)}",
                        need="a number or an empty cell",
                        do="correct or empty that cell",
                    )
    return TiltcalError(
        f"recording {path.name}", found=reason, need="a CSV table", do="check the file"
    )


def _reads_as_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell


def write_csv_file(recording: Columns, path: Path) -> None:
    """Write a recording as CSV."""
    with path.open("wb") as out:
        write_csv(recording, out)


def write_csv(recording: Columns, out: IO[bytes]) -> None:
    """Write a recording as CSV into an open binary file."""
    with csv_writer(out) as write:
        write(recording)


@contextmanager
def csv_writer(out: IO[bytes]) -> Iterator[Callable[[Columns], None]]:
    """What appends pieces of a recording to an open binary file, each with the columns of the
    first.
    """
    from pyarrow import csv as pacsv

    names: list[str] = []

    def write(piece: Columns) -> None:
        if not names:
            names.extend(piece.written_names)
            write_head(out, piece.metadata, names)
        table = arrow_table(piece, names, cell_of)
        pacsv.write_csv(table, out, pacsv.WriteOptions(include_header=False))

    yield write


def write_head(out: IO[bytes], metadata: Mapping[str, str], names: Sequence[str]) -> None:
    """Metadata, one line each, and the line of column names."""
    for key, value in metadata.items():
        out.write(f"# {comment_of(key)}: {comment_of(value)}\n".encode())
    out.write((",".join(_quoted(cell_of(name)) for name in names) + "\n").encode())


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"' if any(c in name for c in ',"\n') else name


EMPTY = [" " * k for k in range(9)]  # cells that hold nothing
