"""``tiltcal demo``."""

import json
import secrets
import sys
import time
from contextlib import redirect_stdout
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tomli_w
from cyclopts import Parameter

from tiltcal.api.simulating import simulator
from tiltcal.cli.demo_case import bench, concealed, ordinary
from tiltcal.cli.diagnose import diagnose
from tiltcal.cli.options import SEED, Json
from tiltcal.cli.output import paragraph, print_table, progress_line, say, tell
from tiltcal.cli.verify import finish
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


def demo(
    *,
    seed: Annotated[
        int | None, SEED, Parameter(help="Seed of the concealed effect; random if not given.")
    ] = None,
    output: Annotated[Path, Parameter(alias="-o", help="Folder for the reports.")] = Path(
        "demo-output"
    ),
    as_json: Json = False,
) -> int:
    """Run a tour of the main functions.

    Simulates, calibrates and verifies built-in scenarios. Then conceals an effect
    in a simulated recording and diagnoses it. The effect is random; the seed is
    printed, and --seed repeats it.
    """
    out = make_folder(output)
    used = secrets.randbelow(10**6) if seed is None else seed
    verification = tour()
    found = find(out, used)
    status = finish(verification, out, as_json)
    if not as_json:
        show(found, out, used)
    return status


def tour() -> Verification:
    """Run built-in scenarios and judge them against the injected errors."""
    start = time.perf_counter()
    tell("Simulating tables in MuJoCo, calibrating, judging against the injected errors.\n")
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
    """Conceal an effect and diagnose without the truth; return the concealed table and
    diagnosis.json.

    The scenario with the truth is written after the diagnosis.
    """
    tell(f"Concealing an effect in a simulated recording (seed {seed}), then diagnosing it.\n")
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
    with redirect_stdout(sys.stderr):  # stdout is for the tables
        diagnose((place / "recording.csv",), scenario=place / "scenario.toml", output=place)
    write_text(out / "concealed.toml", tomli_w.dumps(truth))
    return hidden, json.loads((place / "diagnosis.json").read_text(encoding="utf-8"))


def show(found: tuple[dict[str, Any], dict[str, Any]], out: Path, seed: int) -> None:
    """Print what was concealed and what was found."""
    hidden, answer = found
    sizes = {k: v for k, v in hidden.items() if isinstance(v, float)}
    rows = [["concealed", hidden["id"], _sizes(sizes)]]
    for f in answer["findings"]:
        estimates = ", ".join(
            f"{n} = {p['value']:.4g} +- {p['sigma']:.2g}" for n, p in f["parameters"].items()
        )
        rows.append(
            ["found", " or ".join(f["class"] or ["a curve of no listed effect"]), estimates]
        )
    print_table(
        ["", "effect", "size"],
        rows,
        title=f"An effect concealed at random (--seed {seed} repeats it)",
    )
    before, after = answer["fit"]["before"], answer["fit"]["after"]
    names = {
        "chi2_per_dof": "chi-square per degree of freedom",
        "heldout_chi2_per_dof": "chi-square per degree of freedom, held-out blocks",
    }
    print_table(
        ["fit", "before", "after"],
        [[words, _figure(before[k]), _figure(after[k])] for k, words in names.items()],
    )
    paragraph(f"{answer['verdict']}: {answer['statement']}")
    say(f"report of the diagnosis: {out / 'diagnosis' / 'report.html'}")


def _figure(value: float | None) -> str:
    return "not tested" if value is None else f"{value:.4g}"


def _sizes(sizes: dict[str, float]) -> str:
    return ", ".join(f"{name} = {value:.4g}" for name, value in sizes.items())
