"""Mapping files: which columns of a foreign file become which channels, TOML."""

import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, ValidationError, field_validator, model_validator

from tiltcal.core.errors import TiltcalError, nearest
from tiltcal.core.files import require_document
from tiltcal.core.units import COLUMN_UNITS, split_unit
from tiltcal.data_quality import registry
from tiltcal.recordings.formats.cells import DATES
from tiltcal.setup.part import StrictTable

REPAIRS = (*registry.REPAIRS, "empty_text")
UNKNOWN = "?"
"""Placeholder in a proposed mapping for what the file does not state."""


def _known_repair(name: str) -> str:
    if name not in REPAIRS:
        raise ValueError(f"no such repair; {nearest(name, [*REPAIRS])}")
    return name


class InstanceOf(StrictTable):
    """The rows of one of several instruments that share a table: those with a value in a column."""

    column: str | int
    value: int | str

    @field_validator("value")
    @classmethod
    def _chosen(cls, value: int | str) -> int | str:
        if value == UNKNOWN:
            raise ValueError("value is '?': several instruments share the table; choose one")
        return value


class FileLayout(StrictTable):
    """Layout of the text, and the table that columns stand in where a file has several."""

    separator: Literal["space", "comma", "tab", "semicolon", "pipe"] = "comma"
    decimal: Literal["point", "comma"] = "point"
    encoding: str = "utf-8"
    skip_lines: Annotated[int, Field(ge=0)] = 0
    header: bool = True
    unit_row: bool = False
    comment: str = ""
    ragged_lines: Literal["refuse", "drop"] = "refuse"
    table: str = ""
    instance: InstanceOf | None = None


class TimeSource(StrictTable):
    """Source of the time: a column, or the sample rate."""

    column: int | str | None = None
    unit: Literal["s", "ms", "us", "ns", "iso", "dmy", "mdy"] = "s"
    tick_s: Annotated[float, Field(gt=0)] | None = None
    wraps_at: Annotated[float, Field(gt=0)] | None = None
    rate_hz: Annotated[float, Field(gt=0)] | None = None

    @property
    def period(self) -> float | None:
        """Time after which the counter starts again, s; None where that is not stated."""
        if self.wraps_at is None or self.unit in DATES:
            return None
        return self.wraps_at * (self.tick_s or COLUMN_UNITS[self.unit].factor)

    @model_validator(mode="before")
    @classmethod
    def _known(cls, given: Any) -> Any:
        for key in ("unit", "rate_hz", "column"):
            if isinstance(given, dict) and given.get(key) == UNKNOWN:
                raise ValueError(f"{key} is '?': the file does not state it; fill it in")
        return given

    @model_validator(mode="after")
    def _one(self) -> "TimeSource":
        if (self.column is None) == (self.rate_hz is None):
            raise ValueError("give either column or rate_hz")
        return self


class ColumnMapping(StrictTable):
    """One channel: its column, its name here, and its time column where that differs."""

    from_: Annotated[int | str, Field(alias="from")]
    to: str
    file: str | None = None
    table: str | None = None
    time: int | str | None = None
    scale: float = 1.0
    offset: float = 0.0

    @model_validator(mode="after")
    def _unit(self) -> "ColumnMapping":
        if self.to.endswith(f"_{UNKNOWN}"):
            raise ValueError(f"the unit of '{self.to}' is not known from the file; fill it in")
        if self.to != "label" and split_unit(self.to)[1] is None:
            raise ValueError(f"'{self.to}' ends in no unit ({', '.join(COLUMN_UNITS)})")
        return self


class Mapping(StrictTable):
    """A mapping file."""

    file: FileLayout = FileLayout()
    time: TimeSource
    column: Annotated[tuple[ColumnMapping, ...], Field(min_length=1)]
    repair: tuple[Annotated[str, AfterValidator(_known_repair)], ...] = ()
    metadata: dict[str, str] = {}

    @field_validator("column")
    @classmethod
    def _distinct(cls, columns: tuple[ColumnMapping, ...]) -> tuple[ColumnMapping, ...]:
        names = [c.to for c in columns]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"'{twice[0]}' stands twice")
        return columns

    def table_of(self, column: ColumnMapping) -> str:
        """The table that a column stands in."""
        return self.file.table if column.table is None else column.table


def load_mapping(path: Path | str, instance: int | None = None) -> Mapping:
    """Read a mapping file.

    Args:
        path: of the file.
        instance: value that replaces the one of ``file.instance``; None: as the file states.

    Raises:
        TiltcalError: naming every wrong key; or an instance is given, and the file has no column
            for it.
    """
    path = require_document(Path(path), "mapping")
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise _no_toml(path.name, error) from error
    return parse_mapping(text, path.name, instance)


def parse_mapping(text: str, name: str, instance: int | None = None) -> Mapping:
    """A mapping from its text.

    Args:
        text: TOML.
        name: of the file, for messages.
        instance: as in ``load_mapping``.

    Raises:
        TiltcalError: as ``load_mapping`` does.
    """
    try:
        content = tomllib.loads(text)
        if instance is not None:
            _choose(content, instance, name)
        return Mapping.model_validate(content)
    except tomllib.TOMLDecodeError as error:
        raise _no_toml(name, error) from error
    except ValidationError as error:
        lines = "; ".join(_problem(e) for e in error.errors())
        raise TiltcalError(
            f"mapping {name}",
            found=lines,
            need="a mapping as `tiltcal import --help` shows",
            do="correct these keys",
        ) from error


def _choose(content: dict[str, Any], instance: int, name: str) -> None:
    """Set the value of ``file.instance``."""
    layout = content.get("file")
    stated = layout.get("instance") if isinstance(layout, dict) else None
    if not isinstance(stated, dict):
        raise TiltcalError(
            f"mapping {name}",
            found=f"--instance {instance}, and no column that tells instruments apart",
            need='[file] instance = { column = "I", value = 0 }',
            do="add it, or leave out --instance",
        )
    stated["value"] = instance


def _no_toml(name: str, error: ValueError) -> TiltcalError:
    return TiltcalError(
        f"mapping {name}", found=str(error), need="valid TOML", do="correct that line"
    )


_PARTS: dict[str, type[StrictTable]] = {
    "file": FileLayout,
    "time": TimeSource,
    "column": ColumnMapping,
}


def _problem(error: Any) -> str:
    """Message on one wrong key, with the nearest valid one."""
    path = ".".join(str(part + 1) if isinstance(part, int) else part for part in error["loc"])
    if error["type"] != "extra_forbidden":
        return f"{path}: {error['msg'].removeprefix('Value error, ')}"
    part = _PARTS.get(error["loc"][0], Mapping) if len(error["loc"]) > 1 else Mapping
    valid = [f.alias or name for name, f in part.model_fields.items()]
    return f"{path}: unknown key; {nearest(str(error['loc'][-1]), valid)}"
