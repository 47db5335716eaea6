"""What one command made of a mutated input, and whether it kept the rules."""

import contextlib
import io
import re
import resource
import signal
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

from tests.fuzz.cases import Case
from tests.fuzz.originals import inside
from tiltcal import cli
from tiltcal.cli import main

LONGEST_S = 10.0
QUIET_S = 3.0
"""A command that takes longer has shown progress within that time."""
MESSAGE = re.compile(r"tiltcal: .+: found .+, need .+; .+\n", re.DOTALL)
CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")
KEEPING = ("investigate", "campaign", "sweep", "verify", "prove")
"""Commands that keep in their folder what is finished."""
SOUND = "sound"


@dataclass(frozen=True)
class Outcome:
    """How a case ended.

    Args:
        number: of the case.
        kind: sound, traceback, hang, partial output, message, control characters, memory, status
            or warning.
        where: what tells one cause from another.
        told: everything that is known of it.
        seconds: that it took.
    """

    number: int
    kind: str
    where: str
    told: str
    seconds: float


class Overdue(KeyboardInterrupt):
    """The time is over: to the command the same as Ctrl-C."""


@dataclass
class Ending:
    """What can be seen of a command that has ended."""

    status: int | None = None
    out: str = ""
    err: str = ""
    error: BaseException | None = None
    overdue: bool = False
    quiet_s: float = 0.0
    warned: tuple[str, ...] = ()


class Watched(io.TextIOWrapper):
    """A stream that knows when it was last written to."""

    def __init__(self) -> None:
        self.bytes = io.BytesIO()
        super().__init__(self.bytes, encoding="utf-8", errors="backslashreplace")
        self.last = time.monotonic()

    def write(self, text: str) -> int:
        self.last = time.monotonic()
        return super().write(text)

    def content(self) -> str:
        """All that was written."""
        self.flush()
        return self.bytes.getvalue().decode(errors="replace")


def judge(case: Case, place: Path) -> Outcome:
    """Run a case in an empty folder."""
    case.write(place)
    before = contents(place)
    start = time.monotonic()
    with inside(place):
        ending = ended(case.arguments)
    seconds = time.monotonic() - start
    kind, where = verdict(case, ending, before, contents(place))
    told = "" if kind == SOUND else story(case, ending)
    return Outcome(case.number, kind, where, told, seconds)


def contents(place: Path) -> dict[str, bytes]:
    """All files below a folder, their first bytes."""
    return {
        str(p.relative_to(place)): beginning(p)
        for p in place.rglob("*")
        if p.is_file() and "__pycache__" not in p.parts
    }


def beginning(path: Path) -> bytes:
    """The first bytes of a file; none of what does not end."""
    if not path.resolve().is_relative_to(Path(tempfile.gettempdir()).resolve()):
        return b""
    with path.open("rb") as file:
        return file.read(1 << 20)


def ended(arguments: tuple[str, ...]) -> Ending:
    """Run a command in this process, with a limit of time."""
    out, err, found = Watched(), Watched(), Ending()
    caught: list[Exception] = []  # what the boundary of the command line had to catch
    message_of = cli._unexpected

    def keeping(error: Exception) -> str:
        caught.append(error)
        return message_of(error)

    def overdue(*_: object) -> None:
        found.overdue = True
        found.quiet_s = time.monotonic() - err.last
        raise Overdue

    with (
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        warnings.catch_warnings(record=True) as warned,
        alarm(overdue, LONGEST_S),
        mock.patch.object(cli, "_unexpected", keeping),
    ):
        warnings.simplefilter("always")
        try:
            found.status = main(list(arguments))
            found.error = caught[-1] if caught else None  # a failure all the same
        except SystemExit as stop:
            found.status = stop.code if isinstance(stop.code, int) else 1
        except BaseException as error:  # noqa: BLE001  whatever escapes is what is looked for
            found.error = error
    found.out, found.err = out.content(), err.content()
    found.warned = tuple(
        f"{w.category.__name__} {Path(w.filename).name}:{w.lineno}" for w in warned
    )
    return found


