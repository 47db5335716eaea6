"""``tiltcal prove``: blind trials. Their generator and judge are a separate program that shares no
code with this one.
"""

import importlib
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from tiltcal.cli.options import SEED, SEVERAL, WHOLE, EngineName, Jobs, Json, between
from tiltcal.core.assets import checkout_folder
from tiltcal.core.errors import TiltcalError
from tiltcal.core.tasks.engines import ADDRESS, open_engine
from tiltcal.core.tasks.run_tasks import values_as_made


def prove(
    *,
    n: Annotated[
        int, WHOLE, Parameter(help="Trials of each type.", validator=between(1, 100_000))
    ] = 5,
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
    investigate: Annotated[
        bool,
        Parameter(
            negative=(),
            help="Trials of `tiltcal investigate` from poor first recordings.",
        ),
    ] = False,
    diagnoser: Annotated[
        str | None,
        Parameter(help="Command that is judged; this program by default. See the guide."),
    ] = None,
    seed: Annotated[int, SEED, Parameter(help="Seed of the trials.")] = 0,
    jobs: Jobs = 1,
    engine: EngineName = "processes",
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
      tiltcal prove --investigate --n 15 -j 4 -o loop

    With --engine dask://HOST:PORT the workers need the folder of -o, and the tests
    folder on their PYTHONPATH.

    Exit status 1: a success rate is too low to be explained by chance.
    """
    tests = _tests_folder(trials)
    if engine.startswith(ADDRESS) and output is None:
        raise TiltcalError(
            "command line of `tiltcal prove`",
            found=f"--engine {engine} and no -o",
            need="a folder that all workers share",
            do="add -o",
        )
    arguments = ["--n", f"{n}", "--seed", f"{seed}", "--shard", shard]
    arguments += ["--kinds", *kinds] if kinds else []
    arguments += ["--output", str(output.absolute())] if output else []
    arguments += ["--json"] if as_json else []
    if investigate:
        _refuse_besides({"--types": types, "--authors": authors, "--benchmark": benchmark})
        arguments += [f"--command={diagnoser}"] if diagnoser is not None else []
        return _run("blind.loop", arguments, tests, engine, jobs)
    arguments += ["--types", *types] if types else []
    arguments += ["--authors", *authors] if authors else []
    arguments += ["--benchmark"] if benchmark else []
    arguments += [f"--diagnoser={diagnoser}"] if diagnoser is not None else []
    return _run("blind.__main__", arguments, tests, engine, jobs)


def _tests_folder(trials: Path | None) -> Path:
    """The folder with the program of the trials.

    Raises:
        TiltcalError: there is none.
    """
    tests = trials or checkout_folder("tests")
    if tests is None or not (tests / "blind" / "__main__.py").is_file():
        raise TiltcalError(
            "blind trials",
            found=f"no folder blind in {tests}" if tests else "an installation without them",
            need="the folder tests/blind of a source checkout",
            do="run `make setup` and .venv/bin/tiltcal there, or add --trials CHECKOUT/tests",
        )
    return tests.absolute()


def _refuse_besides(options: dict[str, Any]) -> None:
    given = [name for name, value in options.items() if value]
    if given:
        raise TiltcalError(
            "command line of `tiltcal prove`",
            found=f"--investigate and {given[0]}",
            need="one of them",
            do="leave one out",
        )


def _run(module: str, arguments: Sequence[str], tests: Path, engine: str, jobs: int) -> int:
    """Run a program of the trials, its calls spread over an engine; the exit status.

    Raises:
        TiltcalError: the program does not know an option's value.
    """
    with _importable(tests), open_engine(engine, jobs) as opened:
        program: Any = importlib.import_module(module)

        def spread(function: Any, calls: Sequence[tuple[Any, ...]]) -> Iterator[Any]:
            return values_as_made(function, calls, opened)

        try:
            status: int = program.main(arguments, spread)
        except SystemExit as error:  # of its argument parser, with the cause
            raise TiltcalError(
                "command line of `tiltcal prove`",
                found=f"{error.code}",
                need="values that the blind trials know",
                do="`tiltcal prove --help` explains them",
            ) from error
        return status


@contextmanager
def _importable(folder: Path) -> Iterator[None]:
    """Modules of a folder can be imported, here and in processes that are started."""
    path, before = sys.path[:], os.environ.get("PYTHONPATH")
    sys.path.insert(0, str(folder))
    os.environ["PYTHONPATH"] = os.pathsep.join([str(folder), *([before] if before else [])])
    try:
        yield
    finally:
        sys.path[:] = path
        if before is None:
            del os.environ["PYTHONPATH"]
        else:
            os.environ["PYTHONPATH"] = before
