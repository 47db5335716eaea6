"""A proposal at its best shape: continuous shapes refined, an event at its instant, a curve at its
best resolution or in a localised form.

A curve at other resolutions: how many knots it needs is a shape of it, as a time constant is.

The shape of an effect (time constant, width, lag, instant), refined to where it explains
most.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tiltcal.diagnosis.data.observations import Observations
from tiltcal.diagnosis.hypotheses.coordinate_ranges import over_felt, ranges_of
from tiltcal.diagnosis.hypotheses.curve_forms import STEPS, form_of, proportional, with_form
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis, steps_at
from tiltcal.diagnosis.hypotheses.instants import recording_of
from tiltcal.diagnosis.model.fitted_model import FittedModel, FittedTerm, stored_of
from tiltcal.diagnosis.model.normal_equations import explained_beside
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.explanation import explain, possible
from tiltcal.diagnosis.search.nearest_forms import nearest_forms
from tiltcal.diagnosis.search.state import Proposal
from tiltcal.effects.learned import Learned
from tiltcal.effects.spans import SpectralLines
from tiltcal.effects.timing.delays import DataLatency
from tiltcal.setup.tables import axis_of

OTHERS = (0.6, 1.5, 2.0, 3.0)  # times as many knots
RESOLUTIONS = 2 + len(OTHERS)  # with the first one and the line
MIN_KNOTS = 4  # knots of a curve that has a resolution: one of three is a parabola


def resolutions(hypotheses: Sequence[Hypothesis]) -> Iterator[Hypothesis]:
    """Curves that belong together, in proportion to their coordinate, and with fewer or more knots,
    spaced alike; one resolution after the other.
    """
    curves = [
        (h, h.effect)
        for h in hypotheses
        if isinstance(h.effect, Learned) and len(h.effect.knots) >= MIN_KNOTS
    ]
    yield from (proportional(hypothesis) for hypothesis, _ in curves)
    for factor in OTHERS:
        for hypothesis, effect in curves:
            yield _with_knots(hypothesis, effect, round(factor * len(effect.knots)))


def _with_knots(hypothesis: Hypothesis, effect: Learned, count: int) -> Hypothesis:
    places = np.linspace(0.0, 1.0, count)
    knots = np.interp(places, np.linspace(0.0, 1.0, len(effect.knots)), effect.knots)
    names = tuple(f"c{k}" for k in range(count))
    values = dict.fromkeys(names, hypothesis.size(hypothesis.names[0]))
    finer = replace(effect, knots=tuple(float(k) for k in knots), values=values)
    return replace(hypothesis, effect=finer, names=names)


GRAIN = 4  # halvings of the step between shapes
REFINEMENT_PASSES = 3  # over three shapes and more
FINE = 8  # of an instant, and of a line and its phase: strong ones show a hundredth of their width
LINE = 0.5  # of the width of a line, which is one over the duration
STEP = {
    "time": 4.0,
    "tau": np.log(1.6),
    "width": np.log(1.5),
    "ratio": np.log(1.02),
    "frequency": np.log(1.3),
    "lag": np.log(1.5),
    "play": np.log(1.5),
    "phase": np.pi / 6,
    "early": 1 / 16,
    "period": np.log(1.05),
    "creep": np.log(1.6),
    "crossing": np.log(1.5),
    "place": 0.1,
    "breadth": np.log(4.0),
}
"""From one shape to the next: s for an instant, rad for a phase or a place over a turn, of a period
for the beginning of an oscillation, else relative.
"""
SHIFTED = ("time", "phase", "place", "early")  # by steps that are added
PROMPT = ("creep", "lag")  # at nothing there is none, and nothing to refine


def refined(
    terms: tuple[FittedTerm, ...], fitted: FittedModel, whitened: WhitenedModel
) -> tuple[FittedTerm, ...]:
    """An explanation at its best shape nearby: a continuous shape by halving steps, an instant row
    by row.
    """
    first = terms[0].hypothesis
    duration = _duration(first, whitened)
    pause = first.instant is not None and first.instant.in_pause
    names = list(_shapes_of(terms))
    # of three and more each moves the best of the others
    for name in names * (REFINEMENT_PASSES if len(names) > 2 else 1):
        if pause and name == "time":
            continue
        step = _step(first, name, duration, whitened)
        added = name in SHIFTED or (name == "frequency" and first.line_hz > 0)
        terms = _shaped(terms, name, _shapes_of(terms)[name], whitened)
        limits = _limits(first, name, whitened.hypotheses, duration)
        here = _gain(terms, fitted, whitened)
        for last in reversed(range(FINE if added else GRAIN)):
            x = _shapes_of(terms)[name]
            values = (x + d if added else x * np.exp(d) for d in (-step, step))
            sides = [_shaped(terms, name, np.clip(v, *limits), whitened) for v in values]
            before, after = (_gain(side, fitted, whitened) for side in sides)
            top = 0.0 if last or added else _top(before, here, after)
            if max(before, after) > here:
                terms = sides[int(after > before)]
                here = max(before, after)
            if top:
                at = np.clip(x * np.exp(top * step), *limits)
                terms = _shaped(terms, name, at, whitened)
            step /= 2
    return terms


def _duration(hypothesis: Hypothesis, whitened: WhitenedModel) -> float:
    """Of the recording in which a hypothesis acts, s."""
    recordings = whitened.observations.recordings
    return float(np.ptp(recordings[recording_of(hypothesis.effect, recordings)].time))


def _step(hypothesis: Hypothesis, name: str, duration: float, whitened: WhitenedModel) -> float:
    """From one value of a shape to the next: of a line in time half its width; of the beginning of
    an oscillation a share of its period; of the place of a localised form a share of the range of
    what it follows, of an angle of a turn.
    """
    effect, line = hypothesis.effect, hypothesis.line_hz
    if name == "place" and isinstance(effect, Learned) and axis_of(effect.coordinate) is None:
        of_sensor = effect.coordinate in ("input", "turned")
        own = f"{effect.sensor}_{effect.coordinate}" if of_sensor else effect.coordinate
        low, high = ranges_of(whitened.observations, SpectralLines()).ranges[own]
        return STEP[name] / (2 * np.pi) * (high - low)
    if name == "early":
        return STEP[name] / effect.values["frequency"]
    if line and name == "frequency":
        return LINE / duration
    if line and name == "period":
        return LINE / (line * duration)
    return float(STEP[name])


def _limits(
    hypothesis: Hypothesis, name: str, offered: Sequence[Hypothesis], duration: float
) -> tuple[float, float]:
    """Between which values a shape is refined: an instant within the recording; where it is
    bounded, those that are offered.
    """
    if name == "time":
        return 0.0, duration
    if not any(p.name == name and p.bounded for p in hypothesis.effect.parameters):
        return -np.inf, np.inf
    values = [
        h.effect.values[name]
        for h in offered
        if (h.place, h.alias) == (hypothesis.place, hypothesis.alias)
    ]
    return min(values, default=-np.inf), max(values, default=np.inf)


def _top(before: float, here: float, after: float) -> float:
    """Where the parabola through three gains has its top, in steps from the middle one; 0 where it
    has none between them.
    """
    bend = 2 * here - before - after
    top = (after - before) / (2 * bend) if bend > 0 else 0.0
    return top if abs(top) < 1 else 0.0


def shapes(hypothesis: Hypothesis) -> dict[str, float]:
    """The continuous shapes of a hypothesis; of a curve its lag, the width of its play, its period
    in time or temperature, and where a localised form lies.
    """
    effect = hypothesis.effect
    if isinstance(effect, Learned):
        repeats = effect.period and effect.coordinate in ("time", "since_move", "temperature")
        own = {
            "lag": effect.lag,
            "play": effect.play,
            "period": effect.period if repeats else 0.0,
        }
        return {name: value for name, value in own.items() if value} | form_of(hypothesis)
    return {
        n: v
        for n, v in effect.values.items()
        if n not in hypothesis.names and n in STEP and (n not in PROMPT or v > 0)
    }


def _shapes_of(terms: Sequence[FittedTerm]) -> dict[str, float]:
    """The continuous shapes of an explanation: those of its first term, and how slowly one that
    completes it creeps on.
    """
    creeps = {
        c for t in terms if t.hypothesis.has_instant and (c := shapes(t.hypothesis).get("creep"))
    }
    return shapes(terms[0].hypothesis) | ({"creep": creeps.pop()} if len(creeps) == 1 else {})


def normalise_tone_phase(fitted: FittedModel, observations: Observations) -> FittedModel:
    """The fitted model with tones of positive amplitude: a negative one is half a turn of the
    phase. By hand a sensor that is early is the other one that is late.
    """
    turned: dict[int, Hypothesis] = {}
    terms, signs = [], [1.0 for t in fitted.nuisance for _ in t.names]
    for t in fitted.terms:
        other = (
            _other_way(t.hypothesis, observations)
            if t.values[int(np.argmax(np.abs(t.values)))] < 0
            else None
        )
        if other is not None:
            turned[id(t.hypothesis)] = other
            t = replace(t, hypothesis=other, values=tuple(-v for v in t.values))
        terms.append(replace(t, host=turned.get(id(t.host), t.host)))
        signs += [1.0 if other is None else -1.0] * len(t.names)
    if fitted.covariance is None or not turned:
        return replace(fitted, terms=tuple(terms))
    return replace(
        fitted, terms=tuple(terms), covariance=fitted.covariance * np.outer(signs, signs)
    )


def _other_way(hypothesis: Hypothesis, observations: Observations) -> Hypothesis | None:
    """What does the same with sizes of opposite sign, if anything."""
    phase, scenario = hypothesis.effect.values.get("phase"), observations.scenario
    if phase is not None and "phase" not in hypothesis.names:
        return at_shape(hypothesis, "phase", float(np.angle(-np.exp(1j * phase))))
    if isinstance(hypothesis.effect, DataLatency) and not observations.courses:
        others = [
            s.name for s in scenario.sensors("gyro", "fog") if s.name != hypothesis.effect.sensor
        ]
        if len(others) == 1:
            return replace(hypothesis, effect=replace(hypothesis.effect, sensor=others[0]))
    return None


def _shaped(
    terms: Sequence[FittedTerm], name: str, value: float, whitened: WhitenedModel
) -> tuple[FittedTerm, ...]:
    """An explanation at another shape: one lag or period for all its curves, one instant for all
    its events. A tone keeps its phase at the middle of the recording.
    """
    first = (
        at_shape(terms[0].hypothesis, name, value)
        if name in shapes(terms[0].hypothesis)
        else terms[0].hypothesis
    )
    before = terms[0].hypothesis.effect.values
    if name == "frequency" and "phase" in before:
        middle = _duration(first, whitened) / 2
        shift = 2 * np.pi * (value - before["frequency"]) * middle
        first = at_shape(first, "phase", before["phase"] - shift)
    whole = isinstance(terms[0].hypothesis.effect, Learned) or name == "time"
    family = [
        replace(t, hypothesis=at_shape(t.hypothesis, name, value))
        if (whole and name in shapes(t.hypothesis)) or (name == "creep" and _creeps_on(t, terms))
        else t
        for t in terms[1:]
    ]
    if name == "lag":
        first, *others = (
            over_felt(h, whitened.observations) for h in (first, *(t.hypothesis for t in family))
        )
        family = [replace(t, hypothesis=h) for t, h in zip(family, others, strict=True)]
    return (replace(terms[0], hypothesis=first), *(replace(t, host=first) for t in family))


def _creeps_on(term: FittedTerm, terms: Sequence[FittedTerm]) -> bool:
    """Whether what completes an event creeps on after it as slowly as is refined: parts that creep
    at different paces stay apart.
    """
    return shapes(term.hypothesis).get("creep") == _shapes_of(terms).get("creep")


def at_shape(hypothesis: Hypothesis, name: str, value: float) -> Hypothesis:
    """A hypothesis at another value of a continuous shape."""
    effect = hypothesis.effect
    if name in form_of(hypothesis):
        return with_form(hypothesis, name, float(value))
    if isinstance(effect, Learned):
        changed: dict[str, Any] = {name: float(value)}
        return replace(hypothesis, effect=replace(effect, **changed))
    return replace(hypothesis, effect=replace(effect, values={**effect.values, name: float(value)}))


def _gain(terms: Sequence[FittedTerm], fitted: FittedModel, whitened: WhitenedModel) -> float:
    """What the own form of an explanation gains, beside the columns of the fitted model."""
    whole = isinstance(terms[0].hypothesis.effect, Learned) or terms[0].hypothesis.has_instant
    own = [terms[0], *(t for t in terms[1:] if whole and shapes(t.hypothesis))]
    return explained_beside(stored_of(whitened, own), fitted.basis, fitted.residual)


PASSES = 2  # over the shapes of a localised form: its place and its period depend on each other


def best_shape(proposal: Proposal, fitted: FittedModel, whitened: WhitenedModel) -> Proposal:
    """A proposal at that of its shapes nearby that has the most evidence, less what the choice of
    the shape costs.
    """
    hypothesis = proposal.explanation.hypothesis
    # the curves of one cause have one shape: those on other axes keep with the first
    whole = isinstance(hypothesis.effect, Learned)
    own = proposal.explanation.terms if whole else proposal.explanation.terms[:1]
    terms = refined(own, fitted, whitened)
    others = [refined(start, fitted, whitened) for start in _in_other_kinds(own, whitened)]
    refinements = [r for r in (terms, *others) if r[0].hypothesis is not hypothesis]
    near = [t.hypothesis for r in refinements for t in r]
    if (instant := terms[0].hypothesis.instant) is not None:
        scenario = whitened.observations.scenario
        near += list(steps_at(scenario, instant))
    best = _best([proposal, *in_shapes(proposal, near, fitted, whitened)])
    other = _resolved(proposal, fitted, whitened)
    return _best([best, *other, *_localised(best, fitted, whitened)])


def _in_other_kinds(
    terms: tuple[FittedTerm, ...], whitened: WhitenedModel
) -> Iterator[tuple[FittedTerm, ...]]:
    """An explanation with the other values of shapes that are not continuous, where it has one that
    is: this is best at another value there.
    """
    first = terms[0].hypothesis
    continuous = shapes(first)
    if not first.textbook or not continuous:
        return
    fixed = {
        p.name
        for p in first.effect.parameters
        if p.shape and p.name not in {*continuous, *STEP, *first.names}
    }
    seen = [{name: first.effect.values[name] for name in fixed}]
    for other in whitened.hypotheses:
        if (other.place, other.alias, other.names) == (first.place, first.alias, first.names):
            kind = {name: other.effect.values[name] for name in fixed}
            if kind not in seen:
                seen.append(kind)
                effect = replace(first.effect, values={**first.effect.values, **kind})
                yield (replace(terms[0], hypothesis=replace(first, effect=effect)),)


def _resolved(proposal: Proposal, fitted: FittedModel, whitened: WhitenedModel) -> list[Proposal]:
    """A curve without a name at other resolutions, each a RESOLUTIONS-th as probable as the
    first.
    """
    if proposal.explanation.hypothesis.listed:
        return []
    near = list(resolutions([t.hypothesis for t in proposal.explanation.terms]))
    charged = replace(proposal, log_prior=proposal.log_prior - float(np.log(RESOLUTIONS)))
    return in_shapes(charged, near, fitted, whitened)


def _best(proposals: Iterable[Proposal]) -> Proposal:
    return max(proposals, key=lambda p: p.score)


def in_shapes(
    proposal: Proposal, near: Sequence[Hypothesis], fitted: FittedModel, whitened: WhitenedModel
) -> list[Proposal]:
    """A proposal in other shapes, where they are possible; each with those that complete it."""
    if not near:
        return []
    local, place = whitened.beside(near), proposal.explanation.hypothesis.place
    found = []
    for k in range(len(whitened.hypotheses), len(local.hypotheses)):
        same = local.hypotheses[k].place == place
        told = explain(k, fitted, local) if same else None
        if told is not None and possible(told.terms[0]):
            found.append(Proposal(told, proposal.log_prior))
    return found


def _localised(proposal: Proposal, fitted: FittedModel, whitened: WhitenedModel) -> list[Proposal]:
    """A curve over an angle in its best localised form; nothing for anything else."""
    found = []
    curves = [t.hypothesis for t in proposal.explanation.terms]
    effect = curves[0].effect
    one_of = STEPS if isinstance(effect, Learned) and effect.is_step else 1
    for form in nearest_forms(curves, fitted, whitened):
        charged = replace(
            proposal, log_prior=proposal.log_prior + float(np.log(one_of / form.tried))
        )
        found += in_shapes(charged, form.hypotheses, fitted, whitened)
    if not found:
        return []
    best = _best(found)
    terms = best.explanation.terms
    for _ in range(PASSES):
        terms = refined(terms, fitted, whitened)
    return [best, *in_shapes(best, [t.hypothesis for t in terms], fitted, whitened)]
