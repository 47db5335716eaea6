"""The program of a disposable process: it makes calls that come on stdin, one at a time, until that
ends, and answers on stdout.

Its limits are those of the operating system, so that they act where Python does not run: an alarm
that ends the process, and a limit on its private memory.
"""

import os
import pickle
import resource
import signal
import sys
import time
from dataclasses import replace
from typing import BinaryIO

from tiltcal.core.tasks.outcome import Limits, Outcome


def main() -> None:
    """Serve calls. What a task itself prints goes to stderr."""
    calls, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # an interrupt is for the process that asks
    signal.signal(signal.SIGTERM, _end)
    while (call := _next(calls)) is not None:
        outcome = _made(*call)
        pickle.dump(outcome, answers)
        answers.flush()
        if outcome.fault:
            return


def _end(*_: object) -> None:
    """Unwind the call, so that it can end what it started in sessions of their own."""
    sys.exit(128 + signal.SIGTERM)


def _next(calls: BinaryIO) -> tuple[Limits, bytes] | None:
    try:
        return pickle.load(calls)
    except EOFError:
        return None


def _made(limits: Limits, call: bytes) -> Outcome:
    start = time.perf_counter()
    _, most = resource.getrlimit(resource.RLIMIT_DATA)
    wanted = limits.memory_mib << 20
    resource.setrlimit(
        resource.RLIMIT_DATA,
        (wanted if most == resource.RLIM_INFINITY else min(wanted, most), most),
    )
    try:
        function, arguments = pickle.loads(call)  # imports, which are no time of the task's
        signal.setitimer(signal.ITIMER_REAL, limits.seconds)
        found = Outcome(function(*arguments))
        pickle.dumps(found)
    except MemoryError:
        found = Outcome(fault="memory")
    except Exception as error:  # noqa: BLE001 whatever a task raises is its answer
        found = Outcome.raised(error)
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    return replace(found, seconds=time.perf_counter() - start)


if __name__ == "__main__":
    main()
