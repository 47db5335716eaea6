"""Figures of accuracy, speed and memory: no tests, as their limits are for an idle machine.

Where ``TILTCAL_BENCH`` is ``smoke``, each module runs at its smallest size: whether it ends, not
what it measures. The limits are in processor time of one thread, which other programs on the
machine spoil least: `make bench` lets the linear algebra have one.
"""

import os
import resource
from typing import TypeVar

T = TypeVar("T")
SMOKE = os.environ.get("TILTCAL_BENCH") == "smoke"


def sized(full: T, smallest: T) -> T:
    """A size of a benchmark: in full, or the smallest where it only has to end."""
    return smallest if SMOKE else full


def children_s() -> float:
    """Processor time of the programs that this one started and that have ended, s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
