"""From recordings and a scenario to a diagnosis: faults of the data first, then the noise, then who is to blame."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tiltcal.confusion import POWER
from tiltcal.diagnosis.account import Account, Term, as_it_began, noise_under, settle
from tiltcal.diagnosis.amend import amended_table
from tiltcal.diagnosis.columns import MASKED, MEANINGS, as_meant
from tiltcal.diagnosis.evidence import Ledger, cosines
from tiltcal.diagnosis.faults import Fault, inspect
from tiltcal.diagnosis.finding import Diagnosis, Finding, Fitness, Undetectable, Where, verdict_of
from tiltcal.diagnosis.gross import gross_errors
from tiltcal.diagnosis.hand import HandObservations
from tiltcal.diagnosis.heldout import heldout_gain, heldout_misfit
from tiltcal.diagnosis.meaning import meaning
from tiltcal.diagnosis.observations import Observations, observe
from tiltcal.diagnosis.randoms import random_stamps, setting_error, wrong_stop
from tiltcal.diagnosis.resimulate import resimulate
from tiltcal.diagnosis.rivals import OWN, Case, Rival, case_of, explanations, inseparable, price_of
from tiltcal.diagnosis.select import Gate, findings, select
from tiltcal.diagnosis.suspects import Suspect, adjustable, curves, listed_suspects, span_of, step_suspects
from tiltcal.diagnosis.tones import tones_of
from tiltcal.diagnosis.unlisted import nameless
from tiltcal.diagnosis.views import UNITS, views_of
from tiltcal.diagnosis.whitening import NoiseFit, NoiseModel, estimate_noise, robust_white
from tiltcal.diagnosis.wording import (
    coordinate_of_effect,
    harmonic_of,
    learned_name,
    next_step,
    shown,
    stage_of,
    summary,
)
from tiltcal.effects import CATALOGUE
from tiltcal.effects.base import Effect, Parameter
from tiltcal.effects.learned import Learned
from tiltcal.frames import Array
from tiltcal.laboratory import Laboratory
from tiltcal.poses import group_directions
from tiltcal.recording import Recording
from tiltcal.scenario import Scenario, parse_scenario

Progress = Callable[[str], None]
MOST_STEPS = 120  # instants at which a step is looked for before the best one is moved row by row
SHOWN = 0.05  # share of a finding's energy that a channel has to hold to be named


def silent(words: str) -> None:
    """No progress."""


def diagnose(
    scenario: Scenario, recordings: Sequence[Recording], *, static: Recording | None = None, laboratory: Laboratory | None = None,
    progress: Progress = silent,
) -> Diagnosis:  # fmt: skip
    """Why these recordings differ from the scenario.

    Args:
        scenario: what is known of the set-up.
        recordings: of one set-up, explained together; those that step or drift are told apart by their stamps.
        static: a record at rest, of the same sensors at the same rate, to take the noise from.
        laboratory: re-simulates the recording with the amended scenario in the end.
        progress: is told what is being done.

    Raises:
        TiltcalError: a column is missing, or nothing in a recording has a model.
    """
    progress("reading")
    bench = prepare(scenario, recordings)
    if not enough(bench.observations, bench.start):
        return _answer(bench, bench.start, (), (), None, False)
    progress("what every effect would do")
    ledger = bench.ledger
    fill(ledger, bench.start)
    gate = Gate(None if static is None else static_noise(bench.observations, static), len(ledger.suspects))
    progress("who is to blame")
    account = select(bench.start, ledger, gate, lambda s: s.textbook)
    progress("what no name fits")
    account = nameless(account, ledger, gate)
    progress("rivals")
    account, chance = _by_chance(account, bench.start, ledger, gate)
    progress("re-simulating")
    return _answer(bench, account, _findings(account, ledger, gate), chance, laboratory, True, static is not None)


@dataclass(frozen=True)
class Bench:
    """Recordings whose data faults are mended, and the adjustable terms fitted to them.

    Args:
        faults: found in the data; notes: what is no mismatch.
    """

    observations: Observations
    ledger: Ledger
    start: Account
    faults: tuple[Fault, ...]
    notes: tuple[str, ...]


def prepare(scenario: Scenario, recordings: Sequence[Recording]) -> Bench:
    """Mend what is wrong with the data, layer by layer, and fit the adjustable terms."""
    sound, faults, notes = _sound(scenario, recordings)
    known = [e for e in (*scenario.effects, *(f.effect for f in faults)) if e.id not in (*MEANINGS, *MASKED)]
    observations = observe(scenario, sound, known)
    ledger = Ledger(observations)
    start = calibrated(observations, ledger)
    wild, mended = gross_errors(observations, start)
    if any(a is not b for a, b in zip(mended, observations.recordings, strict=True)):
        observations = observe(scenario, mended, known)
        ledger = Ledger(observations)
        start = calibrated(observations, ledger)
    slip = wrong_stop(observations, start)
    if slip is not None:
        spoiled, observations = observations, observe(scenario, slip[1], known)
        ledger = Ledger(observations)
        start = calibrated(observations, ledger)
        slip = wrong_stop(spoiled, start) or slip  # sized again, by a calibration that it has not spoiled
        if not any(e.id == "data_pose_label" for e in scenario.effects):
            wild = [*wild, slip[0]]
    return Bench(observations, ledger, start, (*faults, *wild), tuple(notes))


def static_noise(observations: Observations, static: Recording) -> tuple[NoiseFit, ...]:
    """The noise of each channel from a record at rest.

    Raises:
        TiltcalError: it lacks a sensor.
    """
    found = []
    for channel in observations.channels:
        sensor = observations.scenario.named(channel.sensor)
        samples = static.sensor(sensor)
        values = samples.values[:, channel.column] if channel.axis != "norm" else np.linalg.norm(samples.values, axis=1)
        values = values[~np.isnan(values)]
        found.append(estimate_noise(cosines(values - values.mean()), cosines(np.ones(len(values)))[:, None]))
    return tuple(found)


def _sound(scenario: Scenario, recordings: Sequence[Recording]) -> tuple[tuple[Recording, ...], list[Fault], list[str]]:
    """The recordings with the faults of their data mended, and those faults."""
    inspected = inspect(scenario, recordings)
    faults = list(inspected.faults)
    meant = meaning(scenario, inspected.recordings[0])
    effects = [*scenario.effects, *(f.effect for f in meant)]
    sound = tuple(as_meant(r, scenario, effects) for r in inspected.recordings)
    return sound, [*meant, *faults], list(inspected.notes)


def _by_chance(account: Account, start: Account, ledger: Ledger, gate: Gate) -> tuple[Account, list[Fault]]:
    """Random effects last: they explain anything that varies from stop to stop, so nothing smooth may do so."""
    known = {e.id for e in ledger.observations.scenario.effects}
    found: list[Fault] = []
    if "table_index_error" not in known:
        setting = setting_error(account, start, ledger, gate.total)
        if setting is not None:
            account = settle(replace(account, terms=()), ledger)
            found.append(setting[0])
    if "data_jitter" not in known and (stamps := random_stamps(account, ledger.observations)) is not None:
        found.append(stamps)
    return account, found


def calibrated(observations: Observations, ledger: Ledger) -> Account:
    """The adjustable terms fitted to the readings, with white noise."""
    scenario = observations.scenario
    terms = [Term.start(s) for s in adjustable(scenario)]
    known: list[Effect] = []
    for effect in observations.known:  # an amended scenario brings its calibration: go on from there
        k = next((k for k, t in enumerate(terms) if t.suspect.place == (effect.id, effect.sensor, effect.axis)), None)
        if k is None or effect.role != "calibration":
            known.append(effect)
        else:
            terms[k] = replace(terms[k], values=tuple(effect.value(n) for n in terms[k].names))
    account = Account(tuple(known), tuple(terms))
    ledger.under([NoiseModel(robust_white(r)) for r in observations.residuals(account.effects)])
    return settle(account, ledger)


def enough(observations: Observations, account: Account) -> bool:
    """Whether there are more poses than the adjustable terms need."""
    if not observations.channels:
        return False
    if not isinstance(observations, HandObservations):
        return True
    if any(c.axis != "norm" for c in observations.channels):
        return True
    up: list[Array] = []
    for channel in observations.channels:
        recording = observations.recordings[channel.recording]
        sensor = observations.scenario.named(channel.sensor)
        samples = recording.sensor(sensor)
        values = samples.values[np.isin(samples.rows, channel.rows)]
        up += [values[channel.stop == k].mean(axis=0) for k in range(channel.stop.max() + 1) if (channel.stop == k).any()]
    directions = int(group_directions(np.array(up)).max()) + 1 if up else 0
    return directions > account.basis[0].shape[1]


def fill(ledger: Ledger, account: Account) -> None:
    """Put every suspect on the ledger."""
    observations = ledger.observations
    effects = account.effects
    span = span_of(observations, tones_of(ledger, account))
    nuisance = [t.suspect for t in account.nuisance]
    for suspect in listed_suspects(observations.scenario, span, nuisance):
        ledger.add(suspect, effects)
    for suspect in step_suspects(observations.scenario, instants(observations)):
        ledger.add(suspect, effects)
    for suspect in curves(observations, span):
        ledger.add(suspect, effects)


def instants(observations: Observations) -> list[float]:
    """When a step may have been: at the ends of moves, and all along, s from the first stamp."""
    first = observations.recordings[0]
    span = float(first.time[-1] - first.time[0])
    channel = observations.channels[0]
    edges = channel.time[np.flatnonzero(np.diff((channel.stop >= 0).astype(int)) != 0)] - first.time[0]
    if not 8 <= len(edges) <= MOST_STEPS:
        edges = np.linspace(0, span, 62)[1:-1]
    return [float(t) for t in edges if 0.01 * span < t < 0.99 * span]


def _findings(account: Account, ledger: Ledger, gate: Gate) -> list[Finding]:
    """The findings of an account, each with its class and its place."""
    values = gate.log_p(account, ledger) if account.terms else []
    return [_finding(account, ledger, places, values[k]) for k, places in enumerate(findings(account))]


def _answer(
    bench: Bench, account: Account, found: Sequence[Finding], chance: Sequence[Fault], laboratory: Laboratory | None, told: bool,
    static: bool = False,
) -> Diagnosis:  # fmt: skip
    """Verdict and figures."""
    ledger, observations = bench.ledger, bench.observations
    before = settle(bench.start, ledger)
    first, last = _fitness(before, ledger), _fitness(account, ledger)
    faults = [*bench.faults, *chance]
    answer = (*(f.finding() for f in faults), *sorted(found, key=lambda f: f.delta_bic))
    verdict = verdict_of(answer, told)
    source = "taken from the static record" if static else "taken from the recording itself"
    statement = summary(answer, verdict, first.chi2_per_dof, last.chi2_per_dof, source)
    began = as_it_began(account, ledger, noise_under(account, ledger)) if told else account
    amended = _amended(began, observations, faults)
    notes = [*bench.notes, f"the noise was {source}"]
    fitted = observations.predict(account.effects)
    if laboratory is not None and told:
        again = resimulate(laboratory, _as_read(amended, observations.scenario), observations, fitted)
        notes += [again.words] if again is not None else []
    left = [c.values - p for c, p in zip(observations.channels, fitted, strict=True)]
    return Diagnosis(
        verdict, statement, answer, tuple(notes), _undetectable(account, ledger) if told else (), first, last, amended,
        views_of(observations, observations.residuals(before.effects), left),
    )  # fmt: skip


def _as_read(amended: Mapping[str, Any], scenario: Scenario) -> Scenario:
    """The amended scenario without the data faults that were mended in the columns."""
    mended = (*MEANINGS, *MASKED, "data_outlier", "table_index_error", "data_jitter")
    return parse_scenario({**amended, "effect": [e for e in amended["effect"] if e["id"] not in mended]}, scenario.name)


def _finding(account: Account, ledger: Ledger, places: Sequence[int], log_p: float) -> Finding:
    """One finding, with its class and its place."""
    observations = ledger.observations
    term = account.terms[places[0]]
    case = case_of(account, ledger, places)
    effect = term.effect
    sensors, axes = _shown(case.signal, observations)
    sizes = sum(len(account.terms[k].names) for k in places)
    gain = sum(float(t @ t) for t in case.target) - account.deviance
    held = heldout_gain(account, ledger, places)
    where = Where(coordinate_of_effect(effect, observations.scenario), harmonic_of(effect), _interval(effect))
    if not term.suspect.listed and isinstance(effect, Learned):
        named = explanations(case, ledger, lambda s: s.listed)
        rivals = tuple((r.suspect.id, r.cosine, r.separation) for r in named[:5])
        words = f"{learned_name(effect).capitalize()}: no named effect has this form."
        return Finding(
            None, (), stage_of(effect), sensors, axes, where, {}, float(np.exp(log_p)), price_of(ledger) * sizes - gain, held,
            rivals, words, next_step((), effect),
        )  # fmt: skip
    rivals_, names = _class_of(term, case, ledger)
    id = term.suspect.id
    parameters = {} if isinstance(effect, Learned) else _parameters(term, account.sigmas(places[0]))
    cls = CATALOGUE[id]
    other = f" (or {', '.join(n for n in names if n != id)}: this recording cannot tell)" if len(names) > 1 else ""
    size = shown(parameters) if parameters else f"as a curve over {where.coordinate}"
    words = f"{cls.title.capitalize()} ({id}) on {', '.join(sensors)} {', '.join(axes)}{other}: {size}."
    return Finding(
        id, names, cls.stage, sensors, axes, where, parameters, float(np.exp(log_p)), price_of(ledger) * sizes - gain,
        held, rivals_, words, next_step(names, effect),
    )  # fmt: skip


def _class_of(term: Term, case: Case, ledger: Ledger) -> tuple[tuple[tuple[str, float, float], ...], tuple[str, ...]]:
    found = explanations(case, ledger, lambda s: s.textbook or s.id == term.suspect.id)
    mine = next((r for r in found if r.suspect.place == term.suspect.place), None)
    nearest: dict[str, tuple[str, float, float]] = {}
    for r in found:
        if r.suspect.id != term.suspect.id:
            nearest.setdefault(r.suspect.id, (r.suspect.id, r.cosine, r.separation))
    rivals = tuple(nearest.values())
    best = max((r for r in found if r.fair and r.own >= OWN), key=lambda r: r.worth, default=mine)
    if best is None:
        return rivals[:8], (term.suspect.id,)
    members: list[Rival] = inseparable(best, found)
    ids = dict.fromkeys([term.suspect.id, *(r.suspect.id for r in members)])
    return rivals[:8], tuple(ids)


def _shown(signal: Sequence[Array], observations: Observations) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Sensors and axes that hold the signal, the strongest first."""
    energy: dict[tuple[str, str], float] = {}
    for channel, part in zip(observations.channels, signal, strict=True):
        energy[channel.sensor, channel.axis] = energy.get((channel.sensor, channel.axis), 0.0) + float(part @ part)
    total = max(sum(energy.values()), 1e-300)
    strong = [key for key, e in sorted(energy.items(), key=lambda item: -item[1]) if e > SHOWN * total]
    return tuple(dict.fromkeys(s for s, _ in strong)), tuple(dict.fromkeys(a for _, a in strong))


