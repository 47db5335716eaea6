"""Run the benchmarks: all, or the named ones. TILTCAL_BENCH=smoke makes each as small as it can be.

python -m tests.benchmarks [NAME ...]
"""

import importlib
import sys

ROOMS = (
    "simulation",
    "reading",
    "formats",
    "instrument",
    "guiding",
    "app",
    "information",
    "own_model",
    "placing",
    "firmware",
    "designing",
    "efficiency",
    "accuracy",
    "draws",
    "allan",
    "investigating",
    "campaigns",
    "long_recordings",
    "reports",
    "diagnosing",
    "trials",
)


def main(names: list[str]) -> None:
    for name in names or ROOMS:
        importlib.import_module(f"tests.benchmarks.{name}").main()


if __name__ == "__main__":
    main(sys.argv[1:])
