"""The large proof: blind trials of `diagnose`, a hundred of each type, with a fresh seed. Takes
hours; BLIND_N makes it shorter.
"""

import os
import secrets
import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).parents[1]


def main() -> None:
    """Print the score table."""
    seed, n = secrets.randbelow(2**31), os.environ.get("BLIND_N", "100")
    print(f"blind trials, {n} of each type, seed {seed}", flush=True)
    command = [
        sys.executable,
        "-m",
        "blind",
        "--n",
        n,
        "--seed",
        str(seed),
        "--jobs",
        str(os.cpu_count() or 1),
    ]
    subprocess.run(command, env=os.environ | {"PYTHONPATH": str(TESTS)}, check=False)
