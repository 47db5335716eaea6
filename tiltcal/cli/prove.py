"""``tiltcal prove``: blind trials. Their generator and judge are a separate program that shares no
code with this one.
"""

import os
import subprocess
import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tiltcal.cli.options import SEED, SEVERAL, WHOLE, Json
from tiltcal.cli.signals import INTERRUPTED, Terminated
from tiltcal.core.assets import beside
from tiltcal.core.errors import TiltcalError


def prove(
    *,
    n: Annotated[int, WHOLE, Parameter(help="Trials of each type.")] = 5,
    kinds: Annotated[
        tuple[str, ...], SEVERAL, Parameter(help="Kinds of set-up; all seven by default.")
    ] = (),
    types: Annotated[
        tuple[str, ...],
        SEVERAL,
        Parameter(help="null single odd data pair triple unlisted impossible; all by default."),
    ] = (),
    authors: Annotated[
        tuple[str, ...],
        SEVERAL,
        Parameter(help="first second: who invented unlisted physics and nulls; both by default."),
    ] = (),
    benchmark: Annotated[
        bool,
        Parameter(
            negative=(),
            help="The frozen set of 200 cases; --n --kinds --types --authors --seed do not count.",
        ),
    ] = False,
    diagnoser: Annotated[
        str | None,
        Parameter(help="Command that is judged; this program by default. See the guide."),
    ] = None,
    seed: Annotated[int, SEED, Parameter(help="Seed of the trials.")] = 0,
    jobs: Annotated[int, WHOLE, Parameter(alias="-j", help="Trials at the same time.")] = 1,
    shard: Annotated[
        str,
        Parameter(help="i/n: only every n-th trial; all shards share the folder of -o."),
    ] = "1/1",
    trials: Annotated[
        Path | None,
        Parameter(help="Folder that contains blind/; tests of this checkout by default."),
    ] = None,
    output: Annotated[
        Path | None,
        Parameter(alias="-o", help="Folder for cases, answers and truth; temporary if not given."),
    ] = None,
    as_json: Json = False,
) -> int:
    """Run blind trials of `diagnose` and report its success rates.

    A separate generator (closed form, no code of this program) conceals physics
    in recordings of seven kinds of set-up. The diagnosis gets copies of the
    recording and the scenario. The truth is written after the answer. Needs a
    source checkout. Finished trials in the folder of -o are not run again: many
    machines make shards in one folder, and a last call without --shard scores all.

      tiltcal prove --n 30 -j 4 -o proof
      tiltcal prove --n 100 --types null unlisted --kinds dual_tumble three_rates
      tiltcal prove --benchmark --diagnoser 'python mine.py' -o mine

    Exit status 1: a success rate is too low to be explained by chance.
    """
    tests = trials or beside("tests")
    if tests is None or not (tests / "blind" / "__main__.py").is_file():
        raise TiltcalError(
            "blind trials",
            found=f"no folder blind in {tests or 'any tests folder beside the package'}",
            need="the folder tests/blind of the source",
            do="run in a source checkout, or name its tests folder with --trials",
        )
    command = [sys.executable, "-P", "-m", "blind", "--n", f"{n}", "--seed", f"{seed}"]
    command += ["--jobs", f"{jobs}", "--shard", shard]
    command += ["--kinds", *kinds] if kinds else []
    command += ["--types", *types] if types else []
    command += ["--authors", *authors] if authors else []
    command += ["--benchmark"] if benchmark else []
    command += ["--diagnoser", diagnoser] if diagnoser else []
    command += ["--output", str(output)] if output else []
    command += ["--json"] if as_json else []
    environment = os.environ | {"PYTHONPATH": str(tests)}
    try:
        return subprocess.run(command, env=environment, check=False).returncode
    except Terminated:
        raise
    except KeyboardInterrupt:  # the trials have printed how to continue
        return INTERRUPTED