@contextlib.contextmanager
def alarm(ring: object, seconds: float, *, of_processor: bool = False) -> Iterator[None]:
    """A call after so much time, s, or so much time of the processor."""
    kind = signal.SIGPROF if of_processor else signal.SIGALRM
    timer = signal.ITIMER_PROF if of_processor else signal.ITIMER_REAL
    before = signal.signal(kind, ring)  # type: ignore[arg-type]
    signal.setitimer(timer, seconds)
    try:
        yield
    finally:
        signal.setitimer(timer, 0)
        signal.signal(kind, before)


def verdict(
    case: Case, ending: Ending, before: dict[str, bytes], after: dict[str, bytes]
) -> tuple[str, str]:
    """The rule that was broken, and where; sound where none was."""
    command = case.arguments[0] if case.arguments else ""
    if isinstance(ending.error, MemoryError):
        return "memory", place_of(ending.error)
    if ending.error is not None and not isinstance(ending.error, Overdue):
        return "traceback", place_of(ending.error)
    if ending.overdue and (ending.quiet_s > QUIET_S or ending.status != 130):
        return "hang", f"{command} {ending.status} {case.changed}"
    left = leftovers(command, ending, before, after)
    if left:
        return "partial output", f"{command} {left}"
    if ending.status not in ((130,) if ending.overdue else (0, 1, 2)):
        return "status", f"{command} {ending.status}"
    if ending.status == 2 and not one_message(ending):
        return "message", f"{command} {ending.err.splitlines()[-1:]}"
    if control := CONTROL.search(seen(case, ending)):
        return "control characters", f"{command} {control.group()!r} {case.changed}"
    if ending.warned:
        return "warning", ending.warned[0]
    return SOUND, ""


def seen(case: Case, ending: Ending) -> str:
    """What is shown to a reader: without recordings on stdout, which are data."""
    data = case.arguments[:1] in (("simulate",), ("correct",), ("segments",))
    return ending.err if data else ending.out + ending.err


def leftovers(
    command: str, ending: Ending, before: dict[str, bytes], after: dict[str, bytes]
) -> str:
    """A file that a command should not have left, changed or removed; empty for none."""
    for name, content in before.items():
        if after.get(name) != content and ending.status == 2 and command not in KEEPING:
            return name
    for name in after:
        if name in before:
            continue
        if Path(name).name.startswith(".part"):
            return "temporary file"
        if ending.status in (2, 130) and command not in KEEPING:
            return name
    return ""


def one_message(ending: Ending) -> bool:
    """Whether a refusal is one message in our words, and nothing on stdout."""
    start = ending.err.find("tiltcal: ")
    return (
        start >= 0
        and not ending.out
        and len(re.findall(r"^tiltcal: ", ending.err, re.MULTILINE)) == 1
        and MESSAGE.fullmatch(ending.err[start:]) is not None
    )


def place_of(error: BaseException) -> str:
    """The kind of an exception and the innermost line of ours that it came through."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [f for f in frames if "/tiltcal/" in f.filename or "/tiltsim/" in f.filename]
    inner = (ours or list(frames))[-1]
    name = "/".join(Path(inner.filename).parts[-2:])
    return f"{type(error).__name__} {name}:{inner.lineno} {inner.name}"


def story(case: Case, ending: Ending) -> str:
    """Everything that is known of an outcome."""
    lines = [f"tiltcal {' '.join(ascii(a)[:200] for a in case.arguments)}", f"  {case.changed}"]
    if ending.error is not None:
        lines += "".join(traceback.format_exception(ending.error)).splitlines()[-24:]
    lines += [f"  status {ending.status}", f"  err {ending.err[-600:]!r}", *ending.warned[:3]]
    return "\n".join(lines)


def limit_memory(size: int) -> None:
    """No more than some bytes of data for this process and what it starts."""
    resource.setrlimit(resource.RLIMIT_DATA, (size, size))