def _interval(effect: Effect) -> tuple[float, float | None] | None:
    return (float(effect.values["time"]), None) if "time" in effect.values else None


def _parameters(term: Term, sigmas: Array) -> dict[str, tuple[float, float]]:
    """Values by name with unit, as files have them."""
    found = {}
    for name, value, sigma in zip(term.names, term.values, sigmas, strict=True):
        p = _parameter_of(term.suspect, name)
        found[f"{name}{p.suffix}"] = (value / p.factor, float(sigma) / p.factor)
    return found


def _parameter_of(suspect: Suspect, name: str) -> Parameter:
    for p in suspect.effect.parameters:
        if name in p.expand(tuple("xyza")) or name == p.name:
            return p
    raise KeyError(name)


def _fitness(account: Account, ledger: Ledger) -> Fitness:
    observations = ledger.observations
    used = account.basis[0].shape[1]
    rms: dict[str, float] = {}
    for channel, r in zip(observations.channels, observations.residuals(account.effects), strict=True):
        unit = UNITS[observations.scenario.named(channel.sensor).kind]
        rms.setdefault(f"{channel.sensor}_{channel.axis}_{unit}", float(np.sqrt(np.mean(r * r))))
    return Fitness(account.deviance / max(observations.samples - used, 1), rms, heldout_misfit(account, ledger))


