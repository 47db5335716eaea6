"""Judge the calibration methods by the examiner's cases.

    python -m examiner [--count N] [--seed S] [--systems NAME ...] [--faults NAME ...] [--show]

Prints for each system and fault: how many cases, wrong results called good, causes named, and for
clean cases those not called good. A result is wrong where its parameters are off by more than their
covariance allows at 1e-6.
"""

import argparse
import re
import zlib
from collections import Counter

import numpy as np

from examiner.case import FAULTS, MAKERS
from examiner.judge import Outcome, judged

BAD = ("suspect", "refused")


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("--count", type=int, default=10, help="cases of each fault")
    words.add_argument("--clean", type=int, default=40, help="clean cases of each system")
    words.add_argument("--seed", type=int, default=1)
    words.add_argument("--systems", nargs="*", default=list(MAKERS))
    words.add_argument("--faults", nargs="*", default=None)
    words.add_argument("--show", action="store_true", help="print what each failing case said")
    given = words.parse_args()
    total: Counter[str] = Counter()
    print(f"{'system':14} {'fault':18} cases good wrong-good named z")
    for name in given.systems:
        for fault in ["clean", *FAULTS[name]]:
            if given.faults is not None and fault not in given.faults:
                continue
            count = given.clean if fault == "clean" else given.count
            found = [_one(name, fault, k, given.seed) for k in range(count)]
            _report(name, fault, found, total, show=given.show)
    print(
        f"wrong and good {total['wrong']}/{total['all']}; cause named {total['named']}/"
        f"{total['faults']}; harmless input suspect or refused {total['false']}/{total['harmless']}"
    )


def _one(name: str, fault: str, k: int, seed: int) -> Outcome:
    rng = np.random.default_rng([seed, k, zlib.crc32(f"{name} {fault}".encode())])
    return judged(MAKERS[name](rng, fault))


def _report(
    name: str, fault: str, found: list[Outcome], total: Counter[str], *, show: bool
) -> None:
    harmless = fault == "clean" or not FAULTS[name][fault]
    good = sum(o.verdict == "good" for o in found)
    wrong = sum(o.verdict == "good" and o.wrong for o in found)
    named = sum(bool(re.search(FAULTS[name].get(fault) or "$^", o.words, re.I)) for o in found)
    z = np.nanmedian([o.z for o in found])
    print(
        f"{name:14} {fault:18} {len(found):5} {good:4} {wrong:10} "
        f"{'-' if harmless else named:>5} {z:.2f}"
    )
    total.update(all=len(found), wrong=wrong)
    if harmless:
        total.update(harmless=len(found), false=sum(o.verdict in BAD for o in found))
    else:
        total.update(faults=len(found), named=named)
    if show:
        for k, o in enumerate(found):
            fine = (
                o.verdict not in BAD if harmless else re.search(FAULTS[name][fault], o.words, re.I)
            )
            if not fine or (o.verdict == "good" and o.wrong):
                print(f"    {k}: {o.verdict} z {o.z:.3g}: {o.words[:700]}")


main()
