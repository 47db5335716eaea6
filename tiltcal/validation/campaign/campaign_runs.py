"""The runs of a campaign as tasks, and what is recorded of each."""

import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

from tiltcal import __version__
from tiltcal.core.errors import TiltcalError
from tiltcal.core.read_back import Finite, Stored, checked
from tiltcal.core.tasks.outcome import Limits, Outcome
from tiltcal.core.tasks.run_tasks import Task
from tiltcal.laboratory.laboratory import Laboratory
from tiltcal.laboratory.scenario import Scenario, fresh, parse_scenario
from tiltcal.validation.campaign.campaign_file import Campaign, hash_of
from tiltcal.validation.campaign.factors import Document
from tiltcal.validation.campaign.points import Point, points_of
from tiltcal.validation.run_files import row_of
from tiltcal.validation.runs import Row, laboratory_of, run_seed

RECORDS = "the runs of `tiltcal campaign`"
KEPT = 4096
JUDGING = ("accept", "expect", "runs")  # keys of a method that change no run


@dataclass(frozen=True)
class PointRun:
    """One seed at one point.

    Args:
        replicate: number of the seed at this point.
        key: of its content.
    """

    point: Point
    replicate: int
    seed: int
    key: str


@dataclass(frozen=True)
class Recorded:
    """What the journal has of a run: a row a method, or why it has none.

    Args:
        fault: time, memory or ended, where its process had to go.
        seconds: of the whole run.
    """

    rows: tuple[Row, ...]
    fault: str | None
    seconds: float


class StoredRecord(Stored):
    """A run in the journal."""

    rows: list[dict[str, Any]]
    fault: str | None
    seconds: Finite


def runs_of(campaign: Campaign) -> Iterator[PointRun]:
    """All runs in order: seeds, and keys for the journal, follow from their content alone."""
    count = campaign.table.runs
    for point in points_of(campaign):
        content = content_of(point.document)
        for k in range(count):
            seed = campaign.seed + point.noise * count + k
            yield PointRun(point, k, seed, hash_of([content, seed]))


def content_of(document: Document) -> str:
    """Hash of what determines the runs of a scenario: all but its seed and how it is judged."""
    methods = [
        {key: v for key, v in m.items() if key not in JUDGING} for m in document.get("method", ())
    ]
    bare = {k: v for k, v in document.items() if k not in ("seed", "about")}
    return hash_of([__version__, bare | {"method": methods}])


def task_of(run: PointRun, make_laboratory: Callable[[], Laboratory]) -> Task:
    """A run as a task.

    Args:
        run: point and seed.
        make_laboratory: a function at the top of a module.
    """
    text = json.dumps(run.point.document, default=str)
    return Task(run.key, rows_of, (text, run.seed, make_laboratory))


def rows_of(
    document: str, seed: int, make_laboratory: Callable[[], Laboratory]
) -> list[dict[str, Any]]:
    """One run of each method of a scenario, as plain values.

    Raises:
        TiltcalError: the scenario is wrong or cannot be recorded.
    """
    scenario = fresh(_scenario(document), seed=seed)
    result = run_seed(scenario, laboratory_of(make_laboratory), 0)
    return [asdict(run.row) for run in result.runs if run is not None]


@lru_cache(maxsize=4)
def _scenario(document: str) -> Scenario:
    return parse_scenario(json.loads(document))


def record_text(run: PointRun, outcome: Outcome, limits: Limits) -> str:
    """The record of a run for the journal."""
    text = outcome.failure(limits)
    rows = outcome.value if text is None else [_failed(run, m, text) for m in _titles(run)]
    return json.dumps({"rows": rows, "fault": outcome.fault, "seconds": outcome.seconds})


@lru_cache(maxsize=KEPT)
def recorded_of(text: str) -> Recorded:
    """Content of a record of the journal; the last ones are kept, as results are read several
    times.

    Raises:
        TiltcalError: it is no record of this version.
    """
    try:
        found = checked(StoredRecord, json.loads(text), "journal", RECORDS)
        rows = tuple(row_of(row) for row in found.rows)
    except ValueError as error:
        raise TiltcalError(
            "journal",
            found=str(error).splitlines()[0],
            need=RECORDS,
            do="remove it, so that all runs are made again",
        ) from error
    return Recorded(rows, found.fault, found.seconds)


def _titles(run: PointRun) -> list[str]:
    methods = run.point.document.get("method", ())
    return [str(m.get("name") or " ".join(m.get("command", ()))) for m in methods]


def _failed(run: PointRun, method: str, text: str) -> dict[str, Any]:
    name = str(run.point.document.get("name", "scenario"))
    return asdict(Row(name, method, run.seed, error=text))
