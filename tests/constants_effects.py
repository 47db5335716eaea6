"""What changes where a number that decides is halved or doubled: kept in constants_effects.json,
from which docs/constants.md is made.

    python -m tests.constants_effects [-j 2]                      all that are not kept yet
    python -m tests.constants_effects --only candidates.COARSE    one of them, anew

Each number is varied in a copy of the product, before anything is derived from it, and the same
recordings of blind trials are diagnosed: the smallest of each type. About half a minute of
processor time a number.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from queue import SimpleQueue
from types import FrameType
from typing import Any

from tests.benchmarks.compare_commits import ROOT, Case, blind_cases
from tests.constants_page import EFFECTS, FACTORS, Number, known_effects, numbers

TYPES = ("null", "single", "data", "unlisted")
INPUTS = ROOT / "build" / "compare" / "inputs"
LIMIT_S = 300.0
UNUSED, FAILS = "unused", "fails"
SCALED = '''\
"""A number, or several in one, times a factor; whole ones stay whole."""
import numpy as np


def scaled(value, factor):
    if isinstance(value, dict):
        return {key: scaled(one, factor) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(scaled(one, factor) for one in value)
    if isinstance(value, bool | str | None):
        return value
    return round(factor * value) if isinstance(value, int) else factor * value
'''


def smallest_cases() -> list[Case]:
    """The smallest recording of each type."""
    cases = blind_cases(INPUTS)
    of_type = [[c for c in cases if f"-{one}-" in c.name] for one in TYPES]
    return [min(some, key=lambda c: c.recording.stat().st_size) for some in of_type]  # type: ignore[union-attr]


def told(case: Case, folder: Path) -> Any:
    """Verdict and classes of a diagnosis in this process, or how it failed."""
    from tiltcal.cli import main

    words = ["diagnose", str(case.recording), "--scenario", str(case.scenario)]
    status = main([*words, "-o", str(folder), "-q"])
    if status:
        return [FAILS, status]
    found = json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))
    return [found["verdict"], [f["class"] for f in found["findings"]]]


def answers(names_too: bool) -> dict[str, Any]:
    """What is told of each recording and, if asked for, the names of global variables by module
    that the diagnosis came to.
    """
    used: dict[str, set[str]] = {}

    def note(frame: FrameType, event: str, _: Any) -> None:
        if event == "call" and (module := frame.f_globals.get("__name__", "")).startswith(
            "tiltcal"
        ):
            used.setdefault(module, set()).update(frame.f_code.co_names)

    with tempfile.TemporaryDirectory() as folder:
        if names_too:
            sys.setprofile(note)
        found = [told(c, Path(folder) / str(k)) for k, c in enumerate(smallest_cases())]
        sys.setprofile(None)
    return {"told": found, "used": {module: sorted(names) for module, names in used.items()}}


@contextmanager
def site() -> Iterator[Path]:
    """A copy of the product that may be changed."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        shutil.copytree(ROOT / "tiltcal", place / "tiltcal")
        shutil.copytree(ROOT / "sim", place, dirs_exist_ok=True)
        (place / "scaled_number.py").write_text(SCALED, encoding="utf-8")
        yield place


@contextmanager
def varied(number: Number, factor: float, place: Path) -> Iterator[None]:
    """The number times a factor in that copy."""
    file = place / number.file.relative_to(ROOT)
    before = file.read_text(encoding="utf-8")
    lines = before.splitlines()
    added = [f"{name} = scaled({name}, {factor})" for name in number.names]
    lines[number.last : number.last] = ["from scaled_number import scaled", *added]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    try:
        yield
    finally:
        file.write_text(before, encoding="utf-8")


def answers_of(place: Path, *words: str) -> dict[str, Any] | None:
    """What the product there says; None where it fails."""
    env = os.environ | {
        "PYTHONPATH": f"{place}{os.pathsep}{ROOT}",
        "PYTHONDONTWRITEBYTECODE": "1",
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
    }
    command = [sys.executable, "-m", "tests.constants_effects", "--answer", *words]
    try:
        said = subprocess.run(
            command, env=env, cwd=place, capture_output=True, timeout=LIMIT_S, check=False
        )
    except subprocess.TimeoutExpired:
        return None
    return None if said.returncode else json.loads(said.stdout.splitlines()[-1])


def effect_of(number: Number, factor: float, base: dict[str, Any], place: Path) -> int | str:
    """How many recordings are told otherwise with a number times a factor."""
    if not came_to(number, base["used"]):
        return UNUSED
    with varied(number, factor, place):
        found = answers_of(place)
    if found is None:
        return FAILS
    return sum(a != b for a, b in zip(base["told"], found["told"], strict=True))


def came_to(number: Number, used: dict[str, list[str]]) -> bool:
    """Whether a function that ran names the number, or another number is derived from it."""
    source = number.file.read_text(encoding="utf-8").splitlines()
    outside = [
        line for line in source if line[:1].strip() and not line.startswith(("def", "class"))
    ]
    names = set(number.names)
    derived = any(name in line.partition("=")[2] for line in outside for name in names)
    return derived or any(names.intersection(found) for found in used.values())


def measure(only: str | None, jobs: int) -> None:
    """Measure all numbers that are not kept, or one, and keep what is found.

    Raises:
        SystemExit: no number has this name, or the product fails as it is.
    """
    kept = known_effects()
    wanted = [n for n in numbers() if n.name == only or (only is None and n.name not in kept)]
    if only is not None and not wanted:
        raise SystemExit(f"{only}: no such number; see docs/constants.md")
    smallest_cases()  # written before several processes ask for them
    sites = SimpleQueue[Path]()
    with site() as one, site() as two:
        base = answers_of(one, "--names")
        if base is None:
            raise SystemExit("the product fails on these recordings")
        for place in (one, two)[:jobs]:
            sites.put(place)

        def both(number: Number) -> tuple[Number, list[int | str]]:
            place = sites.get()
            found = [effect_of(number, factor, base, place) for factor in FACTORS]
            sites.put(place)
            return number, found

        with ThreadPoolExecutor(jobs) as pool:
            for k, (number, found) in enumerate(pool.map(both, wanted)):
                kept = known_effects() | {
                    number.name: {"value": number.value, "halved": found[0], "doubled": found[1]}
                }
                text = json.dumps(dict(sorted(kept.items())), indent=1)
                EFFECTS.write_text(text + "\n", encoding="utf-8")
                print(f"{k + 1} of {len(wanted)}: {number.name} {found}", flush=True)


def main() -> int:
    """Measure, or answer for one copy of the product."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default=None)
    parser.add_argument("-j", "--jobs", type=int, choices=(1, 2), default=1)
    parser.add_argument("--answer", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--names", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.answer:
        print(json.dumps(answers(given.names)))
    else:
        measure(given.only, given.jobs)
    return 0


if __name__ == "__main__":
    sys.exit(main())
