"""``tiltcal confuse``."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from tiltcal.cli.options import Grade, Json, ScenarioFile
from tiltcal.cli.output import paragraph, print_json, print_table
from tiltcal.core.numerical import determining
from tiltcal.design.identifiability import Confusion, ParameterVisibility, classes, tie_breaker
from tiltcal.design.identifiability import confuse as compare_effects
from tiltcal.laboratory.long_recordings import require_recordable
from tiltcal.laboratory.scenario import load_scenario

HEADER = ("parameter", "absorbed", "detectable", "plausible", "unique", "not separable from")
SHOWN_CLASSES = 12
SHOWN_ALTERNATIVES = 2


def confuse(
    scenario_file: ScenarioFile,
    /,
    *,
    grade: Annotated[
        Grade, Parameter(help="Instrument grade: sets the plausible sizes.")
    ] = "mid_mems",
    as_json: Json = False,
) -> int:
    """Show which effects a recording of a scenario can separate.

    For every effect of the catalogue: the share that the adjustable terms absorb,
    the smallest detectable size, the share that nothing else explains, the
    effects it cannot be separated from and what to record to separate them.
    """
    scenario = load_scenario(scenario_file)
    require_recordable(scenario)
    with determining(f"scenario {scenario.name}", "which effects it can separate"):
        found = compare_effects(scenario, grade)
    groups = classes(found)
    if as_json:
        print_json(to_json(found, groups, scenario.name, grade))
    else:
        _print(found, groups)
    return 0


def _print(found: Confusion, groups: Sequence[Sequence[str]]) -> None:
    sights = sorted(found.sights, key=lambda s: (s.column.effect, s.column.label))
    spare = ["plausible", "absorbed", "not separable from"]  # classes are stated below
    print_table(HEADER, [_row(s) for s in sights], spare=spare)
    paragraph(
        f"{found.visible} signatures are visible, {found.rank} of them independent, in"
        f" {found.samples:.0f} samples of each sensor"
    )
    for group in groups[:SHOWN_CLASSES]:
        paragraph(
            f"one class: {', '.join(group)}; to separate {group[0]} from {group[1]}:"
            f" {tie_breaker(group[0], group[1])}"
        )


def _row(s: ParameterVisibility) -> list[str]:
    alternatives = ", ".join(
        f"{label} {cosine:+.3f}" for label, cosine in s.alternatives[:SHOWN_ALTERNATIVES]
    )
    more = len(s.alternatives) - SHOWN_ALTERNATIVES
    return [
        s.column.label,
        f"{100 * s.absorbed:.1f} %",
        f"{s.detectable:.3g} {s.column.unit}" if np.isfinite(s.detectable) else "never",
        f"{s.column.size:g}",
        f"{s.unique:.2f}",
        alternatives + (f" and {more} more" if more > 0 else ""),
    ]


def to_json(
    found: Confusion, groups: Sequence[Sequence[str]], scenario: str, grade: Grade
) -> dict[str, object]:
    """All parameters with what they cannot be separated from."""
    return {
        "schema": 1,
        "scenario": scenario,
        "grade": grade,
        "rank": found.rank,
        "visible": found.visible,
        "classes": [list(group) for group in groups],
        "parameters": [_sight_json(s) for s in found.sights],
    }


def _sight_json(s: ParameterVisibility) -> dict[str, object]:
    return {
        "effect": s.column.effect,
        "sensor": s.column.sensor,
        "axis": s.column.axis,
        "parameter": f"{s.column.name}_{s.column.unit}",
        "plausible": s.column.size,
        "absorbed": s.absorbed,
        "detectable": s.detectable if np.isfinite(s.detectable) else None,
        "unique": s.unique,
        "rivals": [{"parameter": r, "cosine": c} for r, c in s.alternatives],
    }
