"""The campaign file: a scenario, what is varied in it, and how often it is run."""

import hashlib
import json
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, field_validator

from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import require_document
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.setup.part import StrictTable
from tiltcal.validation.campaign.factors import Document, Factor


class CampaignTable(StrictTable):
    """The keys of a campaign file."""

    schema_: Annotated[Literal[1], Field(alias="schema")]
    """Version of the file's keys."""
    scenario: str
    """Scenario file, as seen from the campaign file's folder."""
    name: str = "campaign"
    """Title, as results show it."""
    runs: Annotated[int, Field(ge=1)] = 1
    """Seeds at each point."""
    samples: Annotated[int, Field(ge=2)] = 64
    """Points of the distributions' design, a power of 2."""
    quantile: Annotated[float, Field(gt=0, lt=1)] = 0.95
    """Quantile of the tilt error in the summary."""
    factor: tuple[Factor, ...] = ()
    """What is varied."""

    @field_validator("samples")
    @classmethod
    def _power_of_2(cls, samples: int) -> int:
        if samples & (samples - 1):
            raise ValueError("give a power of 2")
        return samples

    @field_validator("factor")
    @classmethod
    def _distinct(cls, factors: tuple[Factor, ...]) -> tuple[Factor, ...]:
        titles = [f.title for f in factors]
        for title in titles:
            if titles.count(title) > 1:
                raise ValueError(f"two factors are named '{title}'")
        return factors


@dataclass(frozen=True)
class Campaign:
    """A campaign with its scenario as the file states it."""

    table: CampaignTable
    document: Document

    @property
    def grids(self) -> list[Factor]:
        """The factors with levels."""
        return [f for f in self.table.factor if not f.random]

    @property
    def distributions(self) -> list[Factor]:
        """The factors with a distribution."""
        return [f for f in self.table.factor if f.random]

    @property
    def seed(self) -> int:
        """Of the first run."""
        return int(self.document.get("seed", 0))


def load_campaign(path: Path) -> Campaign:
    """Read a campaign file and its scenario.

    Raises:
        TiltcalError: naming every wrong key of the campaign, or of the scenario.
    """
    table = _toml(require_document(path, "campaign"))
    try:
        campaign = CampaignTable.model_validate(table)
    except ValidationError as error:
        problems = [
            f"{'.'.join(str(part) for part in e['loc'])}: {e['msg'].removeprefix('Value error, ')}"
            for e in error.errors()
        ]
        raise TiltcalError(
            f"campaign {path.name}",
            found=f"{len(problems)} errors:\n  " + "\n  ".join(problems) + "\n",
            need="a valid campaign",
            do="see the page on campaigns",
        ) from error
    return campaign_of(campaign, path.parent / campaign.scenario)


def campaign_of(table: CampaignTable, scenario: Path) -> Campaign:
    """A campaign of a scenario file.

    Raises:
        TiltcalError: the scenario is wrong, or has no method.
    """
    if not load_scenario(scenario).method:
        raise TiltcalError(
            f"scenario {scenario.name}",
            found="no [[method]]",
            need="at least one to judge",
            do="add [[method]] name = 'six_position'",
        )
    return Campaign(table, _toml(scenario))


def hash_of(value: Any) -> str:
    """SHA-256 of plain values, the same in every process."""
    return hashlib.sha256(json.dumps(value, sort_keys=True, default=str).encode()).hexdigest()


def _toml(path: Path) -> Document:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise TiltcalError(
            f"campaign {path.name}", found=str(error), need="valid TOML", do="correct that line"
        ) from error
