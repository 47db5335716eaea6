"""What all pages share: the workspace, the command that runs, and how it is told."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from nicegui import background_tasks, run, ui

from tiltcal.app.jobs import Job
from tiltcal.app.live import Live
from tiltcal.app.workspace import Workspace
from tiltcal.core.errors import TiltcalError

Then = Callable[[Job], None]


class Bench:
    """The state of the application, one for all its pages: two of them show the same, and a reload
    loses nothing.

    Args:
        workspace: folder and choices.
    """

    def __init__(self, workspace: Workspace) -> None:
        self.workspace = workspace
        self.job: Job | None = None
        self.live: Live | None = None
        self._drawn: dict[str, Callable[[], Any]] = {}

    @property
    def busy(self) -> bool:
        """Whether a command runs."""
        return self.job is not None and self.job.runs

    def start(self, *words: str, then: Then | None = None) -> None:
        """Run a command in the background; one at a time."""
        if self.busy:
            ui.notify("Another command runs; wait for it or cancel it.", type="warning")
            return
        self.job = Job(words, self.workspace.folder, _tell)
        background_tasks.create(self._run(self.job, then))
        _tell()

    async def _run(self, job: Job, then: Then | None) -> None:
        await job.run()
        if then is not None and job.status in (0, 1):
            then(job)
        self.draw()

    def choose(self, **changed: Any) -> None:
        """Change a choice, on every page."""
        self.workspace.choose(**changed)
        self.draw()

    def shown(self, browser: str, draw: Callable[[], Any]) -> None:
        """A page is open. browser: its id; draw: draws it again."""
        self._drawn[browser] = draw

    def left(self, browser: str) -> None:
        """A page was closed."""
        self._drawn.pop(browser, None)

    def draw(self) -> None:
        """Draw all open pages again."""
        for draw in list(self._drawn.values()):
            draw()
        _tell()

    @property
    def segments(self) -> str:
        """Name of the file of the dwells that were kept of the chosen recording."""
        return f"{Path(self.workspace.chosen.recording).stem}-dwells.csv"

    def path(self, name: str) -> Path:
        """Where a file of the workspace is."""
        return self.workspace.path(name)


def _tell() -> None:
    progress.refresh()


@ui.refreshable
def progress(bench: Bench) -> None:
    """What the command that runs says, or how it ended."""
    job = bench.job
    if job is None:
        return
    with ui.row().classes("w-full items-center q-px-md job"):
        if job.runs:
            ui.spinner(size="sm")
            ui.label(job.said[-1] if job.said else f"{job.words[0]} ...").mark("progress")
            ui.button("Cancel", on_click=job.cancel).props("flat dense")
        elif job.status in (0, 1):
            ui.icon("check", color="positive")
            ui.label(f"{job.words[0]} has ended.").mark("progress")
        else:
            ui.icon("error", color="negative")
            said = " ".join(job.said[-3:]) or f"{job.words[0]} was cancelled."
            ui.label(said).mark("progress")


async def read_or_tell(read: Callable[[], Any]) -> Any:
    """What a function returns that takes a while; None, with its message on the page, where it
    fails.
    """
    try:
        return await run.io_bound(read)
    except TiltcalError as error:
        ui.label(str(error)).classes("text-negative")
        return None
