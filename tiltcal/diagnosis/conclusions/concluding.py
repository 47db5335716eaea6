"""From a fitted model to its findings and classes, what was undetectable, and the amended
scenario.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tiltcal.design.identifiability import POWER
from tiltcal.diagnosis.conclusions.finding import Finding, Undetectable, Where, in_words
from tiltcal.diagnosis.conclusions.fit_figures import LikelihoodGain, likelihood_gains
from tiltcal.diagnosis.conclusions.one_recording import (
    beside_drawn_anew,
    mean_and_deviations,
    place_of,
)
from tiltcal.diagnosis.conclusions.parts import amended_table, fitted_as, parts_of, strongest
from tiltcal.diagnosis.conclusions.seen_range import SeenRange, seen_range
from tiltcal.diagnosis.conclusions.statements import (
    LATE,
    coordinate_of_effect,
    harmonic_of,
    learned_name,
    next_step,
    shown,
    stage_of,
    step_for_one,
    sums_only,
)
from tiltcal.diagnosis.conclusions.whole_law import WholeLaw, whole_law
from tiltcal.diagnosis.data.observations import Observations
from tiltcal.diagnosis.data_faults.fault import Fault
from tiltcal.diagnosis.hypotheses.priors import UNLISTED
from tiltcal.diagnosis.model.finding_tests import remove_finding
from tiltcal.diagnosis.model.fitted_model import FittedModel, FittedTerm
from tiltcal.diagnosis.model.score_test import SURVIVES
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.candidates import SHOWN, Names
from tiltcal.diagnosis.search.explained import Explained
from tiltcal.effects import CATALOGUE
from tiltcal.effects.base import Effect
from tiltcal.effects.learned import Learned
from tiltcal.effects.parameter import by_name
from tiltcal.effects.table.readout import SettingScatter
from tiltcal.recordings.recording import Recording
from tiltcal.setup.setup import Rig


def findings_of(said: Explained, whitened: WhitenedModel, log_p: Sequence[float]) -> list[Finding]:
    """The findings of a fitted model, each with its class and its place.

    Args:
        said: the model, and what each of its causes may be.
        whitened: columns under the noise that the fitted model leaves.
        log_p: corrected log p-value of each finding.
    """
    gains = likelihood_gains(said.fitted, said.whitened, said.noise_source)
    return [
        replace(
            _finding(said.fitted, whitened, places, said.names[k], gains[k]),
            p_value=float(np.exp(min(log_p[k], 0.0))),
            probability=said.probability[k],
        )
        for k, places in enumerate(said.fitted.findings())
    ]


def _finding(
    fitted: FittedModel,
    whitened: WhitenedModel,
    places: Sequence[int],
    names: Names,
    gain: LikelihoodGain,
) -> Finding:
    """One finding, with its class and its place."""
    observations = whitened.observations
    term = fitted.terms[places[0]]
    effect = term.effect
    names = beside_drawn_anew(names, effect)
    removed = remove_finding(fitted, whitened, places)
    law = whole_law(fitted, whitened, places, removed)
    sensors, axes = strongest(removed.signal, observations)
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
            recording=place_of([fitted.terms[k].effect for k in places], observations.recordings),
        ),
        parts=parts_of(fitted, places, law, observations),
        delta_bic=gain.delta_bic,
        heldout_gain=gain.heldout,
        rivals=names.rivals,
        name_probability=names.probability,
    )
    if not term.hypothesis.listed and isinstance(effect, Learned):
        found = _unlisted(unnamed, effect, names.perhaps, seen_range(effect, observations))
    else:
        found = _named(unnamed, term, names, law)
    return replace(found, statement=found.statement + LATE) if names.late else found


def _unlisted(
    finding: Finding, effect: Learned, perhaps: Sequence[str], seen: SeenRange | None
) -> Finding:
    """The finding as a curve that no effect of the catalogue fits, or perhaps one of some names."""
    words = learned_name(effect)
    others = ", ".join(perhaps)
    other = f" (or it is {others}: this recording cannot tell)" if others else ""
    return replace(
        finding,
        names=(UNLISTED, *perhaps) if perhaps else (),
        where=replace(finding.where, seen=seen),
        statement=f"{words[0].upper()}{words[1:]}: no named effect has this form{other}."
        + fitted_as(finding.parts)
        + (seen.words if seen else ""),
        next_measurement=next_step((), effect)
        if finding.where.recording is None
        else step_for_one(finding.where.recording),
    )


def _named(finding: Finding, term: FittedTerm, names: Names, law: WholeLaw) -> Finding:
    """The finding under its name, with the names that the recording cannot tell from it."""
    effect, id = term.effect, term.hypothesis.id
    alike = tuple(dict.fromkeys((id, *names.members)))
    parameters = {} if isinstance(effect, Learned) else _parameters(term, law)
    return replace(
        finding,
        effect=id,
        names=alike,
        stage=CATALOGUE[id].stage,
        parameters=parameters,
        statement=_statement(finding, term, alike, parameters)
        + sums_only(law.untold)
        + fitted_as(finding.parts),
        next_measurement=next_step(alike, effect),
    )


def _statement(
    finding: Finding,
    term: FittedTerm,
    names: Sequence[str],
    parameters: Mapping[str, tuple[float, float]],
) -> str:
    """What was found, where, how large, and what else it may be."""
    id, axis = term.hypothesis.id, term.effect.axis
    title = CATALOGUE[id].title
    others = in_words([n for n in names if n != id])
    other = f" (or {', '.join(others)}: this recording cannot tell)" if others else ""
    if len(others) > SHOWN:
        other = f" (or one of {len(others)} others: a signal of this size and form has no name)"
    size = shown(parameters) if parameters else f"as a curve over {finding.where.coordinate}"
    of = f" of the {axis} axis" if axis and term.effect.axis_wise else ""
    place = f"{', '.join(finding.sensors)} {', '.join(finding.axes)}"
    place += f" {finding.where.recording}" if finding.where.recording else ""
    return f"{title[:1].upper()}{title[1:]} ({id}){of} on {place}{other}: {size}."


def _interval(effect: Effect) -> tuple[float, float | None] | None:
    return (float(effect.values["time"]), None) if "time" in effect.values else None


def _parameters(term: FittedTerm, law: WholeLaw) -> dict[str, tuple[float, float]]:
    """Sizes of a whole law by name with unit, as files have them."""
    found, known = {}, by_name(term.hypothesis.effect.parameters)
    for name, value, sigma in zip(term.names, law.values, law.sigmas, strict=True):
        p = known[name]
        found[f"{name}{p.suffix}"] = (float(value) / p.factor, float(sigma) / p.factor)
    return found


def undetectable_of(fitted: FittedModel, whitened: WhitenedModel) -> tuple[Undetectable, ...]:
    """Effects that could not have been seen, or only at which size: that of the shape, and of the
    instant, that would show best.
    """
    found: dict[object, Undetectable] = {}
    blamed = {t.hypothesis.place for t in fitted.terms}
    for score in whitened.scores(
        fitted.basis,
        fitted.residual,
        lambda s: not isinstance(s.effect, Learned) and s.place not in blamed,
    ):
        hypothesis, place = score.hypothesis, score.hypothesis.place
        sizes, known = {}, by_name(hypothesis.effect.parameters)
        for i, name in enumerate(hypothesis.names):
            p = known[name]
            if score.B[i, i] > SURVIVES * score.raw[i] > 0:
                sizes[f"{name}{p.suffix}"] = float(
                    np.sqrt(POWER / score.B[i, i]) * hypothesis.size(name) / p.factor
                )
        absorbed = float(np.clip(score.absorbed, 0, 1))
        if old := found.get(place):  # at another shape, or instant
            sizes = {
                n: min(s[n] for s in (old.size, sizes) if n in s) for n in {**old.size, **sizes}
            }
            absorbed = min(old.absorbed, absorbed)
        found[place] = Undetectable(*place, sizes, absorbed)
    return tuple(found.values())


def amended_of(
    fitted: FittedModel,
    observations: Observations,
    faults: Sequence[Fault],
    numbers: Mapping[int, int],
) -> dict[str, Any]:
    """The scenario with calibration and findings.

    Args:
        fitted: the model.
        observations: whose scenario.
        faults: of the data: the first findings, in order.
        numbers: of the finding that each term of the model belongs to, from 1, by its place.
    """
    first = observations.recordings[0]
    temperature = first.temperature()
    reference = observations.scenario.climate.reference_degC
    if reference is None and temperature is not None:
        reference = float(np.mean(temperature))
    meanings = [e for e in observations.scenario.effects if e.repair]
    scatters = [f.effect for f in faults if isinstance(f.effect, SettingScatter)]
    known = [e for e in fitted.known if not _is_among(e, scatters, observations.scenario.rig)]
    own: list[Effect] = [*known, *meanings, *fitted.calibration()]
    own += [f.effect for f in faults if f.effect not in own]
    marked: list[tuple[Effect, int | None]] = [
        (e, next((k for k, f in enumerate(faults, 1) if f.effect == e), None)) for e in own
    ]
    for places in fitted.findings():
        effects = [_dated(fitted, k, first) for k in places]
        effects = mean_and_deviations(fitted, places, effects, observations)
        if fitted.terms[places[0]].hypothesis.listed:
            effects = _beyond_seen(effects)
        marked += [(e, numbers[places[0]]) for e in effects]
    return amended_table(observations.scenario, marked, reference)


def _is_among(effect: Effect, scatters: Sequence[SettingScatter], rig: Rig) -> bool:
    """Whether an effect is the scatter of an axis whose scatter is among these."""
    if not isinstance(effect, SettingScatter):
        return False
    return any(one.axis is not None and effect.acts_on(one.axis, rig) for one in scatters)


def _beyond_seen(effects: list[Effect]) -> list[Effect]:
    """The effects of a named law as they are beyond what was seen: a textbook form goes on, and a
    curve that completes it holds its last value; where the law itself is a curve, that goes on.
    """
    if isinstance(effects[0], Learned):
        return effects
    return [
        replace(e, holds=True) if isinstance(e, Learned) and e.extrapolates else e for e in effects
    ]


def _dated(fitted: FittedModel, k: int, recording: Recording) -> Effect:
    """The effect of a found term with its uncertainties, and for an event where it was seen."""
    term = fitted.terms[k]
    effect = term.effect
    event = any(
        "time" in e.values or "frequency" in e.values
        for e in (effect, *([term.host.effect] if term.host else []))
    )
    sigmas = dict(zip(term.names, (float(s) for s in fitted.sigmas(k)), strict=True))
    first = recording.fingerprint if event else None
    return replace(effect, sigmas=sigmas, seen_in=effect.seen_in or first)
