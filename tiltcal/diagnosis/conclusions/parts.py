"""The parts of a finding: every effect that the amended scenario holds because of it.

The amended scenario: the scenario with its calibration and findings.
"""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.conclusions.finding import FindingPart
from tiltcal.diagnosis.conclusions.one_recording import place_of
from tiltcal.diagnosis.conclusions.statements import learned_name, shown, stage_of
from tiltcal.diagnosis.conclusions.whole_law import WholeLaw
from tiltcal.diagnosis.data.observations import Observations
from tiltcal.diagnosis.data_faults.fault import Fault
from tiltcal.diagnosis.model.fitted_model import FittedModel, FittedTerm
from tiltcal.effects import CATALOGUE, Effect, to_file
from tiltcal.effects.learned import Learned
from tiltcal.effects.parameter import by_name
from tiltcal.laboratory.scenario import Scenario

SHOWN = 0.05  # share of a signal's energy that a channel has to hold to be named
PLACE = ("id", "on", "place", "role", "sensor", "axis", "seen_in")  # keys that are no curve's own


def parts_of(
    fitted: FittedModel, places: Sequence[int], law: WholeLaw, observations: Observations
) -> tuple[FindingPart, ...]:
    """The parts of a finding, the leading one first.

    Args:
        fitted: the model.
        places: of the finding's terms.
        law: its terms together.
        observations: whose channels.
    """
    return tuple(
        _part(
            fitted.terms[k],
            fitted.sigmas(k),
            strongest(signal, observations)[1],
            share,
            place_of([fitted.terms[k].effect], observations.recordings),
        )
        for k, signal, share in zip(places, law.signals, law.shares, strict=True)
    )


def part_of(fault: Fault) -> FindingPart:
    """A fault of the data as the only part of its finding."""
    effect = fault.effect
    return FindingPart(
        effect.id,
        CATALOGUE[effect.id].title,
        effect.stage,
        effect.sensor,
        effect.axis,
        fault.axes,
        _values(effect, fault.sigma),
    )


def fitted_as(parts: Sequence[FindingPart]) -> str:
    """The parts of a finding in words, those of one description together; empty for a single
    part.
    """
    if len(parts) < 2:
        return ""
    shares: dict[str, list[float]] = {}
    apart = len({part.recording for part in parts}) > 1
    for part in parts:
        shares.setdefault(_said(part, apart), []).append(part.energy_share)
    words = [
        f"{f'{len(s)} curves, each ' if len(s) > 1 else ''}{name} ({round(100 * sum(s))} %)"
        for name, s in shares.items()
        if round(100 * sum(s))
    ]
    if less := sum(len(s) for s in shares.values() if not round(100 * sum(s))):
        words.append(f"{less} of less than 1 %")
    return f" It was fitted in {len(parts)} parts (share of its signal): {'; '.join(words)}."


def strongest(
    signal: Sequence[Array], observations: Observations
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Sensors and axes that hold a signal, given by channel, the strongest first. signal: whitened,
    (n,) each.
    """
    energy: dict[tuple[str, str], float] = {}
    for channel, part in zip(observations.channels, signal, strict=True):
        key = channel.sensor, channel.axis
        energy[key] = energy.get(key, 0.0) + float(part @ part)
    total = max(sum(energy.values()), 1e-300)
    ordered = sorted(energy.items(), key=lambda item: -item[1])
    strong = [key for key, e in ordered if e > SHOWN * total]
    return tuple(dict.fromkeys(s for s, _ in strong)), tuple(dict.fromkeys(a for _, a in strong))


def _part(
    term: FittedTerm, sigmas: Array, axes: tuple[str, ...], share: float, recording: str | None
) -> FindingPart:
    effect = term.effect
    curve: dict[str, Any] = {}
    if isinstance(effect, Learned):
        words = learned_name(effect)
        curve = {k: v for k, v in to_file(effect).items() if k not in PLACE}
    else:
        words = CATALOGUE[effect.id].title
    fitted = dict(zip(term.names, np.asarray(sigmas).tolist(), strict=True))
    return FindingPart(
        effect.id,
        words,
        stage_of(effect),
        effect.sensor,
        effect.axis,
        axes,
        {} if curve else _values(effect, fitted),
        curve,
        share,
        recording,
    )


def _values(effect: Effect, sigmas: dict[str, float]) -> dict[str, tuple[float, float | None]]:
    """All values of an effect by name with unit, as the amended scenario has them; sigmas: of those
    that were fitted, SI.
    """
    known = by_name(effect.parameters)
    return {
        f"{name}{known[name].suffix}": (
            value / known[name].factor,
            sigmas[name] / known[name].factor if name in sigmas else None,
        )
        for name, value in effect.values.items()
    }


def _said(part: FindingPart, apart: bool) -> str:
    """A part in words, with its sizes where it has names for them; apart: with its recording."""
    place = f" {part.recording}" if apart and part.recording else ""
    if part.curve:
        return f"{part.description}{place}"
    sizes = {n: (v, s) for n, (v, s) in part.parameters.items() if s is not None}
    return f"{part.effect}{place} with {shown(sizes)}"


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
