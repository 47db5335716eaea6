"""``tiltcal noise``."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from tiltcal.cli.options import DEFAULT_BUDGET, Json, MoreBudget
from tiltcal.cli.output import paragraph, print_json, print_line, print_table, progress_line
from tiltcal.core.units import COLUMN_UNITS, DEG, DEG_H, G0, Unit, split_unit
from tiltcal.effects import Effect
from tiltcal.effects.sensor.noise import AccNoise, GyrNoise
from tiltcal.recordings.rest_noise import noise_models_of
from tiltcal.statistics.allan import NAMES, TERMS, NoiseModel

SUFFIX = {"Q": " s", "N": "/rtHz", "B": "", "K": "/rts", "R": "/s"}


def noise(
    recording_file: Annotated[Path, Parameter("REC", help="Recording at rest.")],
    /,
    *,
    allowed: MoreBudget = DEFAULT_BUDGET,
    as_json: Json = False,
) -> int:
    """Estimate Allan coefficients from a recording at rest.

    Prints the coefficients of each channel and the [[effect]] tables that
    simulate this noise. The longest dwell is used. A slope that the recording
    does not show is reported as such.
    """
    allowed.apply()
    with progress_line() as progress:
        models = noise_models_of(recording_file, progress)
    if as_json:
        print_json({name: _as_json(model) for name, model in models.items()})
        return 0
    rows = [[n, *(_cell(m, t, split_unit(n)[1] or "") for t in TERMS)] for n, m in models.items()]
    print_table(["channel", *TERMS], rows)
    for t in TERMS:
        print_line(f"{t}: {NAMES[t]}")
    paragraph(
        "N is per root hertz of a two-sided density: the standard deviation of a sample is"
        " N sqrt(rate); data sheets often give sqrt(2) N."
    )
    for note in dict.fromkeys(note for model in models.values() for note in model.notes):
        paragraph(f"note: {note}")
    print_line("\n" + "\n".join(effect_tables(models)))
    return 0


def _as_json(model: NoiseModel) -> dict[str, object]:
    curve = {"tau_s": model.curve.tau.tolist(), "deviation": model.curve.deviation.tolist()}
    found = {"values": model.values, "sigmas": model.sigmas, "held": model.held, **curve}
    return {**found, "notes": list(model.notes)}


def _cell(model: NoiseModel, term: str, unit: str) -> str:
    if not model.held[term]:
        return "not visible"
    return f"{model.values[term]:.4g} +- {model.sigmas[term]:.2g} {unit}{SUFFIX[term]}"


def effect_tables(models: dict[str, NoiseModel]) -> list[str]:
    """One ``[[effect]]`` table per sensor, with the mean of its channels."""
    sensors: dict[str, list[tuple[NoiseModel, Unit]]] = {}
    for name, model in models.items():
        channel, suffix = split_unit(name)
        unit = COLUMN_UNITS[suffix or "s"]
        if unit.quantity in ("acceleration", "angle", "rate"):
            sensors.setdefault(channel.rpartition("_")[0], []).append((model, unit))
    return [line for name, channels in sensors.items() for line in _effect_table(name, channels)]


def _effect_table(sensor: str, channels: Sequence[tuple[NoiseModel, Unit]]) -> list[str]:
    quantity = channels[0][1].quantity
    size = G0 if quantity == "angle" else 1.0  # an inclinometer's urad are ug of acceleration
    mean = {t: size * float(np.mean([m.values[t] * u.factor for m, u in channels])) for t in TERMS}
    if quantity == "rate":
        cls: type[Effect] = GyrNoise
        values = {
            "white_deg_rth": mean["N"] / (DEG / 60),
            "flicker_deg_h": mean["B"] / DEG_H,
            "walk_deg_h_rth": mean["K"] / (DEG_H / 60),
        }
    else:
        cls = AccNoise
        values = {
            "white_ug_rthz": mean["N"] / (1e-6 * G0),
            "flicker_ug": mean["B"] / (1e-6 * G0),
            "walk_ug_rts": mean["K"] / (1e-6 * G0),
        }
    head = ["[[effect]]", f'id = "{cls.id}"', f'sensor = "{sensor}"']
    return head + [f"{name} = {value:.6g}" for name, value in values.items()]
