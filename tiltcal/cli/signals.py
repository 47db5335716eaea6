"""Ctrl-C and a request to end, SIGTERM: both unwind the command, which leaves no partial output."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

INTERRUPTED = 130
TERMINATED = 143


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

    def end(number: int, _: Any) -> None:
        ignore()
        raise Terminated if number == signal.SIGTERM else KeyboardInterrupt

    for number, handler in before.items():
        if handler is not signal.SIG_IGN:
            signal.signal(number, end)
    try:
        yield
    finally:
        for number, handler in before.items():
            if handler is not None:
                signal.signal(number, handler)


def ignore() -> None:
    """Let both signals pass unheard from now on."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
