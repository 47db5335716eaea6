"""From recordings and a scenario to a diagnosis: faults of the data first, then the noise, then who is to blame."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tiltcal.diagnosis.account import Account, Term, as_it_began, noise_under, settle
from tiltcal.diagnosis.blocks import block_of
from tiltcal.diagnosis.columns import MASKED, MEANINGS, as_meant
from tiltcal.diagnosis.conclude import amended_of, findings_of, fitness_of, undetectable_of
from tiltcal.diagnosis.curves import curves
from tiltcal.diagnosis.evidence import Ledger, cosines
from tiltcal.diagnosis.faults import Fault, code_floors, inspect
from tiltcal.diagnosis.finding import Diagnosis, Finding, verdict_of
from tiltcal.diagnosis.gross import gross_errors
from tiltcal.diagnosis.hand import HandObservations
from tiltcal.diagnosis.lost import lost_samples
from tiltcal.diagnosis.meaning import meaning
from tiltcal.diagnosis.observations import Observations, TableObservations, observe
from tiltcal.diagnosis.plain import plainer
from tiltcal.diagnosis.randoms import at_rest_only, random_stamps, setting_error, wrong_stop
from tiltcal.diagnosis.resimulate import resimulate
from tiltcal.diagnosis.select import Gate, absorbed, findings, plausible, select
from tiltcal.diagnosis.span import Lines, span_of
from tiltcal.diagnosis.suspects import OF_LINES, Suspect, adjustable, listed_suspects, step_suspects
from tiltcal.diagnosis.tones import lines_of
from tiltcal.diagnosis.unlisted import nameless
from tiltcal.diagnosis.views import views_of
from tiltcal.diagnosis.whitening import NoiseFit, NoiseModel, estimate_noise, robust_white
from tiltcal.diagnosis.wording import summary
from tiltcal.effects.base import Effect
from tiltcal.frames import Array
from tiltcal.laboratory import Laboratory
from tiltcal.poses import group_directions
from tiltcal.recording import Recording
from tiltcal.scenario import Scenario, parse_scenario

Progress = Callable[[str], None]
MOST_STEPS = 120  # instants at which a step is looked for before the best one is moved row by row


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
        return _answer(bench, bench.start, (), (), False)
    progress("what every effect would do")
    lines = lines_of(bench.ledger, bench.start)
    full, bench = bench.observations, thinned(bench, lines)
    ledger = bench.ledger
    fill(ledger, bench.start, lines)
    gate = Gate(None if static is None else static_noise(bench.observations, static), len(ledger.suspects))
    progress("who is to blame")
    account = select(bench.start, ledger, gate, _textbook)
    account = plainer(account, bench.start, ledger, gate, _textbook)
    if account.terms and refill(ledger, account, lines):
        account = select(account, ledger, gate, _textbook)
    account = absorbed(account, ledger)
    progress("what no name fits")
    account = plausible(nameless(account, ledger, gate), ledger)
    progress("rivals")
    chance: list[Fault] = []
    if bench.floors:
        account = above(account, ledger, bench.floors, any(f.effect.id == "data_truncation" for f in bench.faults))
    else:
        account, chance = _by_chance(account, bench.start, ledger, gate)
    progress("re-simulating")
    answer = _answer(bench, account, findings_of(account, ledger, gate), chance, True, static is not None)
    return answer if laboratory is None else _simulated(answer, laboratory, full, account)


def _textbook(suspect: Suspect) -> bool:
    return suspect.textbook


@dataclass(frozen=True)
class Bench:
    """Recordings whose data faults are mended, and the adjustable terms fitted to them.

    Args:
        faults: found in the data; notes: what is no mismatch.
        floors: size, SI, of what coarse codes do to a sensor's misfit, by sensor.
    """

    observations: Observations
    ledger: Ledger
    start: Account
    faults: tuple[Fault, ...]
    notes: tuple[str, ...]
    floors: Mapping[str, float] = field(default_factory=dict)


def prepare(scenario: Scenario, recordings: Sequence[Recording]) -> Bench:
    """Mend what is wrong with the data, layer by layer, and fit the adjustable terms."""
    sound, faults, notes = _sound(scenario, recordings)
    known = [e for e in (*scenario.effects, *(f.effect for f in faults)) if e.id not in (*MEANINGS, *MASKED)]
    observations = observe(scenario, sound, known)
    ledger = Ledger(observations)
    start = calibrated(observations, ledger)
    floors = code_floors(scenario, faults)
    if not floors and not any(e.id == "data_drop" for e in scenario.effects):
        losses, moved = lost_samples(observations, start)
        if losses:
            faults, observations = [*faults, *losses], observe(scenario, moved, known)
            ledger = Ledger(observations)
            start = calibrated(observations, ledger)
    known_jitter = floors or any(e.id == "data_jitter" for e in scenario.effects)
    jittered = None if known_jitter else random_stamps(start, observations)
    if jittered is not None:  # whatever moves fast is spoiled by it
        observations = observe(scenario, at_rest_only(observations, start, jittered.effect.value("jitter")), known)
        faults = [*faults, jittered]
        ledger = Ledger(observations)
        start = calibrated(observations, ledger)
    wild, mended = gross_errors(observations, start, floors)
    if any(a is not b for a, b in zip(mended, observations.recordings, strict=True)):
        observations = observe(scenario, mended, known)
        ledger = Ledger(observations)
        start = calibrated(observations, ledger)
    slip = None if floors else wrong_stop(observations, start)
    if slip is not None:
        spoiled, observations = observations, observe(scenario, slip[1], known)
        ledger = Ledger(observations)
        start = calibrated(observations, ledger)
        slip = wrong_stop(spoiled, start) or slip  # sized again, by a calibration that it has not spoiled
        if not any(e.id == "data_pose_label" for e in scenario.effects):
            wild = [*wild, slip[0]]
    return Bench(observations, ledger, start, (*faults, *wild), tuple(notes), floors)


def thinned(bench: Bench, lines: Lines) -> Bench:
    """The same with a long record's samples averaged in short blocks."""
    old = bench.observations
    block = block_of(old, lines)
    if block < 2 or not isinstance(old, TableObservations):
        return bench
    observations = old.averaged(block)
    ledger = Ledger(observations)
    return replace(bench, observations=observations, ledger=ledger, start=calibrated(observations, ledger))


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
    other_unit = {f.effect.sensor for f in meant if f.effect.id == "data_unit"}  # its digits were meant for another size
    faults = [f for f in faults if f.effect.id not in ("adc_quantisation", "gyr_quantisation") or f.effect.sensor not in other_unit]
    effects = [*scenario.effects, *(f.effect for f in meant)]
    sound = tuple(as_meant(r, scenario, effects) for r in inspected.recordings)
    return sound, [*meant, *faults], list(inspected.notes)


