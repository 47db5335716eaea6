"""The live guide of a workspace: a source is read in a thread of its own, and every tab looks at
the same state.
"""

import re
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import tiltcal as tc
from tiltcal.app.session import Session
from tiltcal.core.errors import TiltcalError
from tiltcal.design.goals import parse_goals
from tiltcal.guide.guide import Guide
from tiltcal.guide.sources import (
    ServedTable,
    Source,
    SourceOptions,
    TableDriver,
    open_source,
)
from tiltcal.guide.state import GuideState
from tiltcal.report.stated import Stated

DEVICE = re.compile(r"/dev/[\w./-]+|COM\d+", re.IGNORECASE)


@dataclass(frozen=True)
class Task:
    """What is to be guided.

    Args:
        source: as `tiltcal guide` takes it; a file is one of the workspace.
        scenario: file of the workspace.
        method: norm or six_position.
        goals: KIND=SIGMA each.
        hold_s: length of a dwell, s.
        speed: of a file that is replayed.
        columns: cells of lines without a header.
        rate_hz: of lines without a time; None: they have one.
        folder: for the results.
        stated: by the laboratory; None: no certificate.
    """

    source: str
    scenario: str
    method: str
    goals: tuple[str, ...]
    hold_s: float
    speed: float
    columns: tuple[str, ...]
    rate_hz: float | None
    folder: str
    stated: Stated | None = None


@dataclass
class Live:
    """A guide at work.

    Args:
        session: of the workspace.
        state: what it says; None before the first sample.
        running: whether the source is read.
        error: what ended it, if not its goal.
        sigmas: of each parameter after each dwell, over its goal.
        written: names of the files, when it has ended.
    """

    session: Session
    state: GuideState | None = None
    running: bool = False
    error: str = ""
    sigmas: list[dict[str, float]] = field(default_factory=list)
    written: dict[str, str] = field(default_factory=dict)
    _guide: Guide | None = None
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _stop: threading.Event = field(default_factory=threading.Event)

    def start(self, task: Task) -> None:
        """Begin to read the source, in a thread.

        Raises:
            TiltcalError: the source, the scenario or a goal is wrong, or one runs already.
        """
        if self.running:
            raise TiltcalError(
                "guide",
                found="one that runs",
                need="one at a time",
                do="stop it first",
            )
        options = SourceOptions(task.columns, task.rate_hz, speed=task.speed)
        source = open_source(self._source(task.source), options)
        scenario = tc.load_scenario(self.session.workspace.path(task.scenario))
        goals = parse_goals(task.goals)
        self._guide = Guide(scenario, task.method, goal=goals, hold_s=task.hold_s)
        self.state, self.error, self.running = self._guide.state, "", True
        self.sigmas, self.written = [], {}
        self._stop.clear()
        work = (self._guide, source, task)
        threading.Thread(target=self._run, args=work, daemon=True, name="guide").start()

    def stop(self) -> None:
        """End it; what was recorded is written."""
        self._stop.set()

    def reject(self) -> None:
        """Leave the last dwell out.

        Raises:
            TiltcalError: there is none.
        """
        self._change(lambda guide: guide.reject())

    def type_angles(self, angles: dict[str, float]) -> None:
        """State where the dividing head stands.

        Args:
            angles: of its axes, deg; empty: as proposed.

        Raises:
            TiltcalError: no dwell is there, or the table has no such axis.
        """
        self._change(lambda guide: guide.set_angles(angles or None))

    def _change(self, change: "Change") -> None:
        with self._lock:
            if self._guide is not None:
                change(self._guide)
                self.state = self._guide.state

    def _source(self, text: str) -> str:
        """The source, where a file is one of the workspace."""
        if "://" in text or DEVICE.fullmatch(text):
            return text
        return str(self.session.workspace.path(text))

    def _run(self, guide: Guide, source: Source, task: Task) -> None:
        try:
            driver = TableDriver(source) if isinstance(source, ServedTable) else None
            for arrival in source:
                with self._lock:
                    arrival.give(guide)
                    state = guide.state
                if driver is not None:
                    driver.follow(state)
                self._show(state)
                if state.done or self._stop.is_set():
                    break
        except TiltcalError as error:
            self.error = str(error)
        finally:
            source.close()
            self._end(guide, task)

    def _show(self, state: GuideState) -> None:
        before = self.state
        self.state = state
        if before is None or len(before.dwells) != len(state.dwells):
            ratios = {n: p.sigma / p.goal for n, p in state.parameters.items() if p.goal}
            self.sigmas.append(ratios)

    def _end(self, guide: Guide, task: Task) -> None:
        try:
            with self._lock:
                files = guide.save(self.session.workspace.path(task.folder), task.stated)
                self.state = guide.state
            folder = self.session.workspace.folder
            self.written = {k: p.relative_to(folder).as_posix() for k, p in files.items()}
        except TiltcalError as error:
            self.error = self.error or str(error)
        self.running = False


Change = Callable[[Guide], None]
"""Something that an operator tells a guide."""


def words_of(task: Task) -> Sequence[str]:
    """The command that does the same in a terminal."""
    words = ["guide", task.source, "--scenario", task.scenario, "--method", task.method]
    words += ["--goal", *task.goals] if task.goals else []
    words += ["--hold-s", f"{task.hold_s:.10g}", "--speed", f"{task.speed:.10g}"]
    words += ["--columns", ",".join(task.columns)] if task.columns else []
    words += ["--rate-hz", f"{task.rate_hz:.10g}"] if task.rate_hz else []
    return [*words, "-o", task.folder, *(["--certificate"] if task.stated else [])]
