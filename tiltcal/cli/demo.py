"""``tiltcal demo``: the main job on built-in scenarios, ending with a table and the report's path."""

import argparse
import sys
import time
from pathlib import Path

from tiltcal.assets import folder
from tiltcal.cli.judging import finish
from tiltcal.cli.laboratory import simulator
from tiltcal.cli.output import progress_line
from tiltcal.files import make_folder
from tiltcal.scenario import load_scenario
from tiltcal.verify import Verification, run_scenario

SHOWN = (
    "six_faces_dual",
    "six_faces_hidden_K2",
    "norm_by_hand",
    "norm_six_random_positions",
    "two_position_level",
    "tumble_three_axis",
)


def demo(args: argparse.Namespace) -> int:
    """Simulate, calibrate and verify."""
    out = make_folder(Path(args.output))
    start = time.perf_counter()
    print("Simulating tables in MuJoCo, calibrating, judging against what was injected.\n", file=sys.stderr)
    with progress_line() as progress:
        laboratory = simulator(progress)
        results = []
        for name in SHOWN:
            scenario = load_scenario(folder("scenarios") / f"{name}.toml")
            results.append(run_scenario(scenario, laboratory, source=f"{name}.toml", progress=progress))
    args.output = str(out)
    return finish(Verification(tuple(results), time.perf_counter() - start), args)
