"""The loop of `investigate` against concealed tables: how often it ends explained and right. LOOP_N
makes it longer or shorter.
"""

import os
import secrets
import subprocess
import sys
from pathlib import Path

from tests.benchmarks import sized

TESTS = Path(__file__).parents[1]


def main() -> None:
    """Print the rates."""
    seed, n = secrets.randbelow(2**31), os.environ.get("LOOP_N", sized("15", "1"))
    print(f"investigations, {n} of each kind, seed {seed}", flush=True)
    command = [sys.executable, "-m", "blind.loop", "--n", n, "--seed", str(seed)]
    command += sized([], ["--kinds", "placing_sweep"])
    subprocess.run(command, env=os.environ | {"PYTHONPATH": str(TESTS)}, check=False)
