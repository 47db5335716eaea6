"""Text logs of other systems, read by a mapping file: columns, units and time -> Recording."""

import contextlib
import io
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError, field_validator, model_validator

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError, nearest
from tiltcal.core.files import require_file
from tiltcal.core.units import COLUMN_UNITS, split_unit
from tiltcal.recordings.recording import Recording
from tiltcal.setup.sensor import Part

_SEPARATORS = {"space": None, "comma": ",", "tab": "\t", "semicolon": ";"}


class FileWords(Part):
    """Layout of the text."""

    separator: Literal["space", "comma", "tab", "semicolon"] = "comma"
    header: bool = True
    skip_lines: Annotated[int, Field(ge=0)] = 0


class TimeWords(Part):
    """Source of the time: a column, or the sample rate."""

    column: int | str | None = None
    unit: Literal["s", "ms", "us", "ns"] = "s"
    rate_hz: Annotated[float, Field(gt=0)] | None = None

    @model_validator(mode="after")
    def _one(self) -> "TimeWords":
        if (self.column is None) == (self.rate_hz is None):
            raise ValueError("give either column or rate_hz")
        return self


class ColumnWords(Part):
    """One channel: its column, and its name here."""

    from_: Annotated[int | str, Field(alias="from")]
    to: str
    file: str | None = None
    scale: float = 1.0
    offset: float = 0.0

    @model_validator(mode="after")
    def _unit(self) -> "ColumnWords":
        if split_unit(self.to)[1] is None:
            raise ValueError(f"'{self.to}' ends in no unit ({', '.join(COLUMN_UNITS)})")
        return self


class Mapping(Part):
    """A mapping file."""

    file: FileWords = FileWords()
    time: TimeWords
    column: tuple[ColumnWords, ...]
    metadata: dict[str, str] = {}

    @field_validator("column")
    @classmethod
    def _distinct(cls, columns: tuple[ColumnWords, ...]) -> tuple[ColumnWords, ...]:
        names = [c.to for c in columns]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"'{twice[0]}' stands twice")
        return columns


def load_mapping(path: Path | str) -> Mapping:
    """Read a mapping file.

    Raises:
        TiltcalError: naming every wrong key.
    """
    path = require_file(Path(path), "mapping")
    try:
        return Mapping.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise TiltcalError(
            f"mapping {path.name}", found=str(error), need="valid TOML", do="correct that line"
        ) from error
    except ValidationError as error:
        lines = "; ".join(_problem(e) for e in error.errors())
        raise TiltcalError(
            f"mapping {path.name}",
            found=lines,
            need="a mapping as `tiltcal import --help` shows",
            do="correct these keys",
        ) from error


_PARTS: dict[str, type[Part]] = {"file": FileWords, "time": TimeWords, "column": ColumnWords}


def _problem(error: Any) -> str:
    """One wrong key in words, with the nearest valid one."""
    path = ".".join(str(part + 1) if isinstance(part, int) else part for part in error["loc"])
    if error["type"] != "extra_forbidden":
        return f"{path}: {error['msg'].removeprefix('Value error, ')}"
    part = _PARTS.get(error["loc"][0], Mapping) if len(error["loc"]) > 1 else Mapping
    valid = [f.alias or name for name, f in part.model_fields.items()]
    return f"{path}: unknown key; {nearest(str(error['loc'][-1]), valid)}"


def import_recording(path: Path | str, mapping: Mapping) -> Recording:
    """A foreign text log as a Recording.

    Raises:
        TiltcalError: a file is missing, a cell is no number, or files differ in length.
    """
    path = require_file(Path(path), "foreign recording")
    tables: dict[str | None, _Table] = {None: _read(path, mapping.file)}
    for c in mapping.column:
        if c.file is not None and c.file not in tables:
            tables[c.file] = _read(
                require_file(path.parent / c.file, "foreign recording"), mapping.file
            )
    main = tables[None]
    if mapping.time.column is None:
        time = np.arange(len(main.cells)) / (mapping.time.rate_hz or 1.0)
    else:
        time = main.column(mapping.time.column) * COLUMN_UNITS[mapping.time.unit].factor
    columns = {}
    for c in mapping.column:
        table = tables[c.file]
        if len(table.cells) != len(main.cells):
            raise TiltcalError(
                f"foreign recording {c.file}",
                found=f"{len(table.cells)} rows",
                need=f"{len(main.cells)} as in {path.name}",
                do="import it on its own",
            )
        columns[c.to] = c.scale * table.column(c.from_) + c.offset
    metadata = {"imported from": path.name} | mapping.metadata
    return Recording.from_columns(time, columns, metadata=metadata, source=f"recording {path.name}")


class _Table:
    """Cells of a text file with the names of its columns."""

    def __init__(self, cells: Array, names: list[str], source: str) -> None:
        self.cells, self.names, self.source = cells, names, source

    def column(self, which: int | str) -> Array:
        """A column by number (from 1) or name, (n,)."""
        index = (
            which - 1
            if isinstance(which, int)
            else self.names.index(which)
            if which in self.names
            else -1
        )
        if not 0 <= index < self.cells.shape[1]:
            valid = self.names or [str(i + 1) for i in range(self.cells.shape[1])]
            raise TiltcalError(
                f"foreign recording {self.source}",
                found=f"no column {which}",
                need="a column of it",
                do=nearest(str(which), valid),
            )
        return self.cells[:, index]


def _read(path: Path, words: FileWords) -> _Table:
    text = path.read_text(encoding="utf-8", errors="replace")
    for _ in range(words.skip_lines):
        text = text.partition("\n")[2]
    names: list[str] = []
    separator = _SEPARATORS[words.separator]
    if words.header:
        head, _, text = text.partition("\n")
        names = [name.strip().strip('"') for name in head.split(separator)]
    first = text.lstrip().partition("\n")[0]
    width = len(first.split(separator))
    if not first:
        raise TiltcalError(
            f"foreign recording {path.name}",
            found="no rows",
            need="at least one",
            do="check the file",
        )
    return _Table(_numbers(text, separator, width, path), names, path.name)


def _numbers(text: str, separator: str | None, width: int, path: Path) -> Array:
    """All cells at once; only when that fails, line by line: empty cells are no number, and a bad
    one is named.
    """
    with contextlib.suppress(ValueError):
        table = np.loadtxt(io.StringIO(text), delimiter=separator, comments=None, ndmin=2)
        if table.shape[1] == width:
            return table
    rows = []
    for number, line in enumerate(text.splitlines(), start=1):
        cells = line.split(separator)
        if not line.strip():
            continue
        if len(cells) != width:
            raise TiltcalError(
                f"foreign recording {path.name}, data line {number}",
                found=f"{len(cells)} cells",
                need=f"{width} as in the first",
                do="correct that line, or set separator in the mapping",
            )
        rows.append([_cell(c, path.name, number) for c in cells])
    return np.array(rows)


def _cell(cell: str, source: str, line: int) -> float:
    if not cell.strip():
        return float("nan")
    try:
        return float(cell)
    except ValueError as error:
        raise TiltcalError(
            f"foreign recording {source}, data line {line}",
            found=f"the text '{cell.strip()}'",
            need="a number",
            do="correct that cell, or set header or skip_lines in the mapping",
        ) from error
