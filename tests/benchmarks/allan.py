"""Overlapped Allan deviation of an hour at 100 Hz, octave averaging times; beside allantools where
that is installed.
"""

import importlib.util
import time
from collections.abc import Callable

import numpy as np

from tests.benchmarks import sized
from tiltcal.statistics.allan import allan_deviation

RATE, SECONDS = 100.0, sized(3600, 60)


def best_of(work: Callable[[], object], runs: int = 15) -> float:
    """Shortest time of some runs, s."""
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def main() -> None:
    """Time in ms; the ratio to allantools in the same run, and how far the two deviations
    differ.
    """
    y = np.random.default_rng().normal(size=int(SECONDS * RATE))
    own = best_of(lambda: allan_deviation(y, RATE))
    print(f"allan: 1 h x 100 Hz, octaves: {own * 1e3:.1f} ms")
    if importlib.util.find_spec("allantools") is None:
        print(
            "allan: allantools is not installed here (it is no dependency): nothing to compare with"
        )
        return
    import allantools  # type: ignore[import-not-found]

    other = best_of(lambda: allantools.oadev(y, rate=RATE, data_type="freq", taus="octave"), 5)
    tau, deviation, *_ = allantools.oadev(y, rate=RATE, data_type="freq", taus="octave")
    difference = np.abs(allan_deviation(y, RATE, tau).deviation / deviation - 1).max()
    same = best_of(lambda: allan_deviation(y, RATE, tau))
    print(
        f"allan: allantools {other * 1e3:.1f} ms for the same averaging times, {other / same:.1f}"
        " times as long"
    )
    print(f"allan: the two differ by {difference:.1g} of the deviation")
