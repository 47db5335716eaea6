"""What was chosen and entered, one for all tabs of a workspace: kept on the server and in the
folder, so that a reload and a second tab show the same.
"""

import threading
from collections.abc import Callable, Hashable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, TypeVar

from tiltcal.app.jobs import Job, Jobs
from tiltcal.app.workspace import Entry, Workspace
from tiltcal.core.errors import TiltcalError

Value = TypeVar("Value")
FILES, JOBS = "files", "jobs"
"""What listeners may be told of, in addition to the keys of values."""
READ = 8  # results of reading files that are kept: a recording of 1e6 rows takes some 60 MB


@dataclass(frozen=True)
class Listener:
    """A part of a page that shows something of the session.

    Args:
        topics: keys of values, ``files`` or ``jobs``.
        tell: called when one of them has changed.
    """

    topics: frozenset[str]
    tell: Callable[[], None]


@dataclass(eq=False)
class Session:
    """The session of a workspace.

    Args:
        workspace: its folder.
        values: by key, ``page.name``: text, numbers, flags and lists of these.
    """

    workspace: Workspace
    values: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.values |= self.workspace.load_state()
        self.jobs = Jobs(self.workspace.folder, lambda: self.tell(JOBS))
        self._listeners: dict[int, Listener] = {}
        self._next = 0
        self._there = self._visible()
        self.inspected: set[Hashable] = set()  # stamps of recordings whose findings are known
        self._read = lru_cache(READ)(_loaded)
        self._reading: dict[Hashable, threading.Lock] = {}

    def text(self, key: str) -> str:
        """A text that was chosen or entered; empty where none was."""
        found = self.values.get(key)
        return found if isinstance(found, str) else ""

    def texts(self, key: str) -> list[str]:
        """A list of texts; empty where none was chosen."""
        found = self.values.get(key)
        return [x for x in found if isinstance(x, str)] if isinstance(found, list) else []

    def number(self, key: str, default: float) -> float:
        """A number that was entered."""
        found = self.values.get(key)
        known = isinstance(found, int | float) and not isinstance(found, bool)
        return float(found) if known and found is not None else default

    def flag(self, key: str, default: bool = False) -> bool:
        """Whether something was ticked."""
        found = self.values.get(key)
        return found if isinstance(found, bool) else default

    def set(self, key: str, value: Any) -> None:
        """Take a value over, keep it and tell those who show it."""
        if key in self.values and self.values[key] == value:
            return
        self.values[key] = value
        with suppress(TiltcalError):  # a full disk loses no more than the next start's choices
            self.workspace.save_state(self.values)
        self.tell(key)

    def listen(self, topics: tuple[str, ...], tell: Callable[[], None]) -> Callable[[], None]:
        """Be told of changes; the result ends it."""
        number = self._next
        self._next += 1
        self._listeners[number] = Listener(frozenset(topics), tell)

        def end() -> None:
            self._listeners.pop(number, None)

        return end

    def tell(self, topic: str) -> None:
        """Tell those who show it that something has changed."""
        for listener in list(self._listeners.values()):
            if topic in listener.topics:
                listener.tell()

    def listed(self) -> None:
        """Files of the workspace have changed."""
        self.tell(FILES)

    def look(self) -> None:
        """See whether files were put into the folder, or taken away, by somebody else."""
        now = self._visible()
        if now != self._there:
            self._there = now
            self.listed()

    def _visible(self) -> frozenset[str]:
        try:
            names = [p.name for p in self.workspace.folder.iterdir()]
        except OSError:  # the folder went away
            return frozenset()
        return frozenset(name for name in names if not name.startswith("."))

    def files(self, *kinds: str) -> list[Entry]:
        """The files of some kinds; of all without any."""
        return [e for e in self.workspace.entries() if not kinds or e.kind in kinds]

    def chosen(self, key: str, *kinds: str) -> str:
        """The chosen file where it is still there; empty otherwise."""
        name = self.text(key)
        with suppress(TiltcalError, OSError):
            if name and self.workspace.path(name).is_file():
                return name
        return ""

    def names(self, *kinds: str) -> tuple[str, ...]:
        """The names of the files of some kinds."""
        return tuple(e.name for e in self.files(*kinds))

    def stamp(self, keys: tuple[str, ...], *files: str) -> Hashable:
        """What changes when a value of these keys or the content of a file does."""
        found: list[Hashable] = [repr(self.values.get(key)) for key in keys]
        for name in files:
            with suppress(TiltcalError, OSError):
                about = self.workspace.path(name).stat()
                found.append((name, about.st_mtime_ns, about.st_size))
        return tuple(found)

    def read(self, name: str, what: Hashable, load: Callable[[], Value]) -> Value:
        """A result of reading a file, kept until the file changes; parts of a page that ask for
        the same wait for one reading.

        Args:
            name: of the file.
            what: is read from it.
            load: reads it.
        """
        about = self.workspace.path(name).stat()
        key = _Key((name, what, about.st_mtime_ns, about.st_size))
        with self._reading.setdefault((name, what), threading.Lock()):
            return self._read(key, _Load(load))

    async def run(self, title: str, words: list[str]) -> Job:
        """Run a command in the workspace; the list of files is looked at afterwards."""
        job = await self.jobs.run(title, words)
        self.listed()
        return job


def _loaded(key: "_Key", load: "_Load") -> Any:
    del key  # it is the cache that needs it
    return load()


@dataclass(frozen=True)
class _Key:
    parts: tuple[Hashable, ...]


class _Load:
    """A function that is no part of the key of what it returns."""

    def __init__(self, load: Callable[[], Any]) -> None:
        self._load = load

    def __call__(self) -> Any:
        return self._load()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Load)

    def __hash__(self) -> int:
        return 0
