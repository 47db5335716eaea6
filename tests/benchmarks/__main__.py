"""Run the benchmarks: all, or the named ones."""

import importlib
import sys

ROOMS = (
    "simulation",
    "reading",
    "formats",
    "instrument",
    "information",
    "own_model",
    "placing",
    "designing",
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


main(sys.argv[1:])
