"""The loop, judged: cases that a poor first recording leaves ambiguous, investigated with the
concealed table behind a command.

``python -m blind.loop --n 10 --command tiltcal -o DIR`` with this folder's parent on the path.
"""

import json
import os
import secrets
import shlex
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from blind.judge import TWINS
from blind.lab import KINDS, write_case
from blind.motion import Plan
from blind.rotations import DEG
from blind.spread import Count, Parser, Spread, command, in_processes, shard
from blind.table import wilson
from blind.trial import _run

Plain = dict[str, Any]
# as the blocks are recorded: the yardstick is not made longer than they are
DWELL_S, RATE_DEG_S = (
    3.0,
    30.0,
)


def scheme_minutes(kind: str) -> float:
    """Table time of a 24-position scheme, twice."""
    faces = [(0, 0), (180, 0), (90, 0), (90, 180), (90, 90), (90, 270)]
    poses = faces * 4 if kind == "dual_tumble" else [(15.0 * k,) for k in range(24)]
    plan = Plan([0.0] * len(poses[0]))
    for pose in poses * 2:
        plan.go({k: x * DEG for k, x in enumerate(pose)}, RATE_DEG_S * DEG)
        plan.dwell(DWELL_S)
    return plan.clock_s / 60


def run_case(
    folder: Path, kind: str, seed: int, k: int, command: Sequence[str], limit_s: float
) -> Plain:
    """One investigation, or its result where it is finished."""
    place = folder / f"{kind}-{k:03d}"
    done = place / "result.json"
    if done.exists():
        return json.loads(done.read_text(encoding="utf-8"))
    case = write_case(place, kind, [seed, k])
    python = f"{shlex.quote(sys.executable)} -m blind.lab {shlex.quote(str(place / 'case.json'))}"
    lab = f"env PYTHONPATH={shlex.quote(str(Path(__file__).parents[1]))} {python}"
    start = time.perf_counter()
    words = [
        *command,
        "investigate",
        str(place / "first.csv"),
        "--scenario",
        str(place / "scenario.toml"),
    ]
    status, said = _run([*words, "--lab", lab, "-o", str(place / "out")], limit_s)
    result = {
        "kind": kind,
        "truth": case.hidden.spec.id,
        "lambda": case.hidden.found.lam,
        "status": status,
        "said": said,
    }
    result |= {"rivals": case.hidden.found.inseparable, "seconds": time.perf_counter() - start}
    result |= judged(place / "out", case.hidden.spec.id)
    result["quick"] = result["minutes"] < scheme_minutes(kind)
    part = place / "result.part"
    part.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    part.rename(done)
    return result


def judged(out: Path, truth: str) -> Plain:
    """What the investigation's files say, against the truth."""
    answers = [
        json.loads(p.read_text(encoding="utf-8"))
        for p in sorted(out.glob("diagnosis_*/diagnosis.json"))
    ]
    right = {truth}.union(*(t for t in TWINS if truth in t))
    last = answers[-1] if answers else {"verdict": None, "findings": []}
    state, verdicts = out / "investigation.json", [a["verdict"] for a in answers]
    told = json.loads(state.read_text(encoding="utf-8")) if state.exists() else {}
    return {
        "verdicts": verdicts,
        "forecasts": forecasts(verdicts, told.get("blocks", [])),
        "classes": [[f["class"] for f in a["findings"]] for a in answers],
        "ambiguous": bool(answers) and answers[0]["verdict"] == "ambiguous",
        "held": bool(answers) and any(right & set(f["class"]) for f in answers[0]["findings"]),
        "explained": last["verdict"] == "explained",
        "right": bool(last["findings"]) and all(f["effect"] in right for f in last["findings"]),
        "minutes": told.get("table_minutes", 0.0),
    }


def forecasts(verdicts: Sequence[str], blocks: Sequence[Plain]) -> list[tuple[float, bool]]:
    """Of each block that was to separate something: the probability that the verdict then is
    `explained`, and whether it was.
    """
    steps = zip(blocks, verdicts, verdicts[1:], strict=False)
    return [(b["confidence"], v == "explained") for b, was, v in steps if was == "ambiguous"]


