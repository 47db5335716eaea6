"""Commands in the style of SCPI: case-insensitive, short and long forms, several on a line."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

ERRORS = {
    0: "No error",
    -108: "Parameter not allowed",
    -109: "Missing parameter",
    -113: "Undefined header",
    -120: "Numeric data error",
    -200: "Execution error; interlock open",
    -221: "Settings conflict",
    -222: "Data out of range",
    -224: "Illegal parameter value",
    -350: "Queue overflow",
    -363: "Input buffer overrun",
}
QUEUE = 32  # errors that are kept
LARGEST = 1e9  # of a parameter


class CommandError(Exception):
    """A command that is not executed. Args: code of ERRORS."""

    def __init__(self, code: int) -> None:
        super().__init__(ERRORS[code])
        self.code = code


@dataclass(frozen=True)
class Command:
    """A command and what it needs.

    Args:
        run: (parameters) -> answer, or None.
        least, most: parameters.
    """

    run: Callable[[list[str]], str | None]
    least: int = 0
    most: int = 0


class Interpreter:
    """Runs lines of commands, and keeps the errors.

    Args:
        commands: by header, capitals are the short form: ``:DEMand:POSition``, ``*IDN?``.
    """

    def __init__(self, commands: Mapping[str, Command]) -> None:
        self.commands = {form: c for header, c in commands.items() for form in forms(header)}
        self.errors: list[int] = []

    def line(self, text: str) -> str | None:
        """Run a line; the answers of its queries, joined by ``;``."""
        answers = []
        for part in _split(text, ";"):
            if part.strip():
                try:
                    answer = self._run(part.strip())
                except CommandError as error:
                    self.refuse(error.code)
                    continue
                if answer is not None:
                    answers.append(answer)
        return ";".join(answers) if answers else None

    def refuse(self, code: int) -> None:
        """Keep an error; the last place says that there were more."""
        self.errors.append(code if len(self.errors) < QUEUE - 1 else -350)
        del self.errors[QUEUE:]

    def next_error(self) -> str:
        """The oldest error, which is then forgotten."""
        code = self.errors.pop(0) if self.errors else 0
        return f'{code},"{ERRORS[code]}"'

    def _run(self, text: str) -> str | None:
        header, _, rest = text.partition(" ")
        command = self.commands.get(header.lower().removeprefix(":"))
        if command is None:
            raise CommandError(-113)
        words = [word.strip() for word in _split(rest, ",")] if rest.strip() else []
        if len(words) < command.least:
            raise CommandError(-109)
        if len(words) > command.most:
            raise CommandError(-108)
        return command.run(words)


def forms(header: str) -> list[str]:
    """Every spelling of a header, in lower case, without its first colon."""
    found = [""]
    for node in re.split(r"(?=:)", header.removeprefix(":")):
        query = "?" if node.endswith("?") else ""
        long = node.removesuffix("?")
        short = re.sub(r"[a-z]", "", long)
        ends = {(long + query).lower(), (short + query).lower()}
        found = [begin + end for begin in found for end in sorted(ends)]
    return found


def _split(text: str, mark: str) -> list[str]:
    """At a mark that is not inside quotes or brackets."""
    return re.findall(rf"(?:\"[^\"]*\"|'[^']*'|[^{mark}])+", text)


def number(word: str, low: float = -LARGEST, high: float = LARGEST) -> float:
    """A parameter as a number.

    Raises:
        CommandError: it is none, or out of range.
    """
    try:
        value = float(word)
    except ValueError as error:
        raise CommandError(-120) from error
    if not low <= value <= high:
        raise CommandError(-222)
    return value


def whole(word: str, low: int, high: int) -> int:
    """A parameter as a whole number.

    Raises:
        CommandError: it is none, or out of range.
    """
    value = number(word, low, high)
    if value != int(value):
        raise CommandError(-224)
    return int(value)
