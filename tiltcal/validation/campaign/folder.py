"""The folder of a campaign: its runs and its results."""

import json
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import claimed, make_folder, write_json
from tiltcal.core.progress import Progress
from tiltcal.core.read_back import Stored, checked, read_json
from tiltcal.core.tasks.engines import Engine
from tiltcal.core.tasks.journal import Journal, open_journal
from tiltcal.core.tasks.outcome import Limits, Outcome
from tiltcal.core.tasks.run_tasks import Task, make_all
from tiltcal.laboratory.laboratory import Laboratory
from tiltcal.validation.campaign.campaign_file import Campaign, CampaignTable, hash_of
from tiltcal.validation.campaign.campaign_runs import (
    PointRun,
    record_text,
    recorded_of,
    runs_of,
    task_of,
)
from tiltcal.validation.campaign.points import count_of

RESULTS = "results.parquet"
ENDINGS = (
    *(".journal", ".journal-wal", ".journal-shm", ".campaign.json", ".summary.json"),
    *(".html", ".parquet"),
)
EXPECTED = "a campaign.json as `tiltcal campaign` writes it"


class StoredCampaign(Stored):
    """What is kept of a campaign next to its journal."""

    campaign: dict[str, Any]
    scenario: dict[str, Any]


@dataclass(frozen=True)
class CampaignFiles:
    """Files of a campaign: a folder, or for a file ``x.parquet`` the files ``x.*`` next to it."""

    results: Path

    @classmethod
    def of(cls, output: Path) -> "CampaignFiles":
        """By what ``-o`` names; the folder is created.

        Raises:
            TiltcalError: it cannot be made.
        """
        if output.suffix == ".parquet":
            make_folder(output.parent)
            return cls(output)
        return cls(make_folder(output) / RESULTS)

    def sibling(self, suffix: str) -> Path:
        """Another file of the campaign."""
        return self.results.with_suffix(suffix)

    def claimed(self) -> AbstractContextManager[None]:
        """The folder held for one run; files next to those of other campaigns are held by their
        journal alone.
        """
        return claimed(self.results.parent if self.results.name == RESULTS else None)

    @contextmanager
    def whole_or_not_at_all(self) -> Iterator[None]:
        """Where nothing was before, an error leaves nothing."""
        made = [p for ending in ENDINGS if not (p := self.sibling(ending)).exists()]
        done = self.sibling(".journal") not in made
        try:
            yield
            done = True
        finally:
            for path in () if done else made:
                path.unlink(missing_ok=True)

    @contextmanager
    def journal(self) -> Iterator[Journal]:
        """The journal, made if there is none."""
        with open_journal(self.sibling(".journal")) as journal:
            yield journal


_SHARD = re.compile("[0-9]{1,9}/[0-9]{1,9}")


@dataclass(frozen=True)
class Shard:
    """Every ``count``-th run, from the ``number``-th on, which counts from 1."""

    number: int = 1
    count: int = 1

    @classmethod
    def of(cls, text: str) -> "Shard":
        """From ``i/n``.

        Raises:
            TiltcalError: it is no part of a whole.
        """
        number, _, count = text.partition("/")
        whole = _SHARD.fullmatch(text) is not None
        if not (whole and 1 <= int(number) <= int(count)):
            raise TiltcalError(
                "option --shard",
                found=text,
                need="i/n with i from 1 to n",
                do="write --shard 1/4 for the first of four",
            )
        return cls(int(number), int(count))

    def runs(self, campaign: Campaign) -> Iterator[PointRun]:
        """The runs of a campaign that belong to it."""
        return islice(runs_of(campaign), self.number - 1, None, self.count)

    def total(self, campaign: Campaign) -> int:
        """How many these are."""
        return len(range(self.number - 1, count_of(campaign) * campaign.table.runs, self.count))


def make_runs(
    campaign: Campaign,
    shard: Shard,
    journal: Journal,
    engine: Engine,
    limits: Limits,
    make_laboratory: Callable[[], Laboratory],
    progress: Progress,
    meanwhile: Callable[[], None] | None = None,
) -> int:
    """Make all runs of a shard that the journal does not have; how many these were.

    Args:
        campaign: whose runs they are.
        shard: the part of it.
        journal: of what is finished.
        engine: where they are made.
        limits: of time and memory of each.
        make_laboratory: called once in each process; a function at the top of a module.
        progress: receives the rate and the time left.
        meanwhile: called in another thread when the first run is handed out.

    Raises:
        TiltcalError: the engine lost runs, or there is no disk space for the journal.
    """
    by_key: dict[str, PointRun] = {}

    def tasks() -> Iterator[Task]:
        for run in shard.runs(campaign):
            by_key[run.key] = run
            yield task_of(run, make_laboratory)

    def recorded(task: Task, outcome: Outcome) -> str:
        return record_text(by_key.pop(task.key), outcome, limits)

    total = shard.total(campaign)
    return make_all(tasks(), total, journal, engine, limits, recorded, progress, meanwhile)


def forget_faults(campaign: Campaign, journal: Journal) -> None:
    """Take runs out of the journal whose process had to go, so that they are made again."""
    for run in runs_of(campaign):
        text = journal.record_of(run.key)
        if text is not None and recorded_of(text).fault:
            journal.forget(run.key)


def write_campaign(campaign: Campaign, files: CampaignFiles) -> None:
    """Keep a campaign with its scenario next to its journal, for ``read_campaign``."""
    table = campaign.table.model_dump(mode="json", by_alias=True, exclude_none=True)
    document = json.loads(json.dumps(campaign.document, default=str))
    write_json(files.sibling(".campaign.json"), {"campaign": table, "scenario": document})


def read_campaign(files: CampaignFiles) -> Campaign:
    """The campaign whose runs are there.

    Raises:
        TiltcalError: there is none.
    """
    path = files.sibling(".campaign.json")
    subject = f"campaign {path.name}"
    table = read_json(path, "campaign", EXPECTED)
    found = checked(StoredCampaign, table, subject, EXPECTED)
    return Campaign(checked(CampaignTable, found.campaign, subject, EXPECTED), found.scenario)


def merge_shards(folders: Sequence[CampaignFiles], into: CampaignFiles) -> Campaign:
    """Merge the runs of several folders, made as shards, into one; return their campaign.

    Raises:
        TiltcalError: they are of different campaigns.
    """
    campaigns = [read_campaign(folder) for folder in folders]
    hashes = [hash_of([c.table.model_dump(mode="json"), c.document]) for c in campaigns]
    for folder, one in zip(folders, hashes, strict=True):
        if one != hashes[0]:
            raise TiltcalError(
                f"results {folder.results}",
                found="another campaign",
                need=f"that of {folders[0].results}",
                do="merge shards of one campaign",
            )
    write_campaign(campaigns[0], into)
    with into.journal() as journal:
        for folder in folders:
            with folder.journal() as other:
                journal.take_over(other)
    return campaigns[0]
