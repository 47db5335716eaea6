"""``tiltcal prove``: blind trials. Their generator and judge share nothing with the product: a
program of its own.
"""

import argparse
import os
import subprocess
import sys
from pathlib import Path

from tiltcal.core.assets import beside
from tiltcal.core.errors import TiltcalError


def prove(args: argparse.Namespace) -> int:
    """Conceal physics, diagnose copies of what an honest user has, judge, print the table.

    Raises:
        TiltcalError: the trials are not there: they come with the source, not with an installed
            package.
    """
    trials = Path(args.trials) if args.trials else beside("tests")
    if trials is None or not (trials / "blind" / "__main__.py").is_file():
        raise TiltcalError(
            "blind trials",
            found=f"no folder blind in {trials or 'any tests folder beside the package'}",
            need="the folder tests/blind of the source",
            do="run in a source checkout, or name its tests folder with --trials",
        )
    command = [
        sys.executable,
        "-m",
        "blind",
        "--n",
        str(args.n),
        "--seed",
        str(args.seed),
        "--jobs",
        str(args.jobs),
    ]
    for word, value in (
        ("--kinds", args.kinds),
        ("--types", args.types),
        ("--output", args.output),
    ):
        if value:
            command += [word, *([value] if isinstance(value, str) else value)]
    command += ["--json"] if args.json else []
    try:
        return subprocess.run(
            command, env=os.environ | {"PYTHONPATH": str(trials)}, check=False
        ).returncode
    except KeyboardInterrupt:  # the trials have said where to go on
        return 130
