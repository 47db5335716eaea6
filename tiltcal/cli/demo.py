"""``tiltcal demo``: the main job on built-in scenarios, then an effect concealed at random and
found.
"""

import argparse
import json
import secrets
import sys
import time
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from tiltcal.cli.conceal import bench, concealed, ordinary
from tiltcal.cli.diagnosing import diagnose
from tiltcal.cli.judging import finish
from tiltcal.cli.laboratory import simulator
from tiltcal.cli.output import print_table, progress_line
from tiltcal.core.assets import folder
from tiltcal.core.files import make_folder, write_text
from tiltcal.laboratory.scenario import load_scenario, parse_scenario
from tiltcal.recordings.recording_files import write_recording
from tiltcal.validation.acceptance import Verification, run_scenario

SHOWN = (
    "six_faces_dual",
    "six_faces_hidden_K2",
    "norm_by_hand",
    "norm_six_random_positions",
    "two_position_level",
    "tumble_three_axis",
)


def demo(args: argparse.Namespace) -> int:
    """Simulate, calibrate and verify; conceal and diagnose."""
    out = make_folder(Path(args.output))
    seed = secrets.randbelow(10**6) if args.seed is None else args.seed
    verification = tour()
    found = find(out, seed)
    args.output = str(out)
    status = finish(verification, args)
    if not args.json:
        show(found, out, seed)
    return status


def tour() -> Verification:
    """Built-in scenarios, judged against what was injected."""
    start = time.perf_counter()
    print(
        "Simulating tables in MuJoCo, calibrating, judging against what was injected.\n",
        file=sys.stderr,
    )
    with progress_line() as progress:
        laboratory = simulator(progress)
        results = []
        for name in SHOWN:
            scenario = load_scenario(folder("scenarios") / f"{name}.toml")
            results.append(
                run_scenario(scenario, laboratory, source=f"{name}.toml", progress=progress)
            )
    return Verification(tuple(results), time.perf_counter() - start)


def find(out: Path, seed: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """Conceal an effect, diagnose with what an honest user knows. Returns the concealed table and
    diagnosis.json.

    The scenario that holds the truth is written when the diagnosis is done.
    """
    import tomli_w

    print(
        f"Concealing an effect in a simulated recording (seed {seed}), then looking for it.\n",
        file=sys.stderr,
    )
    rng = np.random.default_rng(seed)
    hidden = concealed(rng)
    truth = {**bench(), "role": "concealed", "effect": [*ordinary(rng), hidden]}
    with progress_line() as progress:
        recording = simulator(progress).record(parse_scenario(truth, "concealed.toml"), seed)
    place = make_folder(out / "diagnosis")
    write_recording(recording, place / "recording.csv")
    write_text(
        place / "scenario.toml",
        tomli_w.dumps({k: v for k, v in bench().items() if k not in ("sequence", "climate")}),
    )
    words = argparse.Namespace(
        recording=[str(place / "recording.csv")],
        scenario=str(place / "scenario.toml"),
        static=None,
        check=False,
        output=str(place),
        json=False,
    )
    with redirect_stdout(sys.stderr):  # stdout is for the tables
        diagnose(words)
    write_text(out / "concealed.toml", tomli_w.dumps(truth))
    return hidden, json.loads((place / "diagnosis.json").read_text(encoding="utf-8"))


def show(found: tuple[dict[str, Any], dict[str, Any]], out: Path, seed: int) -> None:
    """What was concealed beside what was found."""
    hidden, answer = found
    sizes = {k: v for k, v in hidden.items() if isinstance(v, float)}
    rows = [["concealed", hidden["id"], _sizes(sizes)]]
    for f in answer["findings"]:
        told = ", ".join(
            f"{n} = {p['value']:.4g} +- {p['sigma']:.2g}" for n, p in f["parameters"].items()
        )
        rows.append(["found", " or ".join(f["class"] or ["a curve that no effect explains"]), told])
    print_table(
        ["", "effect", "size"],
        rows,
        title=f"An effect concealed at random (--seed {seed} repeats it)",
    )
    before, after = answer["fit"]["before"], answer["fit"]["after"]
    names = {
        "chi2_per_dof": "chi-square per degree of freedom",
        "heldout_chi2_per_dof": "the same on held-out blocks",
    }
    print_table(
        ["fit", "before", "after"],
        [[words, f"{before[k]:.4g}", f"{after[k]:.4g}"] for k, words in names.items()],
    )
    print(f"{answer['verdict']}: {answer['statement']}")
    print(f"report of the diagnosis: {out / 'diagnosis' / 'report.html'}")


def _sizes(sizes: dict[str, float]) -> str:
    return ", ".join(f"{name} = {value:.4g}" for name, value in sizes.items())
