"""Files that are read back: JSON and TOML, each checked against a schema before anything uses
it.
"""

import json
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from tiltcal.core.errors import TiltcalError, shown
from tiltcal.core.files import require_document

Finite = Annotated[float, Field(allow_inf_nan=False)]
Model = TypeVar("Model", bound=BaseModel)


class Stored(BaseModel):
    """A part of a file that is read back: numbers are finite, and further keys are kept."""

    model_config = ConfigDict(extra="allow", allow_inf_nan=False, use_attribute_docstrings=True)


def read_json(path: Path, kind: str, need: str) -> dict[str, Any]:
    """The table in a JSON file.

    Raises:
        TiltcalError: it is missing, no JSON, or no table.
    """
    return _table(path, kind, need, _strict_json)


def read_toml(path: Path, kind: str, need: str) -> dict[str, Any]:
    """The table in a TOML file.

    Raises:
        TiltcalError: it is missing or no TOML.
    """
    return _table(path, kind, need, tomllib.loads)


def checked(model: type[Model], table: Mapping[str, Any], subject: str, need: str) -> Model:
    """A table of a file that was read back, checked.

    Raises:
        TiltcalError: naming the first key that does not fit.
    """
    try:
        return model.model_validate(table)
    except ValidationError as error:
        first = error.errors()[0]
        missing = first["type"] == "missing"
        path = [str(k + 1) if isinstance(k, int) else str(k) for k in first["loc"]]
        key = ".".join(path[:-1] if missing else path)
        raise TiltcalError(
            f"{subject}, key {key}" if key else subject,
            found=f"no key '{path[-1]}'" if missing else shown(first.get("input")),
            need=f"{need} ({first['msg'].removeprefix('Value error, ').lower()})",
            do="write it again",
        ) from error


def _strict_json(text: str) -> Any:
    """JSON without the numbers that it does not have."""
    return json.loads(text, parse_constant=_finite, parse_float=_finite)


def _finite(text: str) -> float:
    number = float(text)
    if not abs(number) < float("inf"):
        raise ValueError(f"{text}, which is no JSON")
    return number


def _table(path: Path, kind: str, need: str, parse: Any) -> dict[str, Any]:
    path = require_document(path, kind)
    try:
        table = parse(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        what = "bytes that are no text" if isinstance(error, UnicodeDecodeError) else str(error)
        raise TiltcalError(
            f"{kind} {path.name}", found=what, need=need, do="write it again"
        ) from error
    if not isinstance(table, dict):
        raise TiltcalError(
            f"{kind} {path.name}", found=shown(table), need=need, do="write it again"
        )
    return table
