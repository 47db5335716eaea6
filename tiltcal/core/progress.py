"""Progress of a long run, as text, with the time left."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sized
from typing import TypeVar

T = TypeVar("T")
S = TypeVar("S", bound=Sized)
Progress = Callable[[str], None]
Part = Callable[[float], None]
"""Callback, called with the share of some work that is done, 0 to 1."""


def silent(text: str) -> None:
    """Report nothing."""


def unmeasured(done: float) -> None:
    """Report no share."""


def duration(seconds: float) -> str:
    """A time as text: s, min or h."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


class Rate:
    """Progress as text, with the rate and the time left.

    Args:
        total: of tasks.
        unit: name of a task, in the plural.
    """

    def __init__(self, total: int, unit: str = "runs") -> None:
        self.made = 0
        self._total, self._unit, self._start = total, unit, time.monotonic()

    def after_one(self, had: int = 0) -> str:
        """Text after one more task; ``had``: tasks that were finished before."""
        return self.after(self.made + 1, had)

    def after(self, made: int, had: int = 0) -> str:
        """Text after ``made`` tasks; ``had``: tasks that were finished before."""
        self.made = made
        done = had + made
        if not made:
            return f"{done} of {self._total} {self._unit}"
        rate = made / max(time.monotonic() - self._start, 1e-9)
        left = (self._total - done) / rate
        pace = f"{rate:.3g}" if rate < 1000 else f"{float(f'{rate:.3g}'):.0f}"
        return f"{done} of {self._total} {self._unit}, {pace} a second, {duration(left)} left"


def report_each(items: Iterable[T], rate: Rate, progress: Progress) -> Iterator[T]:
    """The same items; each one that was taken is reported, with the rate and the time left."""
    for item in items:
        yield item
        progress(rate.after_one())


def report_pieces(
    pieces: Iterable[S], total: int, progress: Progress, unit: str = "rows"
) -> Iterator[S]:
    """The same pieces; before each but the first the amount taken is reported, with the rate and
    the time left.

    Args:
        pieces: for example of a recording; their lengths add up to about ``total``.
        total: as far as it is known before.
        progress: callback for the text.
        unit: what the lengths count.
    """
    rate, taken = Rate(total, unit), 0
    for piece in pieces:
        if taken:
            progress(rate.after(min(taken, total)))
        yield piece
        taken += len(piece)


class Stages:
    """Progress of work in stages, with the time left, by the usual share of each stage.

    A stage that reports its parts is extrapolated from them. One that cannot know how long it takes
    is expected to take its share; when that time is over, the time left is a lower bound, shown as
    one.

    Args:
        progress: callback for the text.
        shares: of the time that each stage usually takes, by its name, in order. Any scale.
    """

    def __init__(self, progress: Progress, shares: Mapping[str, float]) -> None:
        self._progress, self._shares = progress, dict(shares)
        self._names = list(shares)
        self._stage, self._part, self._detail = -1, 0.0, ""
        self._start = self._began = time.monotonic()

    def begin(self, name: str) -> None:
        """A stage begins; those before it are over. ``name``: a key of the shares."""
        self._stage = self._names.index(name)
        self._part, self._detail, self._began = 0.0, "", time.monotonic()
        self._report()

    def part(self, done: float) -> None:
        """A part of the stage is done, 0 to 1."""
        self._part = done
        self._report()

    def status(self, detail: str) -> None:
        """The stage continues; the share of it that is done is not known. ``detail``: what was
        reached.
        """
        self._detail = detail
        self._report()

    def _report(self) -> None:
        name = self._names[self._stage]
        text = f"{name} ({self._detail})" if self._detail else name
        left = self._left()
        self._progress(text if left is None else f"{text}: {left}")

    def _left(self) -> str | None:
        """Time left as text; None while there is nothing to extrapolate from."""
        now = time.monotonic()
        shares = [self._shares[name] for name in self._names]
        before, here = sum(shares[: self._stage]), shares[self._stage]
        after = sum(shares) - before - here
        if self._part > 0:
            done = before + here * self._part
            left = (now - self._start) * (sum(shares) - done) / done
            return f"about {duration(left)} left"
        if not before:
            return None
        pace = (self._began - self._start) / before
        standstill = pace * here - (now - self._began)
        if standstill >= 0:
            return f"about {duration(standstill + pace * after)} left"
        pace = (now - self._start) / (before + here)
        return f"{duration(max(pace * after, 1.0))} or more left"
