"""The loop of `investigate` against concealed tables: how often it ends explained and right. LOOP_N
makes it longer or shorter.
"""

import os
import secrets
import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).parents[1]


def main() -> None:
    """Print the rates."""
    seed, n = secrets.randbelow(2**31), os.environ.get("LOOP_N", "15")
    print(f"investigations, {n} of each kind, seed {seed}", flush=True)
    command = [sys.executable, "-m", "blind.loop", "--n", n, "--seed", str(seed)]
    subprocess.run(command, env=os.environ | {"PYTHONPATH": str(TESTS)}, check=False)
