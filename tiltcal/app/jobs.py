"""Work of the application: a command of its own process, so that every button is a line that can be
typed, goes on while the page is closed, and can be cancelled.
"""

import asyncio
import json
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

KEPT = 200  # lines of what a command says


@dataclass
class Job:
    """A command that runs or ran.

    Args:
        words: of the command, without its name.
        folder: where it runs.
        changed: is called when there is something new to show.

    Attributes:
        said: the last lines that it said.
        status: of its exit; None while it runs.
        printed: what it printed.
    """

    words: tuple[str, ...]
    folder: Path
    changed: Callable[[], None]
    said: list[str] = field(default_factory=list)
    status: int | None = None
    printed: str = ""
    _process: asyncio.subprocess.Process | None = None

    @property
    def runs(self) -> bool:
        """Whether it has not ended."""
        return self.status is None

    @property
    def result(self) -> dict[str, Any]:
        """What it printed as JSON; empty where that is none."""
        try:
            found = json.loads(self.printed)
        except ValueError:
            return {}
        return found if isinstance(found, dict) else {}

    async def run(self) -> "Job":
        """Run to the end."""
        # -P: no module of the workspace takes the place of one that is imported
        program = (sys.executable, "-P", "-m", "tiltcal", *self.words)
        self._process = await asyncio.create_subprocess_exec(
            *program,
            cwd=self.folder,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            env=os.environ | {"COLUMNS": "100", "PYTHONUNBUFFERED": "1"},
            limit=2**24,
        )
        self.printed, _ = await asyncio.gather(self._read(), self._listen())
        self.status = await self._process.wait()
        self.changed()
        return self

    async def _read(self) -> str:
        assert self._process is not None
        assert self._process.stdout is not None
        return (await self._process.stdout.read()).decode("utf-8", "replace")

    async def _listen(self) -> None:
        assert self._process is not None
        assert self._process.stderr is not None
        async for line in self._process.stderr:
            self.said = [*self.said, line.decode("utf-8", "replace").rstrip()][-KEPT:]
            self.changed()

    def cancel(self) -> None:
        """End it as an interrupt from the keyboard does: it keeps what is finished."""
        if self._process is not None and self._process.returncode is None:
            self._process.terminate()
