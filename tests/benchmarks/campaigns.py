"""What a campaign costs beside its runs, and what a million and a milliard of runs would take.

Ratios are of one session: the campaign and the same runs by hand with `concurrent.futures`, each a
program of its own, in turn; costs of an engine are of tasks that do nothing.
"""

import json
import operator
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path

from tests.benchmarks import children_s, sized
from tiltcal.api.simulating import simulator
from tiltcal.core.tasks.engines import open_engine
from tiltcal.core.tasks.journal import open_journal
from tiltcal.core.tasks.outcome import Limits, Outcome
from tiltcal.core.tasks.run_tasks import Task, make_all
from tiltcal.validation.campaign.campaign_file import CampaignTable, campaign_of
from tiltcal.validation.campaign.campaign_runs import rows_of, runs_of, task_of
from tiltcal.validation.run_files import table_of

SCENARIO = Path(__file__).parents[2] / "scenarios" / "six_faces_dual.toml"
RUNS = sized(1000, 4)
LIGHT = sized(3000, 100)
JOBS = 2
YEAR_H = 8766


def main() -> None:
    """Print the costs and the projection."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        used = [children_s()]
        before = _by_hand_apart()
        used.append(children_s())
        wall, seconds, disk, journal = _campaign(folder)
        used.append(children_s())
        by_hand = (before + _by_hand_apart()) / 2
        used.append(children_s())
        print(f"  by hand with concurrent.futures, before and after: {by_hand:.1f} s; ", end="")
        print(f"the campaign takes {wall / by_hand:.2f} of it, ", end="")
        hand, own, again = (b - a for a, b in pairwise(used))
        print(f"and {2 * own / (hand + again):.2f} of its processor time")
        _resume(folder)
        costs = {engine: _light(engine, folder) for engine in ("processes", "dask")}
    _projection(seconds, disk + journal, costs)


def _command(folder: Path, *words: str) -> tuple[float, str]:
    command = [sys.executable, "-m", "tiltcal", "campaign", str(folder / "c.toml")]
    start = time.perf_counter()
    done = subprocess.run(
        [*command, "-o", str(folder / "out"), "-j", f"{JOBS}", *words],
        capture_output=True,
        text=True,
        check=True,
    )
    return time.perf_counter() - start, done.stdout


def _campaign(folder: Path) -> tuple[float, float, float, float]:
    """Seconds of the command and of a run, and bytes a run in the results and in the journal."""
    (folder / "c.toml").write_text(f'schema = 1\nscenario = "{SCENARIO}"\nruns = {RUNS}\n')
    wall, said = _command(folder, "--json")
    each = json.loads(said)["seconds_of_runs"] / RUNS
    print(f"campaign of {RUNS} runs of {SCENARIO.stem}, {JOBS} processes")
    print(f"  whole command: {wall:.1f} s; a run: {1e3 * each:.1f} ms")
    print(f"  parallel efficiency (seconds of runs over {JOBS} x wall): ", end="")
    print(f"{RUNS * each / (JOBS * wall):.1%}")
    sizes = [
        (folder / "out" / f"results.{x}").stat().st_size / RUNS for x in ("parquet", "journal")
    ]
    print(f"  bytes a run: {sizes[0]:.0f} in the results, {sizes[1]:.0f} in the journal")
    return wall, each, *sizes


def _by_hand_apart() -> float:
    """Seconds of a program that makes the same runs by hand."""
    program = "from tests.benchmarks.campaigns import by_hand; by_hand()"
    start = time.perf_counter()
    subprocess.run([sys.executable, "-c", program], cwd=Path(__file__).parents[2], check=True)
    return time.perf_counter() - start


def by_hand() -> None:
    """The same runs and a table of their rows, without journal, limits and report."""
    table = CampaignTable.model_validate({"schema": 1, "scenario": str(SCENARIO), "runs": RUNS})
    calls = [task_of(run, simulator).arguments for run in runs_of(campaign_of(table, SCENARIO))]
    with ProcessPoolExecutor(JOBS, mp_context=get_context("spawn")) as executor:
        rows = list(executor.map(_rows, calls))
    table_of([row for found in rows for row in found])


def _rows(call: tuple[str, int, Callable[[], object]]) -> list[dict[str, object]]:
    found = rows_of(*call)
    for row in found:
        row.pop("parameters")
    return found


def _resume(folder: Path) -> None:
    wall, _ = _command(folder)
    print(f"  the finished campaign again: {wall:.2f} s")


def _light(engine: str, folder: Path) -> tuple[float, float]:
    """Milliseconds a task that does nothing: of wall time, and of the main process."""
    tasks = [Task(f"{k}", operator.neg, (k,)) for k in range(LIGHT)]
    with open_engine(engine, JOBS) as opened, open_journal(folder / f"{engine}.journal") as journal:
        make_all(tasks[:50], LIGHT, journal, opened, Limits(), _record)  # the processes have begun
        start, before = time.perf_counter(), time.process_time()
        make_all(tasks, LIGHT, journal, opened, Limits(), _record)
        wall, own = time.perf_counter() - start, time.process_time() - before
    count = LIGHT - 50
    print(f"  a task that does nothing, engine {engine}: ", end="")
    print(f"{1e3 * wall / count:.2f} ms, of these {1e3 * own / count:.2f} ms of the main process")
    return 1e3 * wall / count, 1e3 * own / count


def _record(task: Task, outcome: Outcome) -> str:
    return f"{task.key} {outcome.value}"


def _projection(seconds: float, each_bytes: float, costs: dict[str, tuple[float, float]]) -> None:
    """What many runs take, as these figures scale."""
    print("projection")
    print("  runs    core-hours   bytes      the main process alone, h")
    for runs in (1e6, 1e9):
        hours = runs * seconds / 3600
        alone = " ".join(f"{e} {runs * own / 3.6e6:.2g}" for e, (_, own) in costs.items())
        print(f"  {runs:.0e}   {hours:9.3g}   {runs * each_bytes:.2g}   {alone}")
    for engine, (_, own) in costs.items():
        workers = 1e3 * seconds / own
        print(f"  one main process feeds {workers:.0f} cores with such runs, engine {engine}")
