"""Which cases are run: so many of every type, or the frozen set."""

from collections.abc import Sequence
from typing import NamedTuple

from blind.cases import AUTHORED, KINDS, TYPES, possible
from blind.catalogue import AUTHORS

BENCHMARK_SEED = 20261123
# type, author, how many: never changed, or the name is
BENCHMARK = (
    ("null", "first", 20),
    ("null", "second", 30),
    ("single", "first", 32),
    ("odd", "first", 18),
    ("data", "first", 18),
    ("pair", "first", 14),
    ("triple", "first", 14),
    ("unlisted", "first", 16),
    ("unlisted", "second", 32),
    ("impossible", "first", 6),
)


class Job(NamedTuple):
    """One case to be drawn. k: its number, which decides the stratum of the random walk too."""

    kind: str
    type_: str
    k: int
    author: str


def plan(
    n: int,
    kinds: Sequence[str] = KINDS,
    types: Sequence[str] = TYPES,
    authors: Sequence[str] = AUTHORS,
) -> list[Job]:
    """n cases of every type and author, the kinds in turn. Types that have one author only are run
    whoever is asked for.
    """
    out = []
    for i in range(n):
        for type_ in types:
            for author in authors if type_ in AUTHORED else AUTHORS[:1]:
                out += in_turn(i, kinds, type_, author)
    return out


def in_turn(i: int, kinds: Sequence[str], type_: str, author: str) -> list[Job]:
    """The i-th case of a type; none where no kind can have it."""
    own = [k for k in kinds if possible(k, type_)]
    return [Job(own[i % len(own)], type_, i // len(own), author)] if own else []


def benchmark() -> list[Job]:
    """The frozen set: 200 cases, all drawn from BENCHMARK_SEED."""
    return [
        job
        for type_, author, n in BENCHMARK
        for i in range(n)
        for job in in_turn(i, KINDS, type_, author)
    ]
