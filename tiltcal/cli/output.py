"""Printing: tables and JSON on stdout, progress on stderr. Only this module writes to a terminal:
what comes from files and arguments cannot command it.
"""

import io
import json
import math
import os
import select
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from math import isfinite
from pathlib import Path
from shutil import get_terminal_size
from textwrap import fill
from typing import IO, Any

from tiltcal.core.errors import TiltcalError
from tiltcal.core.progress import Progress, silent
from tiltcal.core.safe_text import plain

PADDING = {1: (0, 0, 0, 0), 2: (0, 1, 0, 0), 3: (0, 1, 0, 1)}  # by the gap between columns
SENTENCE = 24  # characters: lines of fewer, some four words, are a pillar and not read as text
SILENCE_S = 2.5  # after which progress repeats what is being done


def print_line(text: str) -> None:
    """Print a line on stdout."""
    sys.stdout.write(plain(text) + "\n")


_quiet = ContextVar("quiet", default=False)
_asked = ContextVar("asked", default=False)


@contextmanager
def telling(quiet: bool, progress: bool) -> Iterator[None]:
    """What goes to stderr meanwhile.

    Args:
        quiet: nothing but errors.
        progress: progress even where no terminal is there.
    """
    tokens = _quiet.set(quiet), _asked.set(progress)
    try:
        yield
    finally:
        _quiet.reset(tokens[0])
        _asked.reset(tokens[1])


def print_note(text: str) -> None:
    """Print a note, one line on stderr, unless quiet."""
    if not _quiet.get():
        sys.stderr.write(plain(text) + "\n")


def ask(question: str, default: str, choices: Sequence[str] = ()) -> str:
    """The answer to a question on the terminal; the default where nobody can be asked.

    Args:
        question: as text.
        default: what an empty answer means.
        choices: valid answers; empty: any.
    """
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return default
    offered = f" ({', '.join(choices)})" if choices else ""
    while True:
        sys.stderr.write(plain(f"{question}{offered} [{default}]: "))
        sys.stderr.flush()
        answer = sys.stdin.readline().strip() or default
        if not choices or answer in choices:
            return answer


@contextmanager
def stdout_bytes() -> Iterator[IO[bytes]]:
    """Stdout for a file's content: into a pipe or a file as it is, on a terminal as plain text."""
    if not sys.stdout.isatty():
        sys.stdout.flush()
        yield sys.stdout.buffer
        return
    with io.BytesIO() as content:
        yield content
        sys.stdout.write(plain(content.getvalue().decode(errors="replace")))


def print_json(value: Any) -> None:
    """Print JSON on stdout; what is no finite number is null."""
    json.dump(finite(value), sys.stdout, indent=1, allow_nan=False)
    sys.stdout.write("\n")


def finite(value: Any) -> Any:
    """Plain values, with null for numbers that JSON does not have."""
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if value is None or isinstance(value, str | bool | int):
        return value
    number = float(value)
    return number if isfinite(number) else None


def require_output(command: str, output: Path | None, as_json: bool, what: str) -> None:
    """Without ``-o`` the output itself goes to stdout, so JSON cannot go there as well.

    Raises:
        TiltcalError: ``--json`` without ``-o``.
    """
    if as_json and output is None:
        raise TiltcalError(
            f"command line of `tiltcal {command}`",
            found=f"--json without -o: {what} itself goes to stdout",
            need="a file for it",
            do="add -o FILE, or leave --json out",
        )


def print_table(
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    title: str | None = None,
    *,
    spare: Sequence[str] = (),
) -> None:
    """Print a table on stdout that fits the terminal, or 80 columns (COLUMNS) in a pipe: sentences
    are wrapped; where that does not suffice, columns are left out, and named below; where even that
    does not, each row is a list.

    Args:
        header: names of the columns.
        rows: cells of each.
        title: above it.
        spare: columns that may be left out, the first one first.
    """
    from rich import box
    from rich.console import Console
    from rich.table import Table

    width = line_width()
    whole = cells = [[plain(cell) for cell in row] for row in (header, *rows)]
    left_out: list[str] = []
    while (fitted := fitted_widths(cells, width)) is None:
        if len(left_out) == len(spare):
            _print_as_lists(whole, title)
            return
        left_out.append(spare[len(left_out)])
        kept = [k for k, name in enumerate(header) if name not in left_out]
        cells = [[row[k] for k in kept] for row in whole]
    widths, gap = fitted
    shown = None if title is None else plain(title)
    table = Table(
        title=shown,
        title_justify="left",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        padding=PADDING[gap],
    )
    for name, column in zip(cells[0], widths, strict=True):
        table.add_column(name, width=column)
    for row in cells[1:]:
        table.add_row(*row)
    console = Console(file=sys.stdout, highlight=False, markup=False, width=width)
    with console.capture() as text:  # main() handles a closed pipe, not rich
        console.print(table)
    sys.stdout.write("".join(f"{line.rstrip()}\n" for line in text.get().splitlines()))
    if left_out:
        paragraph(f"not shown in {width} columns: {', '.join(left_out)}")


