"""Cases one after another in processes that are replaced when they end or hang."""

import json
import os
import select
import shutil
import signal
import tempfile
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from importlib import import_module
from pathlib import Path

from tests.fuzz.cases import Case
from tests.fuzz.judging import LONGEST_S, Outcome, judge, limit_memory
from tiltcal.cli.commands import COMMANDS

Make = Callable[[int], Case]
"""A case by its number."""
MEMORY = 3 << 30
"""Bytes: the 2 GiB that a command may take, and its libraries."""
TOGETHER = 200


def outcomes(numbers: Sequence[int], make: Make) -> Iterator[Outcome]:
    """What became of each case, by its number."""
    for command in COMMANDS.values():
        import_module("tiltcal.cli." + command.target.partition(":")[0])
    left = list(numbers)
    while left:
        for outcome in in_child(left[:TOGETHER], make):
            left.remove(outcome.number)
            yield outcome


def in_child(numbers: list[int], make: Make) -> Iterator[Outcome]:
    """Cases in one process; the one in which it ends is its last."""
    read, write = os.pipe()
    home = Path(tempfile.mkdtemp(prefix="fuzz-"))
    child = os.fork()
    if child == 0:
        os.close(read)
        work(numbers, make, home, lambda line: os.write(write, line) and None)
    os.close(write)
    done: list[int] = []
    try:
        for line in lines_of(read):
            done.append(int(line["number"]))
            yield Outcome(**line)
    except TimeoutError:
        os.kill(child, signal.SIGKILL)
        kind = "hang"
    else:
        kind = "crash"
    finally:
        os.close(read)
        _, status = os.waitpid(child, 0)
        shutil.rmtree(home, ignore_errors=True)
    following = next((n for n in numbers if n not in done), None)
    if following is not None:
        case = make(following)
        words = " ".join(ascii(a)[:100] for a in case.arguments)
        yield Outcome(following, kind, f"{words} {case.changed}", f"wait status {status}", 0.0)


def work(numbers: list[int], make: Make, home: Path, tell: Callable[[bytes], None]) -> None:
    """Run cases, tell what became of each, and end this process."""
    try:
        os.environ["HOME"] = str(home)
        limit_memory(MEMORY)
        for number in numbers:
            place = Path(tempfile.mkdtemp(dir=home))
            tempfile.tempdir = str(home)
            outcome = judge(make(number), place)
            shutil.rmtree(place, ignore_errors=True)
            tell(json.dumps(asdict(outcome)).encode() + b"\n")
        os._exit(0)
    except BaseException:  # noqa: BLE001  of the fuzz program itself
        traceback.print_exc()
        os._exit(3)


def lines_of(read: int) -> Iterator[dict[str, object]]:
    """What a child tells.

    Raises:
        TimeoutError: it says nothing for longer than a case may take.
    """
    rest = b""
    while True:
        ready, _, _ = select.select([read], [], [], 3 * LONGEST_S)
        if not ready:
            raise TimeoutError
        more = os.read(read, 1 << 16)
        if not more:
            return
        *whole, rest = (rest + more).split(b"\n")
        for line in whole:
            yield json.loads(line)
