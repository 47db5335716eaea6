"""What has to be told apart: the explanations that a diagnosis could not choose between, at the
sizes the recordings give them.

Recordings so far with one more beside them: what they changed is worked out once, whatever is
put beside them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Columns, Observations
from tiltcal.diagnosis.data.observe import observe
from tiltcal.diagnosis.data_faults.prepare import prepare
from tiltcal.diagnosis.hypotheses.block_averaging import block_of
from tiltcal.diagnosis.hypotheses.coordinate_ranges import ranges_of
from tiltcal.diagnosis.hypotheses.curves import curves
from tiltcal.diagnosis.hypotheses.families import completes
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis, listed_hypotheses, step_hypotheses
from tiltcal.diagnosis.hypotheses.instants import instants
from tiltcal.diagnosis.hypotheses.priors import UNLISTED
from tiltcal.diagnosis.lines.spectral_lines import spectral_lines_of
from tiltcal.diagnosis.model.channel_noise import models, noise_under
from tiltcal.diagnosis.model.fitted_model import FittedModel, FittedTerm
from tiltcal.diagnosis.model.hypothesis_columns import HypothesisColumns
from tiltcal.diagnosis.model.refitting import refit
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.explanation import Explanation, explain
from tiltcal.effects import CATALOGUE
from tiltcal.effects.base import Effect
from tiltcal.effects.learned import Learned
from tiltcal.effects.parameter import by_name
from tiltcal.effects.spans import SpectralLines
from tiltcal.laboratory.scenario import Scenario, fresh, parse_scenario
from tiltcal.recordings.recording import Recording
from tiltcal.statistics.noise_spectrum import NoiseModel


class Remembering(Observations):
    """Observations that remember how their readings change with each effect.

    Args:
        inner: what was observed.
    """

    def __init__(self, inner: Observations) -> None:
        self.inner = inner
        self.scenario, self.recordings, self.known = inner.scenario, inner.recordings, inner.known
        self.channels, self.stops = inner.channels, inner.stops
        self._kept: dict[str, Columns] = {}

    def predict(self, effects: Sequence[Effect]) -> list[Array]:
        """What each channel should have read. SI, (n,) each."""
        return self.inner.predict(effects)

    def changes(self, effect: Effect, around: Sequence[Effect]) -> Columns:
        """How readings change with a small effect; ``around`` is the same every time."""
        key = repr(effect)
        if key not in self._kept:
            self._kept[key] = self.inner.changes(effect, around)
        return self._kept[key]

    def settings(self, around: Sequence[Effect]) -> list[list[Columns]]:
        """See ``Observations``."""
        return self.inner.settings(around)


class Joined(Observations):
    """Remembered observations and one more recording.

    Args:
        old: what was read so far.
        more: another recording, of the same T0.
        block: samples that are averaged into one.
        reference: T0, degC.
    """

    def __init__(self, old: Remembering, more: Recording, block: int, reference: float) -> None:
        climate = old.scenario.climate.model_copy(update={"reference_degC": reference})
        self.old = old
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
        """How readings change with a small effect."""
        first = len(self.old.channels)
        return self.old.changes(effect, around) | {
            first + i: c for i, c in self.new.changes(effect, around).items()
        }

    def settings(self, around: Sequence[Effect]) -> list[list[Columns]]:
        """See ``Observations``."""
        first = len(self.old.channels)
        late = [
            [{first + i: c for i, c in one.items()} for one in stops]
            for stops in self.new.settings(around)
        ]
        return [*self.old.settings(around), *late]


CURVE = 1e-6  # SI, of a curve's coefficients: any size will do


@dataclass(frozen=True)
class Question:
    """Rivals of one finding, with all that the recordings so far say.

    Args:
        names: ids of the class, the finding's own first.
        fitted: adjustable terms and other findings.
        rivals: one a name: how it would explain the finding.
        hypotheses: the class at all its shapes.
        observations: what was read so far, thinned.
        noise: of each sensor's axis.
        block: rows that were averaged into one.
        reference: T0, degC.
    """

    names: tuple[str, ...]
    fitted: FittedModel
    rivals: tuple[Explanation, ...]
    hypotheses: tuple[Hypothesis, ...]
    observations: Remembering
    noise: Mapping[tuple[str, str], NoiseModel]
    block: int
    reference: float

    def joined(self, more: Recording) -> Joined:
        """The recordings so far with this one."""
        return Joined(self.observations, more, self.block, self.reference)


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
    old = prepared.observations
    lines = spectral_lines_of(old, prepared.start)
    block = block_of(old, lines)
    thin = observe(scenario, old.recordings, old.known, block)
    terms = [_term(e) for e in found]
    stated = {(e.id, e.sensor, e.axis) for e in old.known}
    terms = [
        t
        for t in terms
        if (t.hypothesis.effect.id, t.hypothesis.effect.sensor, t.hypothesis.effect.axis)
        not in stated
    ]
    asked = []
    for finding, names in open_:
        own = _own(terms, finding["effect"], diagnosis)
        if own:
            asked.append(
                _question(names, terms, own, Remembering(thin), prepared.start, block, lines)
            )
    return asked


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
    names: tuple[str, ...],
    terms: Sequence[FittedTerm],
    own: Sequence[int],
    old: Remembering,
    start: FittedModel,
    block: int,
    lines: SpectralLines,
) -> Question:
    columns = HypothesisColumns(old)
    fitted = replace(start, terms=tuple(terms))
    noise = noise_under(fitted, columns)
    whitened = WhitenedModel.of(columns, models(noise))
    fitted = refit(fitted, whitened)
    hypotheses = _hypotheses_of(names, old, [terms[k].hypothesis for k in own], lines)
    for hypothesis in hypotheses:
        columns.add(hypothesis, fitted.effects)
    rest = refit(
        replace(fitted, terms=tuple(t for k, t in enumerate(fitted.terms) if k not in own)),
        whitened,
        rounds=0,
    )
    rivals: dict[str, Explanation] = {}
    for k, hypothesis in enumerate(whitened.hypotheses):
        told = explain(k, rest, whitened)
        if told is None:
            continue
        plain, before = told.plain or told, rivals.get(hypothesis.id)  # as its rivals are weighed
        if before is None or plain.evidence > before.evidence:
            rivals[hypothesis.id] = plain
    by_axis = {(c.sensor, c.axis): f.model for c, f in zip(old.channels, noise, strict=True)}
    ordered = tuple(rivals[n] for n in names if n in rivals)
    reference = old.inner.courses[0].reference if old.inner.courses else 0.0
    return Question(names, rest, ordered, tuple(hypotheses), old, by_axis, block, reference)


def _hypotheses_of(
    names: Sequence[str],
    observations: Observations,
    own: Sequence[Hypothesis],
    lines: SpectralLines,
) -> list[Hypothesis]:
    """The class at all its shapes; a name without a textbook form only where the finding itself has
    it.
    """
    scenario = observations.scenario
    span = ranges_of(observations, lines)
    own_instants = dict.fromkeys(s.instant for s in own if s.instant is not None)
    times = list(own_instants) or instants(observations)[::4]
    every = chain(
        own,
        listed_hypotheses(scenario, span),
        step_hypotheses(scenario, times),
        curves(observations, span),
    )
    return [s for s in every if s.id in names and (s.textbook or s.id == names[0])]
