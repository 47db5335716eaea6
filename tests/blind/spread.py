"""Trials over processes of this machine, or over whatever the caller spreads them."""

import argparse
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any

Call = tuple[Any, ...]
Spread = Callable[[Callable[..., Any], Sequence[Call]], Iterator[Any]]
"""Makes a call of a function for each of some arguments, and gives the results in any order."""


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


def shard(words: str) -> tuple[int, int]:
    """``i/n``: every n-th trial, from the i-th on."""
    first, _, step = words.partition("/")
    if not (first.isdecimal() and step.isdecimal() and 1 <= int(first) <= int(step)):
        raise argparse.ArgumentTypeError(f"found {words}, need i/n with i from 1 to n")
    return int(first), int(step)