def _undetectable(account: Account, ledger: Ledger) -> tuple[Undetectable, ...]:
    """What could not have been seen, or only at which size."""
    found: dict[str, Undetectable] = {}
    blamed = {t.suspect.id for t in account.terms}
    for score in ledger.scores(account.basis, account.residual):
        suspect = score.suspect
        if isinstance(suspect.effect, Learned) or suspect.id in blamed:
            continue
        sizes = {}
        for i, name in enumerate(suspect.names):
            p = _parameter_of(suspect, name)
            if score.B[i, i] > 1e-3 * score.raw[i] > 0:
                sizes[f"{name}{p.suffix}"] = float(np.sqrt(POWER / score.B[i, i]) * suspect.size(name) / p.factor)
        old = found.get(suspect.id)
        if old is None or (not old.size and sizes):
            found[suspect.id] = Undetectable(suspect.id, sizes, float(np.clip(score.absorbed, 0, 1)))
    return tuple(found.values())


def _amended(account: Account, observations: Observations, faults: Sequence[Fault]) -> dict[str, Any]:
    """The scenario with calibration and findings in it."""
    first = observations.recordings[0]
    temperature = first.temperature()
    reference = observations.scenario.climate.reference_degC
    if reference is None and temperature is not None:
        reference = float(np.mean(temperature))
    meanings = [e for e in observations.scenario.effects if e.id in (*MEANINGS, *MASKED)]
    effects: list[Effect] = [*account.known, *meanings, *(t.effect for t in account.nuisance)]
    effects += [f.effect for f in faults if f.effect not in effects]
    for k, term in enumerate(account.terms):
        effect = term.effect
        event = any("time" in e.values or "frequency" in e.values for e in (effect, *([term.host.effect] if term.host else [])))
        sigmas = dict(zip(term.names, (float(s) for s in account.sigmas(k)), strict=True))
        effects.append(replace(effect, sigmas=sigmas, seen_in=first.fingerprint if event else None))
    return amended_table(observations.scenario, effects, reference)


__all__ = ["Diagnosis", "diagnose"]
