"""The schemas of diagnosis.json and investigation.json, as they are read back."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from tiltcal.core.read_back import Finite, Stored, checked, read_json
from tiltcal.diagnosis.investigation.progress_log import Entry, Investigation

DIAGNOSIS = "a diagnosis.json as `tiltcal diagnose -o` writes it"
INVESTIGATION = "an investigation.json as `tiltcal investigate` writes it"
FileName = Annotated[str, Field(pattern=r"^[^/\\\x00]+$", max_length=255)]
Verdict = Literal["match", "explained", "ambiguous", "unlisted", "cannot_tell"]


class StoredFinding(Stored):
    """A finding: what decides what to record next."""

    effect: str | None
    class_: Annotated[list[str], Field(alias="class")]
    next_measurement: str = ""

    @model_validator(mode="after")
    def _in_its_class(self) -> "StoredFinding":
        if self.effect is not None and self.class_ and self.effect not in self.class_:
            raise ValueError("a class that its effect is in")
        return self


class StoredUndetectable(Stored):
    """An effect that was not found, and the sizes it would have been found at."""

    effect: str
    detectable_size: dict[str, Finite] = {}


class StoredDiagnosis(Stored):
    """diagnosis.json."""

    verdict: Verdict
    statement: str = ""
    findings: list[StoredFinding]
    recordings: list[str] = []
    undetectable: list[StoredUndetectable] = []


class StoredBlock(Stored):
    """A block that was recorded, in files of the same folder."""

    block: str
    words: str
    minutes: Annotated[float, Field(ge=0)]
    confidence: Finite
    sequence: FileName
    recording: FileName


class StoredInvestigation(Stored):
    """investigation.json."""

    given: list[str]
    verdicts: list[Verdict]
    blocks: list[StoredBlock]
    statement: str


def read_diagnosis(path: Path) -> dict[str, Any]:
    """The table of diagnosis.json.

    Raises:
        TiltcalError: naming the first key that does not fit.
    """
    table = read_json(path, "diagnosis", DIAGNOSIS)
    checked(StoredDiagnosis, table, f"diagnosis {path.name}", DIAGNOSIS)
    return table | {"recordings": table.get("recordings", [])}


def read_investigation(path: Path) -> Investigation:
    """How far an investigation is.

    Raises:
        TiltcalError: naming the first key that does not fit.
    """
    table = read_json(path, "investigation", INVESTIGATION)
    found = checked(StoredInvestigation, table, f"investigation {path.name}", INVESTIGATION)
    entries = tuple(
        Entry(b.block, b.words, b.minutes, b.confidence, b.sequence, b.recording)
        for b in found.blocks
    )
    return Investigation(tuple(found.given), entries, tuple(found.verdicts), found.statement)
