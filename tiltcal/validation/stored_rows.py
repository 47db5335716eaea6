"""The rows of runs, as files of ours have them."""

from typing import Any

from pydantic import TypeAdapter

from tiltcal.validation.runs import Row

_ROW = TypeAdapter(Row)


def row_of(stored: Any) -> Row:
    """A row as a file has it, checked.

    Raises:
        ValueError: it is none.
    """
    return _ROW.validate_python(stored)
