"""Compare what two commits answer: every number to a relative tolerance, every word apart from the
prose exactly.

    python -m tests.benchmarks.compare_commits BASE HEAD [-j 2] [--recordings DIR] [--tolerance
    1e-9] [--only TEXT]

The inputs are the same for both: 60 blind cases of a fixed seed, the cases below DIR (folders with
`recording.csv` and `scenario.toml`), and every scenario of BASE. Each commit is built as a wheel
into a folder of its own and run from there. Answers are kept below `build/compare`, so that an
interrupted comparison goes on where it stopped. HEAD may be `.`, the working tree: then nothing is
kept for the next call.

Exit status: 0 the same; 1 something differs; 2 the command line is wrong.
"""

import argparse
import csv
import io
import json
import math
import os
import shutil
import subprocess
import sys
import tarfile
import tomllib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
KEPT = ROOT / "build" / "compare"
BLIND_CASES, BLIND_SEED = 60, 2026
PROSE = {
    "about",
    "equation",
    "frames",
    "inverse",
    "next_measurement",
    "notes",
    "provenance",
    "recordings",
    "seconds",
    "statement",
    "warnings",
}
LIMIT_S = 1200.0


@dataclass(frozen=True)
class Case:
    """One thing to ask of a commit: a recording to diagnose, or a scenario to simulate and
    calibrate.
    """

    name: str
    scenario: Path
    recording: Path | None = None


@dataclass(frozen=True)
class Difference:
    """One place where two answers differ."""

    case: str
    place: str
    before: Any
    after: Any

    def __str__(self) -> str:
        before, after = (repr(x)[:80] for x in (self.before, self.after))
        return f"{self.place}: {before} -> {after}"


def blind_cases(folder: Path) -> list[Case]:
    """The blind cases; their files are written once."""
    sys.path.insert(0, str(ROOT / "tests"))
    import numpy as np
    from blind.cases import KINDS, TYPES, make
    from blind.files import write_recording, write_scenario
    from blind.plans import plan

    cases = []
    for job in plan(9)[:BLIND_CASES]:
        place = folder / f"{job.kind}-{job.type_}-{job.author}-{job.k}"
        if not (place / "scenario.toml").exists():
            place.mkdir(parents=True, exist_ok=True)
            key = [BLIND_SEED, KINDS.index(job.kind), TYPES.index(job.type_), job.k]
            case = make(job.kind, job.type_, 1 if job.k % 2 == 0 else 4, key, job.author)
            write_recording(
                place / "recording.csv", case.lab, case.rows, np.random.default_rng(key)
            )
            write_scenario(place / "scenario.toml", case.lab)
        cases.append(Case(f"blind/{place.name}", place / "scenario.toml", place / "recording.csv"))
    return cases


def recorded_cases(folder: Path) -> list[Case]:
    """Recordings of somebody else."""
    found = sorted(folder.glob("*/recording.csv"))
    return [Case(f"recorded/{p.parent.name}", p.with_name("scenario.toml"), p) for p in found]


def scenario_cases(site: Path) -> list[Case]:
    """Every scenario that a build brings with it."""
    return [
        Case(f"scenario/{p.stem}", p)
        for p in sorted((site / "tiltcal" / "scenarios").glob("*.toml"))
    ]


def build(commit: str, folder: Path) -> Path:
    """Install one commit, without its dependencies, into a folder; returns that folder."""
    site = folder / "site"
    if commit == "." and folder.exists():
        shutil.rmtree(folder)
    if not site.exists():
        source = ROOT
        if commit != ".":
            source = folder / "source"
            archive = subprocess.run(
                ["git", "archive", commit], cwd=ROOT, check=True, stdout=subprocess.PIPE
            )
            with tarfile.open(fileobj=io.BytesIO(archive.stdout)) as files:
                files.extractall(source, filter="data")
        pip = [
            sys.executable,
            "-m",
            "pip",
            "install",
            "--quiet",
            "--no-deps",
            "--no-build-isolation",
        ]
        subprocess.run([*pip, "--target", str(site), str(source)], check=True)
    return site


def answer(case: Case, site: Path, folder: Path) -> dict[str, Any]:
    """What the commit in ``site`` answers; kept in ``folder``."""
    place = folder / case.name
    kept = place / "answer.json"
    if not kept.exists():
        place.mkdir(parents=True, exist_ok=True)
        found = _diagnosis(case, site, place) if case.recording else _claims(case, site, place)
        part = kept.with_suffix(".part")
        part.write_text(json.dumps(found, default=str), encoding="utf-8")
        part.rename(kept)
    return json.loads(kept.read_text(encoding="utf-8"))


def _run(site: Path, place: Path, *words: str) -> int:
    threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    result = subprocess.run(
        [sys.executable, "-m", "tiltcal", *words],
        cwd=place,
        env=os.environ | threads | {"PYTHONPATH": str(site)},
        timeout=LIMIT_S,
        stdout=(place / "stdout.txt").open("w"),
        stderr=(place / "stderr.txt").open("w"),
        check=False,
    )
    return result.returncode