def show(results: Sequence[Plain]) -> str:
    """Rates with their 95 % intervals."""
    asked = [r for r in results if r["ambiguous"]]
    silent = [r for r in results if not r["verdicts"]]
    lines = [f"{len(results)} cases, {len(asked)} ambiguous at first"]
    for name, hits, required in (
        (
            "explained and right within two blocks",
            [r["explained"] and r["right"] for r in asked],
            ">= 90 %",
        ),
        ("explained, but wrong", [r["explained"] and not r["right"] for r in asked], ""),
        ("in less table time than 24 positions twice", [r["quick"] for r in asked], ""),
        ("truth in the first class", [r["held"] for r in asked], ""),
        ("no answer at all", [not r["verdicts"] for r in results], "<= 0 %"),
    ):
        k, n = sum(hits), len(hits)
        low, high = wilson(k, n) if n else (0.0, 1.0)
        lines.append(
            f"{name:45s} {k:4d}/{n:<4d} {100 * k / max(n, 1):5.1f} %  {100 * low:5.1f} .."
            f" {100 * high:5.1f} %  {required}"
        )
    if asked:
        lines.append(
            "table time of the blocks (median)            "
            f" {np.median([r['minutes'] for r in asked]):.1f} min"
        )
        lines.append(
            "24 positions twice                           "
            f" {', '.join(f'{k} {scheme_minutes(k):.1f} min' for k in KINDS)}"
        )
    told = np.array([f for r in results for f in r["forecasts"]], float).reshape(-1, 2)
    if len(told):
        stated, came = told.mean(axis=0)
        brier = float(np.mean((told[:, 0] - told[:, 1]) ** 2))
        lines.append(
            f"blocks that were to end in explained         stated {100 * stated:.0f} %,"
            f" came true {100 * came:.0f} % of {len(told)}, Brier score {brier:.2f}"
        )
    for r in asked:
        if not (r["explained"] and r["right"]):
            lines.append(
                f"  {r['kind']} {r['truth']} ({r['lambda']:.0f}): {r['verdicts']}"
                f" {r['classes'][-1]} {r['said']}"
            )
    lines += [f"  {r['kind']} {r['truth']}: exit {r['status']}: {r['said']}" for r in silent]
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None, spread: Spread | None = None) -> int:
    """Run and print. Exit status 1: an investigation gave no answer at all.

    Args:
        spread: makes the investigations, in any order; by default in processes of this machine.
    """
    args = _parser().parse_args(arguments)
    seed = secrets.randbelow(2**31) if args.seed is None else args.seed
    folder = Path(args.output or tempfile.mkdtemp(prefix="blind-loop-"))
    print(f"seed {seed}, files in {folder}", file=sys.stderr, flush=True)
    first, step = args.shard
    calls = [
        (folder, kind, seed, k, args.command, args.time_limit)
        for k in range(args.n)
        for kind in args.kinds
    ][first - 1 :: step]
    results, count = [], Count(len(calls))
    try:
        for r in (spread or in_processes(args.jobs))(run_case, calls):
            results.append(r)
            print(
                f"{count.after_one()} {r['kind']} {r['truth']}: {r['verdicts']}"
                f" {r['minutes']:.1f} min",
                file=sys.stderr,
                flush=True,
            )
    except KeyboardInterrupt:
        print(
            f"interrupted after {len(results)} of {len(calls)}; run again with --seed {seed}"
            f" -o {folder} to go on",
            file=sys.stderr,
        )
        raise
    results.sort(key=lambda r: (r["kind"], r["truth"]))
    print(json.dumps(results, indent=1) if args.json else show(results))
    return int(any(not r["verdicts"] for r in results))


def _parser() -> Parser:
    parser = Parser(prog="blind.loop", description=__doc__)
    parser.add_argument("--n", type=int, default=5, help="cases of each kind")
    parser.add_argument("--seed", type=int, default=None)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("-j", "--jobs", type=int, default=os.cpu_count() or 1)
    python = f"{shlex.quote(sys.executable)} -m tiltcal"
    parser.add_argument("--command", type=command, default=python)
    parser.add_argument("--time-limit", type=float, default=1800.0)
    parser.add_argument("--shard", type=shard, default=(1, 1))
    parser.add_argument("-o", "--output")
    parser.add_argument("--json", action="store_true")
    return parser


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
