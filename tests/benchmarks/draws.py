"""The tests that measure variances, NEES and coverage against the Cramer-Rao bound, with all their
draws: the suite makes a tenth of them.
"""

import os
import subprocess
import sys

from tests.benchmarks import sized

TESTS = "all_draws_together or all_reversals_together or variance_nees_and_coverage"


def main() -> None:
    """Run them; a figure outside its band ends the benchmarks."""
    work = sized(["-n", "2"], ["--collect-only"])
    words = [sys.executable, "-m", "pytest", "-q", *work, "-k", TESTS]
    words += ["-m", "", "tests"]  # those that are marked long too
    subprocess.run(words, env={**os.environ, "TILTCAL_DRAWS": "full"}, check=True)
    print("variance, NEES and coverage of all draws lie in their bands")
