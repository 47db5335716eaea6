"""Ctrl-C and a request to end, SIGTERM: both unwind the command, which leaves no partial output."""

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

INTERRUPTED = 130
TERMINATED = 143
LATER_S = 0.01  # until a lost interrupt comes again, when nothing swallows it

received: list[int] = []
"""The signals that have come: an exception that one of them raised may turn into another."""


class Terminated(KeyboardInterrupt):
    """SIGTERM: unwinds as Ctrl-C does."""


@contextmanager
def unwinding() -> Iterator[None]:
    """Both signals as exceptions. Those that follow are ignored, so that the first one can clear
    up.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {s: signal.getsignal(s) for s in (signal.SIGINT, signal.SIGTERM)}
    heard = [s for s, handler in before.items() if handler is not signal.SIG_IGN]
    hook = sys.unraisablehook

    received.clear()

    def end(number: int, _: Any) -> None:
        received.append(number)
        ignore()
        raise Terminated if number == signal.SIGTERM else KeyboardInterrupt

    def listen() -> None:
        for number in heard:
            signal.signal(number, end)

    def again(lost: Any) -> None:
        """An interrupt that fell into a destructor or a callback, where nothing can be raised."""
        if not isinstance(lost.exc_value, KeyboardInterrupt):
            hook(lost)
            return
        listen()
        number = signal.SIGTERM if isinstance(lost.exc_value, Terminated) else signal.SIGINT
        threading.Timer(LATER_S, os.kill, (os.getpid(), number)).start()

    listen()
    sys.unraisablehook = again
    try:
        yield
    finally:
        sys.unraisablehook = hook
        for number, handler in before.items():
            if handler is not None:
                signal.signal(number, handler)


def ignore() -> None:
    """Let both signals pass unheard from now on."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)


def terminated() -> bool:
    """Whether the signal that came is SIGTERM."""
    return bool(received) and received[-1] == signal.SIGTERM
