"""Exported integers on a Cortex-M0: the stated error, bytes of flash and stack, and cycles.

Cycles are those of the worst of some readings, by the instructions that an emulator traces.
"""

import re
import sys
import tempfile
from pathlib import Path

import numpy as np

from tests.benchmarks import sized


def main() -> None:
    """A line for each list of terms."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    from cortex_m0 import COMPILER, EMULATOR, missing
    from test_firmware import MANY, case_of, comment_of, rng_of, with_terms

    if missing(COMPILER):
        print(missing(COMPILER))
        return
    rng = np.random.default_rng(1)
    for name, (sensor, names) in MANY.items():
        with tempfile.TemporaryDirectory() as folder:
            found = with_terms(sensor, names, rng_of(f"many points {name}"))
            case = case_of(found, sensor, Path(folder))
            (error,) = re.findall(r"worst error of f.*: (.*)", comment_of(case))
            sizes = case.target().sizes()
            words = f"flash {sizes['flash']} bytes, stack {sizes['stack']} bytes"
            rows = rng.integers(-(2**30), 2**30, (sized(20, 2), len(case.inputs)))
            cycles = ""
            if not missing(EMULATOR):
                cycles = f", {case.target().run(rows, len(case.outputs))[1]} cycles"
        print(f"{name}: error {error}, {words}{cycles}")