def above(account: Account, ledger: Ledger, floors: Mapping[str, float], blurred: bool = False) -> Account:
    """The account without findings that are nowhere larger than what coarse codes do.

    Args:
        blurred: whether the table's angles are cut: rates and accelerations derived from them say nothing.
    """
    observations = ledger.observations
    kept: list[Term] = []
    for places in findings(account):
        inside = [account.terms[k] for k in places]
        largest: dict[str, float] = {}
        for i, change in _summed(observations, inside, account).items():
            name = observations.channels[i].sensor
            largest[name] = max(largest.get(name, 0.0), float(np.abs(change).max()))
        smooth = not (blurred and inside[0].effect.needs == "motion")
        seen = any(size > floors.get(name, 0.0) > 0 for name, size in largest.items()) or not set(largest) & set(floors)
        if smooth and seen:
            kept += inside
    return settle(replace(account, terms=tuple(kept)), ledger)


def _summed(observations: Observations, terms: Sequence[Term], account: Account) -> dict[int, Array]:
    """What some terms do to the readings together, SI, by channel."""
    total: dict[int, Array] = {}
    for term in terms:
        for name, value in zip(term.names, term.values, strict=True):
            for i, column in observations.changes(term.suspect.alone(name), account.effects).items():
                total[i] = total.get(i, 0.0) + column * (value / term.suspect.size(name))
    return total


