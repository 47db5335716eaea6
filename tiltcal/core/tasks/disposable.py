"""Calls in a process of their own, which a call may hang, kill or fill: the one that asks only sees
an outcome.

A process serves any number of calls and is replaced after one that it did not survive.
"""

import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from tiltcal.core.tasks.outcome import Limits, Outcome

ENDING_S = 0.5  # a process that ends by itself is given as long, so that its own status is reported


class DisposableProcess:
    """One process for calls of one thread; started when it is first needed, and again after it was
    lost.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._closed = False

    def call(
        self, function: Callable[..., Any], arguments: tuple[Any, ...], limits: Limits
    ) -> Outcome:
        """What became of a call.

        Args:
            limits: of time and memory.
            function: importable by its name in another process.
            arguments: what pickle takes.
        """
        start = time.perf_counter()
        try:
            packed = pickle.dumps((function, arguments))
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            return Outcome.raised(error)
        process = self._running()
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            pickle.dump((limits, packed), process.stdin)
            process.stdin.flush()
            outcome: Outcome = pickle.load(process.stdout)
        except (EOFError, OSError, pickle.UnpicklingError):
            return _lost(self._ended(process), time.perf_counter() - start)
        if outcome.fault:
            self._ended(process)
        return outcome

    def close(self) -> None:
        """End the process, for good; another thread's call in it is lost."""
        self._closed = True
        if (process := self._process) is not None:
            _kill(process, signal.SIGTERM)
            self._ended(process)

    def _running(self) -> subprocess.Popen[bytes]:
        if self._process is None:
            # a session of its own, so that what a task started goes with it
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "tiltcal.core.tasks.serve"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
            if self._closed:
                self.close()
        return self._process

    def _ended(self, process: subprocess.Popen[bytes]) -> int:
        """The exit status of a process that is gone, and all it started with it."""
        self._process = None
        with suppress(subprocess.TimeoutExpired):
            process.wait(ENDING_S)
        _kill(process)
        status = process.wait()
        for pipe in (process.stdin, process.stdout):
            with suppress(OSError):
                if pipe is not None:
                    pipe.close()
        return status


def _kill(process: subprocess.Popen[bytes], number: signal.Signals = signal.SIGKILL) -> None:
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, number)


def _lost(status: int, seconds: float) -> Outcome:
    if status == -signal.SIGALRM:
        return Outcome(fault="time", seconds=seconds)
    how = f"signal {signal.Signals(-status).name}" if status < 0 else f"exit status {status}"
    return Outcome(error=f"its process ended by {how}", fault="ended", seconds=seconds)


_own = threading.local()
_all: list[DisposableProcess] = []


def call_apart(function: Callable[..., Any], arguments: tuple[Any, ...], limits: Limits) -> Outcome:
    """What became of a call in the disposable process of this thread.

    A call whose process was ended is made once more: that may have been no fault of the call.

    Args:
        limits: of time and memory.
        function: importable by its name in another process.
        arguments: what pickle takes.
    """
    if not hasattr(_own, "process"):
        _own.process = DisposableProcess()
        _all.append(_own.process)
    process: DisposableProcess = _own.process
    outcome = process.call(function, arguments, limits)
    return process.call(function, arguments, limits) if outcome.fault == "ended" else outcome


def close_all() -> None:
    """End the disposable processes of all threads; calls that are being made are lost."""
    while _all:
        _all.pop().close()
