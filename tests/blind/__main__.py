"""Run trials and print the score table: ``python -m blind --diagnoser 'tiltcal' -o DIR`` with this
folder's parent on the path.
"""

import json
import shlex
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from blind.cases import KINDS, TYPES
from blind.catalogue import AUTHORS
from blind.plans import BENCHMARK_SEED, benchmark, plan
from blind.reliability import reliability
from blind.reliability import show as show_reliability
from blind.spread import Count, Parser, Spread, command, in_processes, shard
from blind.table import lines, show
from blind.trial import trial


def main(arguments: Sequence[str] | None = None, spread: Spread | None = None) -> int:
    """Run trials and score them.

    Args:
        spread: makes the trials, in any order; by default in processes of this machine.

    Exit status 0: nothing fell short beyond chance; 1: something did.
    """
    args = _parser().parse_args(arguments)
    folder = Path(args.output) if args.output else Path(tempfile.mkdtemp(prefix="blind-"))
    jobs = benchmark() if args.benchmark else plan(args.n, args.kinds, args.types, args.authors)
    first, step = args.shard
    jobs = jobs[first - 1 :: step]
    seed = BENCHMARK_SEED if args.benchmark else args.seed
    said, limit = args.diagnoser, args.time_limit
    calls = [(folder, j.kind, j.type_, j.k, seed, said, limit, j.author) for j in jobs]
    results = []
    count = Count(len(jobs))
    try:
        for result in (spread or in_processes(args.jobs))(trial, calls):
            results.append(result)
            _tell(result, count.after_one())
    except KeyboardInterrupt:
        print(
            f"interrupted after {len(results)} of {len(jobs)}; run again with -o {folder} to go on",
            file=sys.stderr,
        )
        raise
    return _finish(results, folder, args.json)


def _finish(results: list[dict[str, Any]], folder: Path, as_json: bool) -> int:
    table, told = lines(results), reliability(results)
    rows = [
        {
            "name": x.name,
            "hits": x.hits,
            "n": x.n,
            "interval": x.interval if x.is_rate else None,
            "required": x.limit,
            "failed": x.failed,
        }
        for x in table
    ]
    folder.mkdir(parents=True, exist_ok=True)
    score = {"table": rows} | ({"reliability": told} if told else {})
    (folder / "score.json").write_text(
        json.dumps(score | {"cases": results}, indent=1, default=float) + "\n", encoding="utf-8"
    )
    if as_json:
        print(json.dumps(score, indent=1, default=float))
    else:
        print(show(table))
        if told:
            print(show_reliability(told))
    print(f"cases, answers and truth: {folder}", file=sys.stderr)
    return int(any(x.failed for x in table))


def _tell(r: dict[str, Any], count: str) -> None:
    said = "+".join(str(f) for f in r["findings"]) or "-"
    truth = "+".join(r["truth"]) or r.get("nuisance") or "-"
    lam = "+".join("-" if x is None else f"{x:.0f}" for x in r["lambda"])
    print(
        f"{count} {r['name']:32s} {r['seconds']:5.1f} s  {truth} ({lam})"
        f" -> {r['verdict']}: {said} {r['note']}",
        file=sys.stderr,
        flush=True,
    )


def _parser() -> Parser:
    parser = Parser(prog="blind", description=__doc__)
    parser.add_argument("--n", type=int, default=5)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--types", nargs="+", choices=TYPES, default=TYPES)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-j", "--jobs", type=int, default=1)
    parser.add_argument("--authors", nargs="+", choices=AUTHORS, default=AUTHORS)
    parser.add_argument("--benchmark", action="store_true")
    python = f"{shlex.quote(sys.executable)} -m tiltcal"
    parser.add_argument("--diagnoser", type=command, default=python)
    parser.add_argument("--time-limit", type=float, default=300.0)
    parser.add_argument("--shard", type=shard, default=(1, 1))
    parser.add_argument("-o", "--output")
    parser.add_argument("--json", action="store_true")
    return parser


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
