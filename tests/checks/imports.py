"""Import every module of both packages: with the oldest dependencies that are allowed, a name that
they do not have yet shows here.

    python -m tests.checks.imports

Exit status: 0 all are imported; 1 one is not.
"""

import importlib
import pkgutil
import sys
from collections.abc import Iterator

import tiltcal
import tiltsim


def modules() -> Iterator[str]:
    """The names of all modules, those that are programs left out."""
    for package in (tiltcal, tiltsim):
        for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if not found.name.endswith("__main__"):
                yield found.name


def main() -> int:
    """Print what cannot be imported, a line each, and return the exit status."""
    failed = 0
    for name in modules():
        try:
            importlib.import_module(name)
        except Exception as error:  # noqa: BLE001  whatever it is, it is reported
            print(f"{name}: {type(error).__name__}: {error}")
            failed += 1
    print(f"imports: {failed} modules failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
