"""Runs that are kept while a folder of scenarios is verified, so that the same command after an
interruption makes only those that are missing.

Kept are plain numbers and texts, in a journal. A run of a method that is not built in is not kept:
changes of its code are not detectable.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tiltcal import __version__
from tiltcal.calibration.methods.registry import METHODS
from tiltcal.calibration.result import calibration_from
from tiltcal.core.errors import TiltcalError
from tiltcal.core.read_back import Finite, Stored, checked
from tiltcal.core.tasks.journal import Journal, open_journal
from tiltcal.laboratory.scenario import Scenario
from tiltcal.validation.accuracy import TiltError
from tiltcal.validation.campaign.campaign_file import hash_of
from tiltcal.validation.run_files import row_of
from tiltcal.validation.runs import Run, SeedResult

NAME = "verify.journal"


class StoredTilt(Stored):
    """The tilt error of a run."""

    before: Finite
    after: Finite
    bound: Finite
    over: str
    dof: Finite


class StoredRun(Stored):
    """A run of one method."""

    row: dict[str, Any]
    calibration: dict[str, Any] | None
    tilt: StoredTilt | None


class StoredSeed(Stored):
    """All methods on the recording of one seed."""

    seed: int
    runs: list[StoredRun | None]


class KeptRuns:
    """The runs in a journal; ``kept_runs`` makes one."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal

    def result(self, scenario: Scenario, k: int) -> SeedResult | None:
        """Run k of a scenario, without its recording; None where it is not kept.

        Raises:
            TiltcalError: the record is damaged.
        """
        text = self._journal.record_of(_key(scenario, k)) if _keepable(scenario) else None
        if text is None:
            return None
        subject = f"journal {self._journal.path}"
        try:
            found = checked(StoredSeed, json.loads(text), subject, "the runs of `tiltcal verify`")
            runs = tuple(None if r is None else _run(r) for r in found.runs)
        except ValueError as error:
            raise TiltcalError(
                subject,
                found=str(error).splitlines()[0],
                need="the runs of `tiltcal verify`",
                do="remove it, so that all runs are made again",
            ) from error
        return SeedResult(found.seed, runs)

    def keep(self, scenario: Scenario, k: int, result: SeedResult) -> None:
        """Write run k of a scenario."""
        if _keepable(scenario):
            runs = [None if run is None else _stored(run) for run in result.runs]
            text = json.dumps({"seed": result.seed, "runs": runs})
            self._journal.record(_key(scenario, k), text)


@contextmanager
def kept_runs(folder: Path | None) -> Iterator[KeptRuns | None]:
    """The runs kept in a folder. They go when the block ends well, and with them the journal; it
    stays where the block ends with an error and runs are kept. None without a folder.

    Raises:
        TiltcalError: the folder cannot be written.
    """
    if folder is None:
        yield None
        return
    path = folder / NAME
    needed = True
    try:
        with open_journal(path) as journal:
            try:
                yield KeptRuns(journal)
                needed = False
            finally:
                needed = needed and len(journal) > 0
    finally:
        for ending in () if needed else ("", "-wal", "-shm"):
            path.with_name(NAME + ending).unlink(missing_ok=True)


def _keepable(scenario: Scenario) -> bool:
    return all(m.name in METHODS for m in scenario.method)


def _key(scenario: Scenario, k: int) -> str:
    """Of everything that decides a run."""
    return hash_of([__version__, scenario.model_dump(mode="json", by_alias=True), k])


def _stored(run: Run) -> dict[str, Any]:
    return {
        "row": asdict(run.row),
        "calibration": None if run.calibration is None else run.calibration.to_json(),
        "tilt": None if run.tilt is None else asdict(run.tilt),
    }


def _run(stored: StoredRun) -> Run:
    t = stored.tilt
    return Run(
        row_of(stored.row),
        None if stored.calibration is None else calibration_from(stored.calibration),
        None if t is None else TiltError(t.before, t.after, t.bound, t.over, t.dof),
    )