def _by_chance(account: Account, start: Account, ledger: Ledger, gate: Gate) -> tuple[Account, list[Fault]]:
    """A random effect last: it explains anything that varies from stop to stop, so nothing smooth may do so."""
    known = {e.id for e in ledger.observations.scenario.effects}
    found: list[Fault] = []
    if "table_index_error" not in known:
        setting = setting_error(account, start, ledger, gate.total)
        if setting is not None:
            account = settle(replace(account, terms=()), ledger)
            found.append(setting[0])
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
    account = settle(account, ledger)
    if not isinstance(observations, TableObservations) or observations.block < 2:
        return account
    observations.bend_at(account.effects)
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


def fill(ledger: Ledger, account: Account, lines: Lines) -> None:
    """Put every suspect on the ledger."""
    observations = ledger.observations
    effects = account.effects
    span = span_of(observations, lines)
    nuisance = [t.suspect for t in account.nuisance]
    for suspect in listed_suspects(observations.scenario, span, nuisance):
        ledger.add(suspect, effects)
    for suspect in step_suspects(observations.scenario, instants(observations)):
        ledger.add(suspect, effects)
    for suspect in curves(observations, span):
        ledger.add(suspect, effects)


def refill(ledger: Ledger, account: Account, known: Lines) -> bool:
    """Put on the ledger what beats in what an account leaves and did not stand out before; whether there is any."""
    observations = ledger.observations
    new = lines_of(ledger, account).beside(known, 1 / float(np.ptp(observations.recordings[0].time)))
    before = len(ledger.suspects)
    for suspect in listed_suspects(observations.scenario, span_of(observations, new), [t.suspect for t in account.nuisance]):
        lines = suspect.effect.values.get("lines")
        if suspect.id in OF_LINES and (lines is None or lines in new.ripples):
            ledger.add(suspect, account.effects)
    return len(ledger.suspects) > before


def instants(observations: Observations) -> list[float]:
    """When a step may have been: at the ends of moves, and all along, s from the first stamp."""
    first = observations.recordings[0]
    span = float(first.time[-1] - first.time[0])
    channel = observations.channels[0]
    edges = channel.time[np.flatnonzero(np.diff((channel.stop >= 0).astype(int)) != 0)] - first.time[0]
    if not 8 <= len(edges) <= MOST_STEPS:
        edges = np.linspace(0, span, 62)[1:-1]
    return [float(t) for t in edges if 0.01 * span < t < 0.99 * span]


def _answer(
    bench: Bench, account: Account, found: Sequence[Finding], chance: Sequence[Fault], told: bool, static: bool = False
) -> Diagnosis:  # fmt: skip
    """Verdict and figures."""
    ledger, observations = bench.ledger, bench.observations
    before = settle(bench.start, ledger)
    first, last = fitness_of(before, ledger), fitness_of(account, ledger)
    faults = [*bench.faults, *chance]
    answer = (*(f.finding() for f in faults), *sorted(found, key=lambda f: f.delta_bic))
    verdict = verdict_of(answer, told)
    source = "taken from the static record" if static else "taken from the recording itself"
    statement = summary(answer, verdict, first.chi2_per_dof, last.chi2_per_dof, source)
    began = as_it_began(account, ledger, noise_under(account, ledger)) if told else account
    amended = amended_of(began, observations, faults)
    notes = [*bench.notes, f"the noise was {source}"]
    left = observations.residuals(account.effects)
    return Diagnosis(
        verdict, statement, answer, tuple(notes), undetectable_of(account, ledger) if told else (), first, last, amended,
        views_of(observations, observations.residuals(before.effects), left),
    )  # fmt: skip


def _simulated(answer: Diagnosis, laboratory: Laboratory, full: Observations, account: Account) -> Diagnosis:
    """The answer with the simulator's word on it."""
    lost = any(e.id == "data_drop" for e in account.effects)  # found by the scan, not mended in the columns
    amended = _as_read(answer.amended, full.scenario, () if lost else ("data_drop",))
    again = resimulate(laboratory, amended, full, full.predict(account.effects))
    return answer if again is None else replace(answer, notes=(*answer.notes, again.words))


def _as_read(amended: Mapping[str, Any], scenario: Scenario, more: Sequence[str]) -> Scenario:
    """The amended scenario without the data faults that were mended in the columns."""
    mended = (*MEANINGS, *MASKED, "data_outlier", "table_index_error", "data_jitter", *more)
    return parse_scenario({**amended, "effect": [e for e in amended["effect"] if e["id"] not in mended]}, scenario.name)
