"""Run mutated inputs through every command, and count what breaks the rules.

    python -m tests.fuzz --count 20000 --seed 1
    python -m tests.fuzz --seed 1 --only 1234
    python -m tests.fuzz --options

Exit status: 0 nothing broke a rule; 1 something did.
"""

import argparse
import sys
import tempfile
import time
from collections import Counter
from functools import partial
from pathlib import Path

from tests.fuzz.cases import Case, make_case
from tests.fuzz.judging import SOUND, Outcome
from tests.fuzz.options import option_cases
from tests.fuzz.originals import make_originals
from tests.fuzz.running import outcomes


def main() -> int:
    """Run and report."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", type=int, nargs="*")
    parser.add_argument("--options", action="store_true", help="every option with odd values")
    parser.add_argument("--log", type=Path, help="file for all that is known of each failure")
    words = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        originals = make_originals(Path(place))
    numbers, make = words.only or range(words.first, words.first + words.count), None
    if words.options:
        cases = option_cases(originals)
        numbers, make = words.only or range(len(cases)), cases.__getitem__
    start, found = time.monotonic(), []
    log = words.log.open("w") if words.log else None
    for outcome in outcomes(numbers, make or partial(case_of, words.seed, originals)):
        found.append(outcome)
        if outcome.kind != SOUND:
            print_to(log or sys.stderr, outcome)
        if len(found) % 500 == 0:
            print(f"{len(found)} of {len(numbers)}, {counts(found)}", file=sys.stderr, flush=True)
    return report(found, time.monotonic() - start)


def case_of(seed: int, originals: dict[str, bytes], number: int) -> Case:
    """A mutated input."""
    return make_case(seed, number, originals)


def print_to(log: object, outcome: Outcome) -> None:
    """One failure."""
    text = f"--- {outcome.number} {outcome.kind}: {outcome.where}\n{outcome.told}"
    print(text, file=log, flush=True)  # type: ignore[call-overload]


def counts(found: list[Outcome]) -> str:
    """How often each kind."""
    return ", ".join(f"{n} {k}" for k, n in Counter(o.kind for o in found).most_common())


def report(found: list[Outcome], seconds: float) -> int:
    """Counts by kind and place."""
    broken = [o for o in found if o.kind != SOUND]
    print(f"{len(found)} inputs in {seconds:.0f} s: {counts(found)}")
    slowest = sorted(found, key=lambda o: -o.seconds)[:3]
    print("slowest: " + ", ".join(f"{o.number} {o.seconds:.1f} s" for o in slowest))
    for (kind, where), number in Counter((o.kind, o.where) for o in broken).most_common():
        example = next(o.number for o in broken if (o.kind, o.where) == (kind, where))
        print(f"{number:5d}  {kind}: {where[:150]}  (as {example})")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