def _diagnosis(case: Case, site: Path, place: Path) -> dict[str, Any]:
    status = _run(
        site, place, "diagnose", str(case.recording), "--scenario", str(case.scenario), "-o", "out"
    )
    if status:
        return {"status": status, "stderr": (place / "stderr.txt").read_text(encoding="utf-8")}
    amended = tomllib.loads((place / "out" / "amended.toml").read_text(encoding="utf-8"))
    return {
        "diagnosis": json.loads((place / "out" / "diagnosis.json").read_text(encoding="utf-8")),
        "amended": amended,
    }


def _claims(case: Case, site: Path, place: Path) -> dict[str, Any]:
    out: dict[str, Any] = {
        "simulate": _run(site, place, "simulate", str(case.scenario), "-o", "run.csv")
    }
    if out["simulate"] == 0:
        out["recording"] = _columns(place / "run.csv")
    scenario = tomllib.loads(case.scenario.read_text(encoding="utf-8"))
    for method in dict.fromkeys(m["name"] for m in scenario.get("method", []) if "name" in m):
        words = (
            "run.csv",
            "--scenario",
            str(case.scenario),
            "--method",
            method,
            "-o",
            f"{method}.json",
        )
        out[f"calibrate {method}"] = _run(site, place, "calibrate", *words)
        if (place / f"{method}.json").exists():
            out[method] = json.loads((place / f"{method}.json").read_text(encoding="utf-8"))
    out["run"] = _run(site, place, "run", str(case.scenario), "--json")
    if out["run"] != 2:
        out["judged"] = json.loads((place / "stdout.txt").read_text(encoding="utf-8"))
    return out


def _columns(path: Path) -> dict[str, Any]:
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(line for line in file if not line.startswith("#")))
    columns: dict[str, Any] = {}
    for name, *cells in zip(*rows, strict=True):
        columns[name] = cells if name == "label" else [float(x) if x else None for x in cells]
    return columns


def differences(
    before: Any, after: Any, tolerance: float, place: str = ""
) -> Iterator[tuple[str, Any, Any]]:
    """(place, before, after) of everything that is not the same."""
    if isinstance(before, dict) and isinstance(after, dict):
        for key in before.keys() | after.keys():
            if key not in PROSE:
                yield from differences(before.get(key), after.get(key), tolerance, f"{place}/{key}")
    elif isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        scale = max(
            (abs(x) for x in before if isinstance(x, float) and math.isfinite(x)), default=0.0
        )
        for k, (b, a) in enumerate(zip(before, after, strict=True)):
            if not (
                isinstance(b, float) and isinstance(a, float) and abs(b - a) <= tolerance * scale
            ):
                yield from differences(b, a, tolerance, f"{place}/{k}")
    elif isinstance(before, float) and isinstance(after, float | int):
        if not math.isclose(before, after, rel_tol=tolerance, abs_tol=1e-12) and not (
            math.isnan(before) and math.isnan(after)
        ):
            yield place, before, after
    elif before != after:
        yield place, before, after


def compare(args: argparse.Namespace) -> list[Difference]:
    """All differences, shown as they are found."""
    sites = {c: build(c, KEPT / _folder(c)) for c in (args.base, args.head)}
    cases = blind_cases(KEPT / "inputs")
    if args.recordings:
        cases += recorded_cases(args.recordings.resolve())
    cases = [c for c in cases + scenario_cases(sites[args.base]) if args.only in c.name]
    found: list[Difference] = []

    def both(case: Case) -> tuple[Case, list[Difference]]:
        before, after = (
            answer(case, sites[c], KEPT / _folder(c) / "answers") for c in (args.base, args.head)
        )
        return case, [Difference(case.name, *d) for d in differences(before, after, args.tolerance)]

    with ThreadPoolExecutor(args.jobs) as pool:
        for n, (case, own) in enumerate(pool.map(both, cases), 1):
            found += own
            print(
                f"{n}/{len(cases)} {case.name}: {len(own) or 'no'} differences",
                file=sys.stderr,
                flush=True,
            )
            for d in own[:6]:
                print(f"    {d}", flush=True)
    same = len(cases) - len({d.case for d in found})
    print(f"{same} of {len(cases)} answers are the same to {args.tolerance:g}")
    return found


def _folder(commit: str) -> str:
    if commit == ".":
        return "working-tree"
    return subprocess.run(
        ["git", "rev-parse", "--short=12", commit],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    ).stdout.strip()


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("base")
    parser.add_argument("head")
    parser.add_argument("-j", "--jobs", type=int, default=1)
    parser.add_argument(
        "--recordings", type=Path, help="folder of cases, each with recording.csv and scenario.toml"
    )
    parser.add_argument("--tolerance", type=float, default=1e-9)
    parser.add_argument("--only", default="", help="cases whose name holds this text")
    return 1 if compare(parser.parse_args()) else 0


if __name__ == "__main__":
    sys.exit(main())
