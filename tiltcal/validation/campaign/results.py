"""The results of a campaign: a row a run and method, with what it comes from.

Nothing in them depends on how the runs were made: the same campaign has the same bytes for any
number of workers, any engine, and after any interruption. Times are in the journal only.
"""

import json
import platform
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from typing import Any

from tiltcal import __version__
from tiltcal.core.files import replacing
from tiltcal.core.read_back import read_json
from tiltcal.core.tasks.journal import Journal
from tiltcal.validation.campaign.campaign_file import Campaign, hash_of
from tiltcal.validation.campaign.campaign_runs import PointRun, Recorded, recorded_of, runs_of
from tiltcal.validation.campaign.folder import CampaignFiles
from tiltcal.validation.run_files import names_of, record_of, schema_of

AT_ONCE = 10_000  # rows that are written together
LIBRARIES = ("numpy", "scipy", "mujoco")


@dataclass(frozen=True)
class Results:
    """The finished runs of a campaign, read from its journal in order."""

    campaign: Campaign
    journal: Journal

    def runs(self) -> Iterator[tuple[PointRun, Recorded]]:
        """Each finished run with what is recorded of it."""
        for run in runs_of(self.campaign):
            if (text := self.journal.record_of(run.key)) is not None:
                yield run, recorded_of(text)

    def records(self) -> Iterator[dict[str, Any]]:
        """A record a run and method, in order."""
        for run, recorded in self.runs():
            for row in recorded.rows:
                record = record_of(row)
                del record["seconds"]
                point = run.point
                yield {
                    "point": point.number,
                    **point.values,
                    "matrix": point.matrix or None,
                    "replicate": run.replicate,
                    **record,
                }


def provenance_of(campaign: Campaign) -> dict[str, Any]:
    """What results come from: campaign, hash of its scenario, versions."""
    return {
        "campaign": campaign.table.model_dump(mode="json", by_alias=True, exclude_none=True),
        "scenario_sha256": hash_of(campaign.document),
        "versions": {
            "tiltcal": __version__,
            "python": platform.python_version(),
            **{name: version(name) for name in LIBRARIES},
        },
    }


def known_summary(campaign: Campaign, folder: CampaignFiles) -> dict[str, Any] | None:
    """The summary that was written of the same campaign by the same versions, next to its results
    and its report; None where one of them is missing.
    """
    files = [folder.results, folder.sibling(".html"), summary := folder.sibling(".summary.json")]
    if not all(path.exists() for path in files):
        return None
    found = read_json(summary, "summary", "a summary.json as `tiltcal campaign` writes it")
    return found if found.get("provenance") == provenance_of(campaign) else None


def write_results(results: Results, path: Path) -> None:
    """Write all rows as Parquet, whole or not at all; its metadata ``tiltcal`` is the provenance.

    Raises:
        TiltcalError: the file cannot be written.
    """
    import pyarrow as pa
    from pyarrow import parquet

    text = [f.title for f in results.campaign.grids if not _numeric([v for v, _ in f.levels()])]
    schema = schema_of(names_of(results.records()), text)
    schema = schema.with_metadata({"tiltcal": json.dumps(provenance_of(results.campaign))})
    with replacing(path) as temporary, parquet.ParquetWriter(temporary, schema) as writer:
        records = results.records()
        while part := list(islice(records, AT_ONCE)):
            rows = [{k: str(v) if k in text else v for k, v in r.items()} for r in part]
            writer.write_table(pa.Table.from_pylist(rows, schema))


def _numeric(values: Sequence[Any]) -> bool:
    return all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)
