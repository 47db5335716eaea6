"""What ``tiltcal guide`` shows: a changing page on a terminal, a line an event in a pipe."""

import time
from collections.abc import Callable, Iterator
from typing import Protocol

from tiltcal.cli.output import line_width
from tiltcal.guide.state import Dwell, GuideState, Notice, ParameterState

REFRESH_S = 0.25  # of the page
BAR = 12  # characters
DECADES = 3.0  # from the goal that a full bar lacks


class Display(Protocol):
    """Shows states."""

    def show(self, state: GuideState) -> None:
        """Show a state."""


class Page:
    """A page on a terminal.

    Args:
        write: shows a text in place of the last.
    """

    def __init__(self, write: Callable[[str], None]) -> None:
        self._write, self._shown = write, 0.0

    def show(self, state: GuideState) -> None:
        """Show a state, a few times a second at most."""
        now = time.monotonic()
        if now - self._shown < REFRESH_S and not state.done:
            return
        self._shown = now
        self._write("\n".join(line[: line_width() - 1] for line in page_lines(state)))


class Events:
    """A line for each dwell, each new proposal and each notice.

    Args:
        write: shows a line.
    """

    def __init__(self, write: Callable[[str], None]) -> None:
        self._write = write
        self._dwells: tuple[Dwell, ...] = ()
        self._notices: set[tuple[str, str]] = set()
        self._proposed = ""

    def show(self, state: GuideState) -> None:
        """Show what is new in a state."""
        for number, dwell in enumerate(state.dwells, start=1):
            if number > len(self._dwells):
                self._write(dwell_line(number, dwell, state))
        self._dwells = state.dwells
        now = {(n.kind, n.statement.partition(":")[0]): n for n in state.notices}
        for key in now.keys() - self._notices:
            self._write(notice_line(now[key]))
        self._notices = set(now)
        proposed = state.instruction if state.action in ("turn", "type", "done") else ""
        if proposed and proposed != self._proposed:
            self._proposed = proposed
            self._write(f"> {proposed}")


def page_lines(state: GuideState) -> Iterator[str]:
    """The page of a state."""
    yield f"> {state.instruction}"
    yield ""
    still = f"standing still for {state.held_s:.1f} s" if state.standing else "moving"
    seconds = "no samples" if state.time_s is None else f"{state.time_s:.1f} s"
    rate = "" if state.rate_hz is None else f", {state.rate_hz:.4g} Hz"
    yield f"{seconds}{rate}, {still}"
    yield "  ".join(f"{name} {mean:.5g}" for name, mean in state.reading.items())
    expected = "" if state.expected_dwells is None else f" of about {state.expected_dwells}"
    verdict = "" if state.verdict is None else f"; the calibration so far is {state.verdict}"
    yield f"dwells: {sum(d.used for d in state.dwells)}{expected}{verdict}"
    yield ""
    for name, parameter in state.parameters.items():
        yield parameter_line(name, parameter)
    if state.notices:
        yield ""
    for notice in state.notices:
        yield notice_line(notice)
    yield ""
    typed = "angles such as 90 0, Enter: as proposed; " if state.action == "type" else ""
    yield f"({typed}r Enter: reject the last dwell; q Enter: stop)"


def parameter_line(name: str, parameter: ParameterState) -> str:
    """A parameter on its way to its goal."""
    from math import log10

    lacking = log10(parameter.sigma / parameter.goal) / DECADES if parameter.sigma > 0 else 0.0
    full = round(BAR * (1 - min(max(lacking, 0.0), 1.0)))
    value = "" if parameter.value is None else f"{parameter.value:.6g}"
    sigma = f"{parameter.sigma:.3g}{'' if parameter.fitted else ' (expected)'}"
    bar = "#" * full + "." * (BAR - full)
    return f"{name:18} {bar} {value:>10} +- {sigma} of {parameter.goal:.3g} {parameter.unit}"


def dwell_line(number: int, dwell: Dwell, state: GuideState) -> str:
    """A dwell that was taken."""
    furthest = max(state.parameters, key=lambda n: _ratio(state.parameters[n]))
    parameter = state.parameters[furthest]
    sigma = f"{parameter.sigma:.3g} of {parameter.goal:.3g} {parameter.unit}"
    what = f"rejected: {dwell.reason}" if dwell.reason else f"sigma of {furthest} {sigma}"
    return f"dwell {number} at {dwell.start_s:.1f} s {dwell.label}: {what}".replace("  ", " ")


def _ratio(parameter: ParameterState) -> float:
    return parameter.sigma / parameter.goal


def notice_line(notice: Notice) -> str:
    """Something to mend."""
    return f"! {notice.kind}: {notice.statement}"
