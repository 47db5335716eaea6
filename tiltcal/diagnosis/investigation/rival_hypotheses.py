"""What has to be told apart: the explanations that a diagnosis could not choose between, at the
sizes the recordings give them.

Recordings so far with one more beside them: what they changed is worked out once, whatever is
put beside them.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Columns, CurveFactors, Observations
from tiltcal.diagnosis.data.observe import observe
from tiltcal.diagnosis.data_faults.prepare import averaged_blocks, prepare
from tiltcal.diagnosis.hypotheses.block_averaging import block_of
from tiltcal.diagnosis.hypotheses.families import completes
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.hypotheses.priors import UNLISTED
from tiltcal.diagnosis.lines.spectral_lines import spectral_lines_of
from tiltcal.diagnosis.model.channel_noise import models, noise_under
from tiltcal.diagnosis.model.fitted_model import FittedModel, FittedTerm
from tiltcal.diagnosis.model.refitting import refit, refit_linearly
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.best_shape import at_shape, shapes
from tiltcal.diagnosis.search.candidates import LEAST, coarsened
from tiltcal.diagnosis.search.dictionary import build_dictionary
from tiltcal.diagnosis.search.explanation import possible
from tiltcal.diagnosis.search.scan import Scan
from tiltcal.diagnosis.search.state import State, looked_at
from tiltcal.effects import CATALOGUE
from tiltcal.effects.base import Effect
from tiltcal.effects.learned import Learned
from tiltcal.effects.parameter import by_name
from tiltcal.laboratory.scenario import Scenario, fresh, parse_scenario
from tiltcal.recordings.recording import Recording
from tiltcal.statistics.noise_spectrum import NoiseModel

Part = TypeVar("Part")


class Joined(Observations):
    """The recordings so far and one more.

    Args:
        old: what was read so far.
        kept: how that changes with each effect, and with each curve as factors; it is added to.
        more: another recording, of the same T0.
        block: samples that are averaged into one.
    """

    def __init__(
        self, old: Observations, kept: dict[str, Any], more: Recording, block: int
    ) -> None:
        reference = old.courses[0].reference if old.courses else 0.0
        climate = old.scenario.climate.model_copy(update={"reference_degC": reference})
        self.old, self.kept = old, kept
        self.new = observe(fresh(old.scenario, climate=climate), [more], old.known, block)
        self.scenario, self.known = old.scenario, old.known
        self.recordings = (*old.recordings, more)
        late = tuple(replace(c, recording=len(old.recordings)) for c in self.new.channels)
        self.channels = (*old.channels, *late)
        self.stops = [*old.stops, *self.new.stops]

    def predict(self, effects: Sequence[Effect]) -> list[Array]:
        """What each channel should have read. SI, (n,) each."""
        return [*self.old.predict(effects), *self.new.predict(effects)]

    def changes(self, effect: Effect, around: Sequence[Effect]) -> Columns:
        """How readings change with a small effect; ``around`` is the same every time."""
        key = repr(effect)
        if key not in self.kept:
            self.kept[key] = self.old.changes(effect, around)
        return self.kept[key] | self._late(self.new.changes(effect, around))

    def factors(
        self, effect: Effect, names: Sequence[str], around: Sequence[Effect]
    ) -> dict[int, CurveFactors] | None:
        """The same of a curve, as factors."""
        key = repr((effect, names))
        if key not in self.kept:
            self.kept[key] = self.old.factors(effect, names, around)
        new = self.new.factors(effect, names, around)
        return None if self.kept[key] is None or new is None else self.kept[key] | self._late(new)

    def settings(self, around: Sequence[Effect]) -> list[list[Columns]]:
        """See ``Observations``."""
        late = self.new.settings(around)
        return [*self.old.settings(around), *([self._late(c) for c in stops] for stops in late)]

    def _late(self, columns: Mapping[int, Part]) -> dict[int, Part]:
        """What channels of the further recording have, by their numbers here."""
        return {len(self.old.channels) + i: c for i, c in columns.items()}


CURVE = 1e-6  # SI, of a curve's coefficients: any size will do


@dataclass(frozen=True)
class Rival:
    """A name that may be the cause.

    Args:
        name: catalogue id; probability: of it, by the diagnosis.
        terms: its textbook form at its best shape; fitted: the model of the recordings so far with
            it, where its sizes are.
    """

    name: str
    probability: float
    terms: tuple[FittedTerm, ...]
    fitted: FittedModel


TIME_CONSTANTS = np.geomspace(1.0, 1e4, 41)  # s, of bodies on a table; a factor of 1.26 apart


def as_a_body(time: Array, temperature: Array) -> Callable[[Array], Array]:
    """A course of temperature that goes on as a body comes to its room's (Newton's law of cooling),
    with the time constant that fits best; degC at s.

    Args:
        time: s, (n,) from 0.
        temperature: degC, (n,).
    """

    def basis(tau: float, at: Array) -> Array:
        return np.column_stack([np.ones_like(at), -np.expm1(-at / tau)])

    fits = [np.linalg.lstsq(basis(tau, time), temperature, rcond=None) for tau in TIME_CONSTANTS]
    best = min(range(len(fits)), key=lambda k: float(np.sum(fits[k][1])))
    tau, values = TIME_CONSTANTS[best], fits[best][0]
    end = temperature[-1] - (basis(tau, time[-1:]) @ values)[0]

    def course(at: Array) -> Array:
        known = np.interp(at, time, temperature)
        return np.where(at <= time[-1], known, basis(tau, at) @ values + end)

    return course


@dataclass(frozen=True)
class Question:
    """Rivals of one finding, with all that the recordings so far say.

    Args:
        names: ids of the class, the finding's own first.
        unlisted: probability that it is none of the catalogue.
        rest: the model of the recordings so far without the finding.
        rivals: one a name.
        hypotheses: what may stand in the finding's place, with what completes it; log_odds: prior
            odds of each, nats; width: number of columns of all that a diagnosis searches.
        observations: what was read so far, thinned; kept: how that changes with effects.
        noise: of each sensor's axis.
        block: rows that were averaged into one.
    """

    names: tuple[str, ...]
    unlisted: float
    rest: FittedModel
    rivals: tuple[Rival, ...]
    hypotheses: tuple[Hypothesis, ...]
    log_odds: tuple[float, ...]
    width: int
    observations: Observations
    noise: Mapping[tuple[str, str], NoiseModel]
    block: int
    kept: dict[str, Any] = field(default_factory=dict)

    @cached_property
    def course(self) -> Callable[[Array], Array] | None:
        """Temperature, degC, (n,), at times since the start of a further recording, s, (n,): as in
        the last one, and on as a body's; None where it was not recorded.
        """
        last = self.observations.recordings[-1]
        temperature = last.temperature()
        return None if temperature is None else as_a_body(last.time - last.time[0], temperature)

    def joined(self, more: Recording) -> Joined:
        """The recordings so far with this one."""
        return Joined(self.observations, self.kept, more, self.block)


def questions(
    scenario: Scenario,
    recordings: Sequence[Recording],
    diagnosis: Mapping[str, Any],
    amended: Mapping[str, Any],
) -> list[Question]:
    """One question for each finding with more than one name that a model can speak for.

    Args:
        scenario: as the diagnosis had it.
        recordings: that were diagnosed.
        diagnosis: the table of diagnosis.json.
        amended: that of amended.toml.
    """
    classes = [tuple(n for n in f["class"] if n != UNLISTED) for f in diagnosis["findings"]]
    open_ = [(f, c) for f, c in zip(diagnosis["findings"], classes, strict=True) if len(c) > 1]
    found = [e for e in parse_scenario(dict(amended), "amended.toml").effects if e.role == "found"]
    if not open_ or not found or not scenario.rig.axes:
        return []
    prepared = prepare(scenario, recordings)
    lines = spectral_lines_of(prepared.observations, prepared.start)
    block = block_of(prepared.observations, lines)
    prepared = averaged_blocks(prepared, block)
    terms = [_term(e) for e in found]
    stated = {(e.id, e.sensor, e.axis) for e in prepared.observations.known}
    terms = [t for t in terms if t.hypothesis.place not in stated]
    owns = [(f, c, _own(terms, f["effect"], diagnosis)) for f, c in open_]
    if not any(own for _, _, own in owns):
        return []
    build_dictionary(prepared.whitened, prepared.start, lines)
    model = replace(prepared.start, terms=tuple(terms))
    noise = noise_under(model, prepared.whitened.columns)
    whitened = prepared.whitened.under(models(noise))
    model = refit(model, whitened)
    return [_question(f, c, model, own, whitened, block) for f, c, own in owns if own]


def _term(effect: Effect) -> FittedTerm:
    """A found effect as a fitted term of a hypothesis of plausible size."""
    parameters = by_name(effect.parameters).items()
    sizes = {n: p.plausible[1] * p.factor for n, p in parameters if not p.is_shape}
    names = tuple(n for n, v in effect.sizes.items() if v)
    plausible = {n: CURVE if isinstance(effect, Learned) else sizes[n] for n in names}
    plain = replace(effect, values={**effect.values, **plausible}, sigmas={})
    return FittedTerm(Hypothesis(plain, names), names, tuple(effect.values[n] for n in names))


def _own(terms: Sequence[FittedTerm], id: str, diagnosis: Mapping[str, Any]) -> list[int]:
    """Places of the terms of a finding: its effect with what completes it, or the curves of a law
    without a form.
    """
    hosts = [k for k, t in enumerate(terms) if t.hypothesis.id == id]
    if not hosts:
        others = {f["effect"] for f in diagnosis["findings"]}
        return [
            k
            for k, t in enumerate(terms)
            if isinstance(t.hypothesis.effect, Learned) and id in others - set(CATALOGUE)
        ] or [k for k, t in enumerate(terms) if isinstance(t.hypothesis.effect, Learned)]
    return [
        k
        for k, t in enumerate(terms)
        if k in hosts or any(completes(t.hypothesis, terms[h].hypothesis) for h in hosts)
    ]


def _question(
    finding: Mapping[str, Any],
    names: tuple[str, ...],
    model: FittedModel,
    own: Sequence[int],
    whitened: WhitenedModel,
    block: int,
) -> Question:
    """What is asked of a finding.

    Args:
        finding: of diagnosis.json; names: of its class.
        model: with all findings; own: places of its terms.
        whitened: the columns of all hypotheses under the noise that the model leaves.
        block: rows that were averaged into one.
    """
    old, width = whitened.observations, whitened.columns.width
    rest = refit_linearly(model, [t for k, t in enumerate(model.terms) if k not in own], whitened)
    odds = Scan(whitened).log_odds.tolist()
    law = model.terms[own[0]].hypothesis
    alike = [k for k, h in enumerate(whitened.hypotheses) if h.listed and h.place == law.place]
    if alike and (refined := shapes(law)):
        best = max(alike, key=lambda k: odds[k])
        mine = whitened.hypotheses[best]
        for name, value in refined.items():
            mine = at_shape(mine, name, value)
        whitened, odds = whitened.beside([mine]), [*odds, odds[best]]
    scan = Scan(whitened, (np.array(odds), width))
    kept = _in_play(names, rest, whitened, scan)
    chances = finding.get("names") or dict.fromkeys(names, 1 / len(names))
    rivals = list[Rival]()
    for told in (p.explanation for p in looked_at(State(rest, whitened), scan, listed_only=True)):
        name, new = told.hypothesis.id, not any(r.name == told.hypothesis.id for r in rivals)
        if new and name in names and possible(told.terms[0]):
            fitted = refit(replace(rest, terms=(*rest.terms, told.terms[0])), whitened)
            rivals.append(Rival(name, chances.get(name, 0.0), fitted.terms[-1:], fitted))
    return Question(
        names,
        chances.get(UNLISTED, 0.0),
        rest,
        tuple(rivals),
        tuple(whitened.hypotheses[k] for k in kept),
        tuple(float(scan.log_odds[k]) for k in kept),
        width,
        old,
        {(c.sensor, c.axis): m for c, m in zip(old.channels, whitened.noise, strict=True)},
        block,
    )


def _in_play(
    names: Sequence[str], rest: FittedModel, whitened: WhitenedModel, scan: Scan
) -> list[int]:
    """Numbers of the hypotheses of a class, of all that the recordings so far leave as probable as
    what a diagnosis shows, and of what completes either.
    """
    fine = scan.log_bayes_factors(rest)
    score = scan.log_bayes_factors(rest, coarsened(2 * float(fine.max()))) + scan.log_odds
    every = whitened.hypotheses
    chosen = {k for k, h in enumerate(every) if h.id in names and (h.textbook or h.id == names[0])}
    chosen |= set(np.flatnonzero(score > score.max() + np.log(LEAST)).tolist())
    return sorted(chosen.union(*(whitened.columns.family(k) for k in chosen)))
