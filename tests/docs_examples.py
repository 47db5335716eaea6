"""The worked examples of the documentation: run, compared, and written anew.

    python -m tests.docs_examples            compare every page with what its commands print
    python -m tests.docs_examples --write    write what they print into the pages

A block that opens with ```` ```toml bench.toml ```` is a file. A block that opens with
```` ```console ```` holds commands, ``$ ...``, and what each prints; a line ``...`` stands for any
number of lines. All blocks of a page run in one empty folder, in order, beside the project's
scenarios.
"""

import doctest
import os
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = sorted((ROOT / "docs").glob("*.md"))
BLOCK = re.compile(r"^```(\w+)(?: (\S+))?\n(.*?)^```$", re.M | re.S)
LIMIT_S = 300
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
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        (place / "scenarios").symlink_to(ROOT / "scenarios")
        (place / "tests").symlink_to(ROOT / "tests")
        for language, file, body in BLOCK.findall(page.read_text(encoding="utf-8")):
            if file:
                (place / file).write_text(body, encoding="utf-8")
            elif language == "console":
                for command, stated in commands_of(body):
                    found.append(Example(page, command, stated, run(command, place)))
    return found


def commands_of(body: str) -> list[tuple[str, str]]:
    """(command, output) of a block."""
    parts = re.split(r"^\$ (.*)\n", body, flags=re.M)[1:]
    return list(zip(parts[::2], parts[1::2], strict=True))


def run(command: str, place: Path) -> str:
    """What a command prints on standard output and, where it fails, on standard error."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}"
    result = subprocess.run(
        command,
        shell=True,
        cwd=place,
        env=os.environ | {"PATH": path, "COLUMNS": "160"},
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    failed = result.stderr if result.returncode == 2 else ""
    return "".join(f"{line.rstrip()}\n" for line in (result.stdout + failed).splitlines())


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
