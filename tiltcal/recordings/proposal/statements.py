"""The lines of a mapping file one by one, with their reasons, and the file with one of them
changed: a proposal is corrected line by line, and stays one text.
"""

import json
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

UNKNOWN = "?"
"""What a proposal has where the file does not say."""


@dataclass(frozen=True)
class Statement:
    """A line ``key = value  # reason``.

    Args:
        line: index of the line, from 0.
        part: section that it stands in, such as ``time`` or ``column 3``.
        key: of the line.
        value: as TOML reads it.
        reason: of the comment; empty without one.
    """

    line: int
    part: str
    key: str
    value: Any
    reason: str

    @property
    def open(self) -> bool:
        """Whether the value is still to be filled in."""
        return isinstance(self.value, str) and (
            self.value == UNKNOWN or self.value.endswith(f"_{UNKNOWN}")
        )


def statements_of(text: str) -> list[Statement]:
    """The statements of a mapping, in their order; lines of several lines are left out.

    Args:
        text: of the file.
    """
    found: list[Statement] = []
    part, columns = "", 0
    for number, line in enumerate(text.splitlines()):
        content = line.strip()
        if content.startswith("["):
            part = content.split("#")[0].strip(" []")
            columns += part == "column"
            part = f"column {columns}" if part == "column" else part
        elif (parsed := _parsed(content)) is not None:
            found.append(Statement(number, part, *parsed))
    return found


def notes_of(text: str) -> list[tuple[str, str]]:
    """The comments that stand alone: kind (``cannot know``, ``found``, ``left out``, ``note``) and
    what it says.
    """
    comments = [line[1:].strip() for line in text.splitlines() if line.startswith("#")]
    pairs = [comment.partition(": ") for comment in comments]
    kinds = ("cannot know", "found", "left out", "note")
    return [(kind, said) for kind, _, said in pairs if kind in kinds]


def with_values(text: str, changes: Sequence[tuple[int, Any]]) -> str:
    """The text with other values on some lines; their reasons stay.

    Args:
        text: of the file.
        changes: index of a line, and its value.
    """
    lines = text.splitlines()
    known = {s.line: s for s in statements_of(text)}
    for number, value in changes:
        statement = known[number]
        reason = f"  # {statement.reason}" if statement.reason else ""
        shown = json.dumps(value, ensure_ascii=False)
        lines[number] = f"{statement.key} = {shown}{reason}"
    return "\n".join(lines) + "\n"


def _parsed(line: str) -> tuple[str, Any, str] | None:
    """Key, value and reason of a line that is a statement by itself."""
    if line.startswith("#"):
        return None
    try:
        table = tomllib.loads(line)
    except tomllib.TOMLDecodeError:
        return None
    if len(table) != 1:
        return None
    ((key, value),) = table.items()
    for at in (k for k, c in enumerate(line) if c == "#"):
        try:
            if tomllib.loads(line[:at]) == table:
                return key, value, line[at + 1 :].strip()
        except tomllib.TOMLDecodeError:
            continue
    return key, value, ""