def line_width() -> int:
    """Columns of the terminal; COLUMNS, or 80, in a pipe."""
    return get_terminal_size().columns


def fitted_widths(cells: Sequence[Sequence[str]], width: int) -> tuple[list[int], int] | None:
    """Width of each column of a table, and the gap between them; None where they do not fit side by
    side. Names are wrapped between words, cells only down to the width of a SENTENCE.

    Args:
        cells: header and rows.
        width: of the whole table.
    """
    columns = list(zip(*cells, strict=True))
    widths = [max(map(len, column)) for column in columns]
    least = [
        max(*map(_longest_unbroken, column), *(min(len(cell), SENTENCE) for cell in column[1:]))
        for column in columns
    ]
    if sum(widths) <= width - 3 * len(widths):
        return widths, 3
    gap = next((g for g in (2, 1) if sum(least) < width - g * len(widths)), None)
    if gap is None:
        return None
    while sum(widths) >= width - gap * len(widths):
        k = max(range(len(widths)), key=lambda i: widths[i] - least[i])
        widths[k] -= 1
    return widths, gap


def _longest_unbroken(cell: str) -> int:
    return max(map(len, cell.split()), default=0)


def _print_as_lists(cells: Sequence[Sequence[str]], title: str | None) -> None:
    if title is not None:
        paragraph(title)
    names, *rows = cells
    for row in rows:
        sys.stdout.write("\n")
        for name, cell in zip(names, row, strict=True):
            if cell:
                paragraph(f"{name}: {cell}" if name else cell, indent="  ")
    sys.stdout.write("\n")


def paragraph(text: str, indent: str = "    ") -> None:
    """Print a text on stdout, wrapped to the width; further lines are indented."""
    message = fill(
        plain(text),
        line_width(),
        subsequent_indent=indent,
        break_long_words=False,
        break_on_hyphens=False,
    )
    sys.stdout.write(message + "\n")


class _Lines:
    """Progress in a pipe, where it was asked for: at most one new line per second, and a reminder
    after some seconds of silence, which keeps no new line back.
    """

    def __init__(self) -> None:
        self._start = self._last = time.monotonic()
        self._shown = -math.inf
        self._text = "working"
        self._over = threading.Event()
        threading.Thread(target=self._remind, daemon=True).start()

    def show(self, text: str) -> None:
        """Something new."""
        self._text = text
        if (now := time.monotonic()) - self._shown >= 1.0:
            self._shown = now
            self._write(text)

    def close(self) -> None:
        """No more lines."""
        self._over.set()

    def _write(self, text: str) -> None:
        self._last = time.monotonic()
        print_note(text)
        sys.stderr.flush()

    def _remind(self) -> None:
        while not self._over.wait(1.0):
            now = time.monotonic()
            if now - self._last >= SILENCE_S:
                self._write(f"{self._text} ... {now - self._start:.0f} s")


@contextmanager
def progress_line() -> Iterator[Progress]:
    """Progress on stderr: one line on a terminal, which changes once a second; none in a pipe,
    unless it was asked for: at most one line a second then.
    """
    if _quiet.get() or not (sys.stderr.isatty() or _asked.get()):
        yield silent
        return
    if not sys.stderr.isatty():
        lines = _Lines()
        try:
            yield lines.show
        finally:
            lines.close()
        return
    from rich.console import Console
    from rich.text import Text

    console = Console(stderr=True)
    with console.status("working ...", refresh_per_second=1.0) as status:
        yield lambda text: status.update(Text(plain(text)))


def on_terminal() -> bool:
    """Whether somebody watches stderr."""
    return sys.stderr.isatty() and not _quiet.get()


@contextmanager
def live_text() -> Iterator[Callable[[str], None]]:
    """A text of several lines on a terminal's stderr, which each call replaces."""
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    console = Console(stderr=True)
    with Live(console=console, auto_refresh=False, transient=True) as live:
        yield lambda text: live.update(Text(plain(text), no_wrap=True), refresh=True)


class TypedLines:
    """Lines that somebody types, or a program pipes in, while something else goes on."""

    def __init__(self) -> None:
        self._rest = b""
        try:
            self._input: int | None = sys.stdin.fileno()
        except (OSError, ValueError, AttributeError):
            self._input = None

    def read(self) -> list[str]:
        """The lines that have come since the last call."""
        if self._input is None or not select.select([self._input], [], [], 0)[0]:
            return []
        data = os.read(self._input, 4096)
        if not data:
            self._input = None
            return []
        *lines, self._rest = (self._rest + data).split(b"\n")
        return [line.decode(errors="replace").strip() for line in lines]
