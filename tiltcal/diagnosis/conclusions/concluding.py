"""From a fitted model to its findings and classes, the quality of its fit, what was undetectable,
and the amended scenario.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.design.identifiability import POWER
from tiltcal.diagnosis.conclusions.amended_scenario import amended_table
from tiltcal.diagnosis.conclusions.finding import Finding, Fitness, Undetectable, Where
from tiltcal.diagnosis.conclusions.residual_plots import unit_of
from tiltcal.diagnosis.conclusions.statements import (
    coordinate_of_effect,
    harmonic_of,
    learned_name,
    next_step,
    shown,
    stage_of,
)
from tiltcal.diagnosis.data.observations import Observations
from tiltcal.diagnosis.data_quality.fault import Fault
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.model.cross_validation import heldout_gain, heldout_misfit
from tiltcal.diagnosis.model.fitted_model import FittedModel, FittedTerm
from tiltcal.diagnosis.model.removed_finding import RemovedFinding, price_of, remove_finding
from tiltcal.diagnosis.model.score_test import SURVIVES
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.alternatives import OWN, Alternative, inseparable, rank_alternatives
from tiltcal.diagnosis.search.thermal_lag import thermal_lag_findings
from tiltcal.effects import CATALOGUE
from tiltcal.effects.base import Effect
from tiltcal.effects.learned import Learned
from tiltcal.effects.parameter import Parameter

SHOWN = 0.05  # share of a finding's energy that a channel has to hold to be named


def findings_of(
    fitted: FittedModel, whitened: WhitenedModel, log_p: Sequence[float]
) -> list[Finding]:
    """The findings of a fitted model, each with its class and its place.

    Args:
        fitted: terms and calibration.
        whitened: columns under the noise that the fitted model leaves.
        log_p: corrected log p-value of each finding.
    """
    return [
        _finding(fitted, whitened, places, log_p[k]) for k, places in enumerate(fitted.findings())
    ]


def _finding(
    fitted: FittedModel, whitened: WhitenedModel, places: Sequence[int], log_p: float
) -> Finding:
    """One finding, with its class and its place."""
    observations = whitened.observations
    term = fitted.terms[places[0]]
    effect = term.effect
    removed = remove_finding(fitted, whitened, places)
    sensors, axes = _shown(removed.signal, observations)
    sizes = sum(len(fitted.terms[k].names) for k in places)
    gain = sum(float(t @ t) for t in removed.target) - fitted.deviance
    scenario = observations.scenario
    unnamed = Finding(
        effect=None,
        names=(),
        stage=stage_of(effect),
        sensors=sensors,
        axes=axes,
        where=Where(
            coordinate_of_effect(effect, scenario),
            harmonic_of(effect, scenario.rig),
            _interval(effect),
        ),
        p_value=float(np.exp(log_p)),
        delta_bic=price_of(whitened) * sizes - gain,
        heldout_gain=heldout_gain(fitted, whitened, places),
    )
    if not term.hypothesis.listed and isinstance(effect, Learned):
        return _unlisted(unnamed, effect, removed, whitened)
    return _named(unnamed, fitted, whitened, places, removed)


def _unlisted(
    finding: Finding, effect: Learned, removed: RemovedFinding, whitened: WhitenedModel
) -> Finding:
    """The finding as a curve that no effect of the catalogue fits."""
    named = rank_alternatives(removed, whitened, lambda s: s.listed)
    return replace(
        finding,
        rivals=tuple((r.hypothesis.id, r.cosine, r.separation) for r in named[:5]),
        statement=f"{learned_name(effect).capitalize()}: no named effect has this form.",
        next_measurement=next_step((), effect),
    )


def _named(
    finding: Finding,
    fitted: FittedModel,
    whitened: WhitenedModel,
    places: Sequence[int],
    removed: RemovedFinding,
) -> Finding:
    """The finding under its name, with the names that the recording cannot tell from it."""
    term = fitted.terms[places[0]]
    effect, id = term.effect, term.hypothesis.id
    rivals, names = _class_of(term, removed, whitened)
    inside = [fitted.terms[k] for k in places]
    late, same = thermal_lag_findings(inside, removed, fitted, whitened)
    names = (*names, *(n for n in same if n not in names))
    parameters = {} if isinstance(effect, Learned) else _parameters(term, fitted.sigmas(places[0]))
    return replace(
        finding,
        effect=id,
        names=names,
        stage=CATALOGUE[id].stage,
        parameters=parameters,
        rivals=rivals,
        statement=_statement(finding, id, names, parameters) + late,
        next_measurement=next_step(names, effect),
    )


def _statement(
    finding: Finding,
    id: str,
    names: Sequence[str],
    parameters: Mapping[str, tuple[float, float]],
) -> str:
    """What was found, where, how large, and what else it may be."""
    title = CATALOGUE[id].title
    others = ", ".join(n for n in names if n != id)
    other = f" (or {others}: this recording cannot tell)" if others else ""
    size = shown(parameters) if parameters else f"as a curve over {finding.where.coordinate}"
    place = f"{', '.join(finding.sensors)} {', '.join(finding.axes)}"
    return f"{title[:1].upper()}{title[1:]} ({id}) on {place}{other}: {size}."


def _class_of(
    term: FittedTerm, removed: RemovedFinding, whitened: WhitenedModel
) -> tuple[tuple[tuple[str, float, float], ...], tuple[str, ...]]:
    found = rank_alternatives(removed, whitened, lambda s: s.textbook or s.id == term.hypothesis.id)
    mine = next((r for r in found if r.hypothesis.place == term.hypothesis.place), None)
    nearest: dict[str, tuple[str, float, float]] = {}
    for r in found:
        if r.hypothesis.id != term.hypothesis.id:
            nearest.setdefault(r.hypothesis.id, (r.hypothesis.id, r.cosine, r.separation))
    rivals = tuple(nearest.values())
    best = max((r for r in found if r.fair and r.own >= OWN), key=lambda r: r.worth, default=mine)
    if best is None:
        return rivals[:8], (term.hypothesis.id,)
    members: list[Alternative] = inseparable(best, found)
    ids = dict.fromkeys([term.hypothesis.id, *(r.hypothesis.id for r in members)])
    return rivals[:8], tuple(ids)


def _shown(
    signal: Sequence[Array], observations: Observations
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Sensors and axes that hold the signal, the strongest first."""
    energy: dict[tuple[str, str], float] = {}
    for channel, part in zip(observations.channels, signal, strict=True):
        energy[channel.sensor, channel.axis] = energy.get(
            (channel.sensor, channel.axis), 0.0
        ) + float(part @ part)
    total = max(sum(energy.values()), 1e-300)
    strong = [
        key for key, e in sorted(energy.items(), key=lambda item: -item[1]) if e > SHOWN * total
    ]
    return tuple(dict.fromkeys(s for s, _ in strong)), tuple(dict.fromkeys(a for _, a in strong))


