"""Commands that run beside the pages, each in a process of its own: they can be cancelled, and the
command that is shown is the one that ran.
"""

import asyncio
import os
import shlex
import signal
import sys
import time
from collections import deque
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from tiltcal.core.safe_text import plain, shortened

PROGRAM = (sys.executable, "-P", "-m", "tiltcal")
"""-P: a file ``tiltcal.py`` of the workspace is not the program."""
LINES = 200  # of what a command says on stderr; the latest stay
MOST_OUTPUT = 64 << 20  # bytes on stdout: the JSON of a large result has some MB
PATIENCE_S = 5.0  # after SIGTERM, in which a command removes what is not whole
KEPT = 30  # jobs


def as_command(words: Sequence[str]) -> str:
    """The line that does the same in a shell."""
    return shlex.join(["tiltcal", *words])


@dataclass
class Job:
    """A command that runs or has run.

    Args:
        title: what it does, for its line.
        words: of the command, without the program.
        lines: said on stderr, the latest last.
        output: on stdout.
        status: exit status; None: it runs.
        cancelled: by the user.
        started, ended: s, of a monotonic clock.
    """

    title: str
    words: tuple[str, ...]
    lines: deque[str] = field(default_factory=lambda: deque(maxlen=LINES))
    output: str = ""
    status: int | None = None
    cancelled: bool = False
    started: float = field(default_factory=time.monotonic)
    ended: float | None = None
    process: asyncio.subprocess.Process | None = None

    @property
    def command(self) -> str:
        """The line that does the same in a shell."""
        return as_command(self.words)

    @property
    def running(self) -> bool:
        """Whether it has not ended."""
        return self.status is None

    @property
    def failed(self) -> bool:
        """Whether it ended without its result; status 1 is a result that is not accepted."""
        return self.status is not None and self.status not in (0, 1)

    @property
    def last(self) -> str:
        """The latest line."""
        return self.lines[-1] if self.lines else "starting ..."

    @property
    def seconds(self) -> float:
        """How long it has run, s."""
        return (self.ended or time.monotonic()) - self.started

    def cancel(self) -> None:
        """Ask it to end; it removes what is not whole."""
        self.cancelled = True
        if self.process is not None and self.running:
            with suppress(ProcessLookupError):
                self.process.send_signal(signal.SIGTERM)


class Jobs:
    """The commands of a workspace, the latest first.

    Args:
        folder: that they run in.
        changed: called after each line and each end.
    """

    def __init__(self, folder: Path, changed: Callable[[], None]) -> None:
        self._folder, self._changed = folder, changed
        self.all: deque[Job] = deque(maxlen=KEPT)

    @property
    def running(self) -> list[Job]:
        """Those that have not ended."""
        return [job for job in self.all if job.running]

    async def run(self, title: str, words: Sequence[str]) -> Job:
        """Run a command to its end."""
        job = Job(title, tuple(words))
        self.all.appendleft(job)
        self._changed()
        environment = os.environ | {"PYTHONUNBUFFERED": "1", "COLUMNS": "80"}
        try:
            job.process = await asyncio.create_subprocess_exec(
                *PROGRAM,
                "--progress",
                *job.words,
                cwd=self._folder,
                env=environment,
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.PIPE,
                start_new_session=True,
            )
            assert job.process.stdout is not None
            assert job.process.stderr is not None
            await asyncio.gather(
                self._collect(job, job.process.stdout), self._listen(job, job.process.stderr)
            )
            status = await job.process.wait()
        except OSError as error:
            job.lines.append(f"tiltcal: {error.strerror or error}")
            status = 2
        job.ended, job.status = time.monotonic(), status
        self._changed()
        return job

    async def _collect(self, job: Job, stream: asyncio.StreamReader) -> None:
        parts: list[bytes] = []
        size = 0
        while block := await stream.read(1 << 16):
            size += len(block)
            if size <= MOST_OUTPUT:
                parts.append(block)
        job.output = b"".join(parts).decode("utf-8", errors="replace")

    async def _listen(self, job: Job, stream: asyncio.StreamReader) -> None:
        rest = b""
        while block := await stream.read(1 << 14):
            *lines, rest = (rest + block).replace(b"\r", b"\n").split(b"\n")
            rest = rest[-(1 << 16) :]
            texts = [shortened(plain(x.decode("utf-8", errors="replace"))) for x in lines]
            job.lines.extend(text for text in texts if text.strip())
            self._changed()
        if rest.strip():
            job.lines.append(shortened(plain(rest.decode("utf-8", errors="replace"))))

    async def cancel(self, job: Job) -> None:
        """End a command: asked first, then made to."""
        job.cancel()
        self._changed()
        until = time.monotonic() + PATIENCE_S
        while job.running and time.monotonic() < until:
            await asyncio.sleep(0.05)
        if job.running and job.process is not None:
            with suppress(ProcessLookupError):
                os.killpg(job.process.pid, signal.SIGKILL)

    async def end(self) -> None:
        """End all that run, with the application."""
        await asyncio.gather(*(self.cancel(job) for job in self.running))


Then = Callable[[Job], Awaitable[None] | None]
"""What follows the end of a command."""
