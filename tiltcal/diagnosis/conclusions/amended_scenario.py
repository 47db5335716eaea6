"""The amended scenario: the scenario with its calibration and findings."""

import json
from collections.abc import Sequence
from typing import Any

from tiltcal.effects import to_file
from tiltcal.effects.base import Effect
from tiltcal.laboratory.scenario import Scenario


def amended_table(
    scenario: Scenario, effects: Sequence[Effect], reference: float | None
) -> dict[str, Any]:
    """A scenario's table with these effects in place of its own.

    Args:
        scenario: as it was.
        effects: all that the model holds, the scenario's own among them.
        reference: T0 of the first recording, degC.
    """
    stated = json.loads(
        scenario.model_dump_json(
            exclude_none=True, exclude_defaults=True, by_alias=True, exclude={"effect"}
        )
    )
    table = {"schema": 1, "name": f"{scenario.name}, amended"} | {
        k: v for k, v in stated.items() if k not in ("schema", "name")
    }
    if reference is not None:
        table["climate"] = {**table.get("climate", {}), "reference_degC": reference}
    table["effect"] = [to_file(e) for e in effects]
    return table
