"""The worked examples of the documentation: run, compared, and written anew.

    python -m tests.docs_examples            compare every page with what its commands print
    python -m tests.docs_examples --write    write what they print into the pages

A block that opens with ```` ```toml bench.toml ```` is a file. A block that opens with
```` ```console ```` holds commands, ``$ ...``, and what each prints; a line ``...`` stands for any
number of lines. All blocks of a page run in one empty folder, in order, beside the project's
scenarios.

The first page a reader sees, commands with more than pipes, and those that start processes or may
name a module of the page run as they stand in a shell; of all others the ``tiltcal`` command runs
in this process, and what its output is piped into in a shell.
"""

import contextlib
import doctest
import io
import os
import re
import shlex
import subprocess
import sys
import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path

from tiltcal.cli import main as tiltcal

ROOT = Path(__file__).parents[1]
PAGES = sorted((ROOT / "docs").glob("*.md"))
BLOCK = re.compile(r"^```(\w+)(?: (\S+))?\n(.*?)^```$", re.M | re.S)
LIMIT_S = 300
SHELL_ONLY = set("$`;&<>()*?~:")  # what a shell makes something of; module:function
WORKERS = {
    "campaign",
    "investigate",
    "record",
    "serve",
    "sweep",
    "verify",
}  # with processes or sockets of their own
Checker = doctest.OutputChecker


@dataclass(frozen=True)
class Example:
    """One command of a page, what the page says it prints, and what it printed."""

    page: Path
    command: str
    stated: str
    printed: str

    @property
    def holds(self) -> bool:
        """Whether the page is right."""
        return Checker().check_output(self.stated, self.printed, doctest.ELLIPSIS)


def examples_of(page: Path) -> list[Example]:
    """Run all blocks of a page."""
    found = []
    blocks = BLOCK.findall(page.read_text(encoding="utf-8"))
    whole = page.stem == "index"
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        (place / "scenarios").symlink_to(ROOT / "scenarios")
        (place / "tests").symlink_to(ROOT / "tests")
        for language, file, body in blocks:
            if file:
                (place / file).write_text(body, encoding="utf-8")
            elif language == "console":
                for command, stated in commands_of(body):
                    here = not whole and may_be_called(command)
                    printed = (called if here else run)(command, place)
                    found.append(Example(page, command, stated, printed))
    return found


def commands_of(body: str) -> list[tuple[str, str]]:
    """(command, output) of a block."""
    parts = re.split(r"^\$ (.*)\n", body, flags=re.M)[1:]
    return list(zip(parts[::2], parts[1::2], strict=True))


def may_be_called(command: str) -> bool:
    """Whether its first part is a ``tiltcal`` command that needs neither a shell nor a process."""
    first = command.partition(" | ")[0]
    program, *words = first.split()
    return program == "tiltcal" and words[0] not in WORKERS and not SHELL_ONLY & set(first)


def called(command: str, place: Path) -> str:
    """What ``run`` gives, the first part of the command without a new interpreter."""
    first, _, rest = command.partition(" | ")
    said, complained = (io.TextIOWrapper(io.BytesIO(), encoding="utf-8") for _ in range(2))
    with (
        contextlib.chdir(place),
        contextlib.redirect_stdout(said),
        contextlib.redirect_stderr(complained),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")  # as the program does
        status = tiltcal(shlex.split(first)[1:])
    printed, errors = (_content(stream) for stream in (said, complained))
    return run(rest, place, printed) if rest else in_lines(printed, errors if status == 2 else "")


def _content(stream: io.TextIOWrapper) -> str:
    """All that was written to a stream in memory."""
    stream.flush()
    return stream.buffer.getvalue().decode("utf-8")


def run(command: str, place: Path, given: str = "") -> str:
    """What a command prints on standard output and, where it fails, on standard error; given: its
    standard input.
    """
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}"
    result = subprocess.run(
        command,
        shell=True,
        cwd=place,
        env=os.environ | {"PATH": path, "COLUMNS": "160"},
        input=given,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    return in_lines(result.stdout, result.stderr if result.returncode == 2 else "")


def in_lines(printed: str, errors: str) -> str:
    """Both without blanks at the ends of lines."""
    return "".join(f"{line.rstrip()}\n" for line in (printed + errors).splitlines())


def written(page: Path, examples: list[Example]) -> str:
    """The text of a page with what its commands printed."""
    text = page.read_text(encoding="utf-8")
    for example in examples:
        if not example.holds:
            before = f"$ {example.command}\n{example.stated}"
            text = text.replace(before, f"$ {example.command}\n{example.printed}")
    return text


def main() -> int:
    write = "--write" in sys.argv
    os.environ["COLUMNS"] = "160"
    wrong = 0
    for page in PAGES:
        examples = examples_of(page)
        wrong += sum(not e.holds for e in examples)
        if write:
            page.write_text(written(page, examples), encoding="utf-8")
        for example in examples:
            state = "same" if example.holds else "written" if write else "DIFFERS"
            print(f"{page.name}: {example.command}: {state}")
    return 0 if write or not wrong else 1


if __name__ == "__main__":
    sys.exit(main())
