"""Blind trials of `diagnose`: the frozen set of 200 cases, with how often stated probabilities are
right. BLIND_N=100 runs a hundred of each type with a fresh seed instead, which takes hours.
"""

import os
import secrets
import subprocess
import sys
from pathlib import Path

from tests.benchmarks import SMOKE

TESTS = Path(__file__).parents[1]


def main() -> None:
    """Print the score table and the reliability of the probabilities."""
    command = [sys.executable, "-m", "blind", "--jobs", str(os.cpu_count() or 1)]
    if SMOKE:
        command += ["--n", "1", "--kinds", "six_faces", "--types", "null"]
    elif n := os.environ.get("BLIND_N"):
        seed = str(secrets.randbelow(2**31))
        print(f"blind trials, {n} of each type, seed {seed}", flush=True)
        command += ["--n", n, "--seed", seed]
    else:
        command += ["--benchmark"]
    subprocess.run(command, env=os.environ | {"PYTHONPATH": str(TESTS)}, check=False)
