"""Trials over processes of this machine, or over whatever the caller spreads them."""

import argparse
import re
import shlex
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any, NoReturn

Call = tuple[Any, ...]
Spread = Callable[[Callable[..., Any], Sequence[Call]], Iterator[Any]]
"""Makes a call of a function for each of some arguments, and gives the results in any order."""


class Count:
    """How many of some trials are over, and the time that the others will take."""

    def __init__(self, total: int) -> None:
        self._total, self._made, self._start = total, 0, time.monotonic()

    def after_one(self) -> str:
        """Words after one more trial."""
        self._made += 1
        if self._made == self._total:
            return f"{self._made}/{self._total}:"
        left = (time.monotonic() - self._start) / self._made * (self._total - self._made)
        words = f"{left:.0f} s" if left < 90 else f"{left / 60:.0f} min"
        return f"{self._made}/{self._total}, about {words} left:"


def in_processes(jobs: int) -> Spread:
    """So many calls at the same time in processes of this machine."""

    def spread(function: Callable[..., Any], calls: Sequence[Call]) -> Iterator[Any]:
        with ProcessPoolExecutor(jobs) as pool:
            try:
                for future in as_completed([pool.submit(function, *call) for call in calls]):
                    yield future.result()
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise

    return spread


class Parser(argparse.ArgumentParser):
    """Ends with its message instead of printing it, so that a caller can say it in its own form."""

    def error(self, message: str) -> NoReturn:
        """End the program.

        Raises:
            SystemExit: always, with the message.
        """
        raise SystemExit(message)


def command(text: str) -> list[str]:
    """The words of a command, as a shell would take them apart."""
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r}: {error}") from error
    if not words:
        raise argparse.ArgumentTypeError("no command")
    return words


def shard(words: str) -> tuple[int, int]:
    """``i/n``: every n-th trial, from the i-th on."""
    first, _, step = words.partition("/")
    whole = re.fullmatch("[0-9]{1,9}/[0-9]{1,9}", words)
    if not (whole and 1 <= int(first) <= int(step)):
        raise argparse.ArgumentTypeError(f"found {words}, need i/n with i from 1 to n")
    return int(first), int(step)
