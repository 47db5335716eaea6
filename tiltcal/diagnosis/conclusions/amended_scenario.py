"""The amended scenario: the scenario with its calibration and findings."""

import json
from collections.abc import Sequence
from typing import Any

from tiltcal.effects import to_file
from tiltcal.effects.base import Effect
from tiltcal.laboratory.scenario import Scenario

AMENDED = ", amended"


def amended_table(
    scenario: Scenario, effects: Sequence[tuple[Effect, int | None]], reference: float | None
) -> dict[str, Any]:
    """A scenario's table with these effects in place of its own.

    Args:
        scenario: as it was.
        effects: all that the model holds, the scenario's own among them, each with the number of
            the finding it belongs to, from 1; None for what is no finding.
        reference: T0 of the first recording, degC.
    """
    stated = json.loads(
        scenario.model_dump_json(
            exclude_none=True, exclude_defaults=True, by_alias=True, exclude={"effect"}
        )
    )
    name = f"{scenario.name.removesuffix(AMENDED)}{AMENDED}"
    table = {"schema": 1, "name": name} | {
        k: v for k, v in stated.items() if k not in ("schema", "name")
    }
    if reference is not None:
        table["climate"] = {**table.get("climate", {}), "reference_degC": reference}
    table["effect"] = [
        to_file(e) if number is None else _numbered(to_file(e), number) for e, number in effects
    ]
    return table


def _numbered(table: dict[str, Any], finding: int) -> dict[str, Any]:
    """An effect's table with the number of its finding after the id."""
    return {"id": table["id"], "finding": finding} | {k: v for k, v in table.items() if k != "id"}
