"""``tiltcal noise``."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from tiltcal.cli.options import DEFAULT_BUDGET, Json, MoreBudget
from tiltcal.cli.output import paragraph, print_json, print_line, print_table, progress_line
from tiltcal.core.units import COLUMN_UNITS, DEG, DEG_H, G0, Unit, split_unit
from tiltcal.effects import Effect
from tiltcal.effects.sensor.noise import AccNoise, GyrNoise
from tiltcal.recordings.rest_noise import RestNoise, rest_noise_of
from tiltcal.statistics.allan import NAMES, TERMS
from tiltcal.statistics.standstill_noise import StandstillNoise

SUFFIX = {"Q": " s", "N": "/rtHz", "B": "", "K": "/rts", "R": "/s"}
LEAST_P = 1e-99  # smaller ones are not printed


def noise(
    recording_file: Annotated[Path, Parameter("REC", help="Recording at rest.")],
    /,
    *,
    allowed: MoreBudget = DEFAULT_BUDGET,
    as_json: Json = False,
) -> int:
    """Estimate Allan coefficients from a recording at rest, and test them.

    Prints the coefficients of each channel, whether white noise, flicker and
    random walk fit its spectrum, the Allan deviation with that of the
    coefficients, and the [[effect]] tables that simulate this noise. The
    longest dwell is used. Where the model does not fit, the coefficients are
    upper limits.
    """
    allowed.apply()
    with progress_line() as progress:
        found = rest_noise_of(recording_file, progress)
    if as_json:
        models = {name: _as_json(model) for name, model in found.models.items()}
        findings = [f.as_json() for f in found.findings]
        print_json({"channels": models, "left_out": found.left_out, "findings": findings})
        return 0
    rows = [row for name, model in found.models.items() for row in _rows(name, model)]
    print_table(["channel", "model", "term", "value"], rows)
    _print_explanations(found)
    for name, model in found.models.items():
        _print_curve(name, model)
    print_line("\n" + "\n".join(effect_tables(found.models)))
    return 0


def _print_explanations(found: RestNoise) -> None:
    for t in TERMS:
        print_line(f"{t}: {NAMES[t]}")
    paragraph(
        "N is per root hertz of a two-sided density: the standard deviation of a sample is"
        " N sqrt(rate); data sheets often give sqrt(2) N."
    )
    for name, model in found.models.items():
        if not model.fits:
            paragraph(
                f"{name}: the model does not fit: {'; '.join(model.test.reasons)}. Its coefficients"
                " are the most that the Allan deviation allows of each alone."
            )
    for finding in found.findings:
        paragraph(f"found: {finding.with_repair()}")
    for name, why in found.left_out.items():
        paragraph(f"{name} is left out: {why}.")
    for note in dict.fromkeys(note for model in found.models.values() for note in model.notes):
        paragraph(f"note: {note}")


def _print_curve(name: str, model: StandstillNoise) -> None:
    """The Allan deviation with its interval, and that of the fitted coefficients."""
    low, high = model.curve.interval(0.95)
    columns = (model.curve.tau, model.curve.deviation, low, high, model.fitted_deviation)
    rows = [
        [f"{tau:.4g}", f"{found:.4g}", f"{a:.4g} to {b:.4g}", f"{fitted:.4g}"]
        for tau, found, a, b, fitted in zip(*columns, strict=True)
    ]
    unit = split_unit(name)[1] or ""
    print_table(["tau, s", f"Allan deviation, {unit}", "95 % interval", "fitted"], rows, name)


def _as_json(model: StandstillNoise) -> dict[str, object]:
    low, high = model.curve.interval(0.95)
    curve = {
        "tau_s": model.curve.tau.tolist(),
        "deviation": model.curve.deviation.tolist(),
        "deviation_low": low.tolist(),
        "deviation_high": high.tolist(),
        "fitted_deviation": model.fitted_deviation.tolist(),
    }
    nothing = dict.fromkeys(TERMS)
    return {
        "fits": model.fits,
        "p": model.test.p,
        "reasons": list(model.test.reasons),
        "bands": [vars(band) for band in model.test.bands],
        "line": vars(model.test.line),
        "values": model.values if model.fits else nothing,
        "sigmas": model.sigmas if model.fits else nothing,
        "limits": model.limits,
        "held": model.held,
        **curve,
        "notes": list(model.notes),
    }


def _verdict(model: StandstillNoise) -> str:
    """Whether the model fits, with p of the spectrum."""
    p = f"p = {model.test.p:.2g}" if model.test.p > LEAST_P else f"p < {LEAST_P}"
    return f"{'fits' if model.fits else 'DOES NOT FIT'}, {p}"


def _rows(name: str, model: StandstillNoise) -> list[list[str]]:
    """A row for each term that a channel shows, with the verdict in the first."""
    unit = split_unit(name)[1] or ""
    shown = [t for t in TERMS if model.held[t] or not model.fits]
    cells = [[t, _cell(model, t, f"{unit}{SUFFIX[t]}")] for t in shown] or [["", "none is visible"]]
    heads = [[name, _verdict(model)], *[["", ""]] * (len(cells) - 1)]
    return [head + cell for head, cell in zip(heads, cells, strict=True)]


def _cell(model: StandstillNoise, term: str, unit: str) -> str:
    if not model.fits:
        return f"<= {model.limits[term]:.2g} {unit}"
    return f"{model.values[term]:.4g} +- {model.sigmas[term]:.2g} {unit}"


def effect_tables(models: dict[str, StandstillNoise]) -> list[str]:
    """One ``[[effect]]`` table per sensor, with the mean of its channels."""
    sensors: dict[str, dict[str, tuple[StandstillNoise, Unit]]] = {}
    for name, model in models.items():
        channel, suffix = split_unit(name)
        unit = COLUMN_UNITS[suffix or "s"]
        if unit.quantity in ("acceleration", "angle", "rate"):
            sensors.setdefault(channel.rpartition("_")[0], {})[name] = (model, unit)
    return [line for name, channels in sensors.items() for line in _effect_table(name, channels)]


def _effect_table(sensor: str, channels: Mapping[str, tuple[StandstillNoise, Unit]]) -> list[str]:
    quantity = next(unit.quantity for _, unit in channels.values())
    size = G0 if quantity == "angle" else 1.0  # an inclinometer's urad are ug of acceleration
    mean = {
        t: size * float(np.mean([m.effective[t] * u.factor for m, u in channels.values()]))
        for t in TERMS
    }
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
    unfit = [name for name, (model, _) in channels.items() if not model.fits]
    comment = [
        f"# the model does not fit {name}: N is the most that its Allan deviation allows, B and K"
        " are not more than that"
        for name in unfit
    ]
    head = [*comment, "[[effect]]", f'id = "{cls.id}"', f'sensor = "{sensor}"']
    return head + [f"{name} = {value:.6g}" for name, value in values.items()]