def _interval(effect: Effect) -> tuple[float, float | None] | None:
    return (float(effect.values["time"]), None) if "time" in effect.values else None


def _parameters(term: FittedTerm, sigmas: Array) -> dict[str, tuple[float, float]]:
    """Values by name with unit, as files have them."""
    found = {}
    for name, value, sigma in zip(term.names, term.values, sigmas, strict=True):
        p = _parameter_of(term.hypothesis, name)
        found[f"{name}{p.suffix}"] = (value / p.factor, float(sigma) / p.factor)
    return found


def _parameter_of(hypothesis: Hypothesis, name: str) -> Parameter:
    for p in hypothesis.effect.parameters:
        if name in p.expand(tuple("xyza")) or name == p.name:
            return p
    raise KeyError(name)


def fitness_of(fitted: FittedModel, whitened: WhitenedModel) -> Fitness:
    observations = whitened.observations
    used = fitted.basis[0].shape[1] if fitted.basis else 0
    rms: dict[str, float] = {}
    for channel, r in zip(
        observations.channels, observations.residuals(fitted.effects), strict=True
    ):
        rms.setdefault(
            f"{channel.sensor}_{channel.axis}_{unit_of(channel, observations)}",
            float(np.sqrt(np.mean(r * r))),
        )
    return Fitness(
        fitted.deviance / max(observations.samples - used, 1), rms, heldout_misfit(fitted, whitened)
    )


def undetectable_of(fitted: FittedModel, whitened: WhitenedModel) -> tuple[Undetectable, ...]:
    """Effects that could not have been seen, or only at which size."""
    found: dict[str, Undetectable] = {}
    blamed = {t.hypothesis.id for t in fitted.terms}
    for score in whitened.scores(
        fitted.basis,
        fitted.residual,
        lambda s: not isinstance(s.effect, Learned) and s.id not in blamed,
    ):
        hypothesis = score.hypothesis
        sizes = {}
        for i, name in enumerate(hypothesis.names):
            p = _parameter_of(hypothesis, name)
            if score.B[i, i] > SURVIVES * score.raw[i] > 0:
                sizes[f"{name}{p.suffix}"] = float(
                    np.sqrt(POWER / score.B[i, i]) * hypothesis.size(name) / p.factor
                )
        old = found.get(hypothesis.id)
        if old is None or (not old.size and sizes):
            found[hypothesis.id] = Undetectable(
                hypothesis.id, sizes, float(np.clip(score.absorbed, 0, 1))
            )
    return tuple(found.values())


def amended_of(
    fitted: FittedModel, observations: Observations, faults: Sequence[Fault]
) -> dict[str, Any]:
    """The scenario with calibration and findings."""
    first = observations.recordings[0]
    temperature = first.temperature()
    reference = observations.scenario.climate.reference_degC
    if reference is None and temperature is not None:
        reference = float(np.mean(temperature))
    meanings = [e for e in observations.scenario.effects if e.repair]
    effects: list[Effect] = [*fitted.known, *meanings, *(t.effect for t in fitted.nuisance)]
    effects += [f.effect for f in faults if f.effect not in effects]
    for k, term in enumerate(fitted.terms):
        effect = term.effect
        event = any(
            "time" in e.values or "frequency" in e.values
            for e in (effect, *([term.host.effect] if term.host else []))
        )
        sigmas = dict(zip(term.names, (float(s) for s in fitted.sigmas(k)), strict=True))
        effects.append(replace(effect, sigmas=sigmas, seen_in=first.fingerprint if event else None))
    return amended_table(observations.scenario, effects, reference)
