"""The set of causes of the largest posterior probability.

The cost of a model is -log posterior: half the deviance, the logarithm of the noise, which is
estimated under each model, the price of the numbers of each cause, and its prior. Causes are added,
exchanged and dropped as long as that lowers it (a stochastic-search neighbourhood taken in full:
Hans, Dobra and West, J. Am. Stat. Assoc. 102, 2007), from several starts of the noise.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.hypotheses.priors import kind
from tiltcal.diagnosis.model.channel_noise import (
    models,
    noise_within_stops,
    white_of_differences,
)
from tiltcal.diagnosis.model.finding_tests import NoiseSource
from tiltcal.diagnosis.model.fitted_model import FittedModel, FittedTerm
from tiltcal.diagnosis.model.refitting import refit, refit_linearly
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.best_shape import best_shape, refined
from tiltcal.diagnosis.search.scan import Scan
from tiltcal.diagnosis.search.state import (
    Proposal,
    State,
    laws,
    proposals,
    refitted,
    repriced,
    with_new,
    with_terms,
    without,
)
from tiltcal.effects.learned import Learned

AHEAD = 5  # of them after which the next cause is looked for
HALF = 0.5  # of the best score, or of what is needed: what has less is not looked at further
MOST = 5  # causes
ROUNDS = 4  # of search and noise
SETTLED = 0.1  # nats: less is not worth another round

Visit = tuple[list[object], float]
"""The causes of a model under the noise that it leaves, and its cost, nats."""


def most_probable(
    start: FittedModel,
    whitened: WhitenedModel,
    noise_source: NoiseSource,
    found: Callable[[int], None] = lambda _: None,
) -> State:
    """The model of the least cost, from the noise of a model without causes, from white noise
    alone, and from the noise within the stops, until two of these come to the same model.

    Args:
        start: the calibrated scenario.
        whitened: all hypotheses.
        noise_source: the noise under a model.
        found: is told the number of causes of the best model so far.
    """
    nothing = noise_source.left_by(start, whitened)
    best, visited = State(refit(start, nothing), nothing), list[Visit]()
    ends: list[Visit] = []
    for first in _starts(best, noise_source):
        state = iterate_to_convergence(State(refit(start, first), first), noise_source, visited)
        if state.cost < best.cost:
            best = state
        found(len(best.causes))
        if _is_among(state, ends):
            break
        ends.append((_names(state), state.cost))
    return best


def _starts(null: State, noise_source: NoiseSource) -> Iterator[WhitenedModel]:
    yield null.whitened
    if noise_source.static is None:
        yield null.whitened.under(white_of_differences(null.fitted, null.whitened.observations))
        if (still := noise_within_stops(null.fitted, null.whitened)) is not None:
            yield null.whitened.under(models(still))


def iterate_to_convergence(
    state: State, noise_source: NoiseSource, visited: list[Visit] | None = None
) -> State:
    """Search and noise in turn, until neither changes the other; never a model that costs more.

    Args:
        state: to begin with.
        noise_source: the noise under a model.
        visited: models that a search went on from; they are added to.
    """
    best, visited = state if state.fitted.terms else None, [] if visited is None else visited
    earlier = list(visited)
    for _ in range(ROUNDS):
        before = _names(state)
        state = local_search(state)
        if not state.fitted.terms:
            break
        state = repriced(state, noise_source.left_by(state.fitted, state.whitened))
        if best is None or state.cost < best.cost:
            best = state
        visited.append((_names(state), state.cost))
        if _is_among(state, visited[:-1]) or _names(state) == before:
            break
    best = best or repriced(state, noise_source.left_by(state.fitted, state.whitened))
    return best if _is_among(best, earlier) else _dropped(best, noise_source)


def _is_among(state: State, visited: Sequence[Visit]) -> bool:
    """Whether a search has come to this model before."""
    names, cost = _names(state), state.cost
    return any(n == names and (c == cost or abs(c - cost) < SETTLED) for n, c in visited)


def _dropped(state: State, noise_source: NoiseSource) -> State:
    """A state without the causes that cost more than the noise that takes their place: from a noise
    with too little slow noise on all channels, one for each is found.
    """
    while state.causes:
        rests = [refitted(without(state, k)) for k in range(len(state.causes))]
        fewer = [repriced(s, noise_source.left_by(s.fitted, s.whitened)) for s in rests]
        least = min(fewer, key=lambda s: s.cost)
        if not least.cost < state.cost:
            break
        state = least
    return state


def _names(state: State) -> list[object]:
    return [_place(law) for law in laws(state.fitted)]


def _place(hypothesis: Hypothesis) -> object:
    """Where a name is; of a curve where it acts, as an addition or a scale factor, and what it
    follows, at once or late.
    """
    effect = hypothesis.effect
    if hypothesis.listed or not isinstance(effect, Learned):
        return hypothesis.place
    return kind(hypothesis), effect.per_input, effect.lag > 0, effect.relaxing, effect.power


def local_search(state: State) -> State:
    """Causes exchanged, merged, split and added under one noise, until nothing lowers the cost, or
    it comes back to causes that it had.
    """
    scan, newest, visited = Scan(state.whitened), -1, list[list[object]]()
    while True:
        state = _each_exchanged(state, newest, scan)
        count = len(state.fitted.findings())
        if count < MOST and (kept := _with_one_more(state, state, scan)) is not state:
            newest, state = count, kept
            continue
        if (names := _names(state)) in visited:
            return state
        visited.append(names)
        if (other := _merged(state, scan)) is state:
            other = _split(_all_reshaped(state), scan)
        if not other.cost < state.cost - SETTLED:
            return state
        newest, state = -1, other


def _each_exchanged(state: State, newest: int, scan: Scan) -> State:
    """A state with every cause but the newest exchanged, where that costs less."""
    for k in reversed(range(len(state.fitted.findings()))):
        if k != newest and k < len(state.fitted.findings()):
            state = _exchanged(state, [k], scan)
    return state


def _all_reshaped(state: State) -> State:
    """A state with the shapes of its causes refined again, beside the others."""
    for k in range(len(state.causes)):
        rest = without(state, k).fitted
        terms = state.terms(k)
        new = refined(terms, rest, state.whitened)
        if any(a.hypothesis is not b.hypothesis for a, b in zip(terms, new, strict=True)):
            other = with_terms(state, k, new)
            state = _cheaper(other, state)
    return state


def _cheaper(other: State, state: State) -> State:
    """Another state, refitted, where it costs less; else the state."""
    if not other.cost < state.cost:
        return state
    other = refitted(other)
    return other if other.cost < state.cost else state


def _split(state: State, scan: Scan) -> State:
    """A state with two causes in place of one, where that costs less."""
    if len(state.causes) >= MOST:
        return state
    for k in range(len(state.causes)):
        rest, mine = without(state, k), laws(state.fitted)[k]
        found = proposals(rest, scan)
        others = [p for p in found if _place(p.explanation.hypothesis) != _place(mine)]
        # the deviation of one would take the place of the other
        rivals = [replace(p, explanation=p.explanation.plain or p.explanation) for p in others]
        rivals = _rivals(sorted(rivals, key=lambda p: -p.score))
        if not rivals:
            continue
        first = with_new(rest, _ahead(rivals, rest, scan)[0])
        if (kept := _with_one_more(first, state, scan)) is not state:
            return kept
    return state


def _rivals(found: Sequence[Proposal], needed: float = 0.0) -> list[Proposal]:
    """The best proposal of every name, and the best curve, of those that are not far below the best
    and what is needed.
    """
    rivals: dict[str, Proposal] = {}
    for p in found:
        if p.score > HALF * max(found[0].score, needed) > 0:
            rivals.setdefault(p.explanation.hypothesis.id, p)
    return list(rivals.values())[:AHEAD]


def _merged(state: State, scan: Scan) -> State:
    """A state with one cause in place of two, where that costs less."""
    for pair in combinations(range(len(state.fitted.findings())), 2):
        other = _exchanged(state, pair, scan)
        if other is not state:
            return _merged(other, scan)
    return state


def _with_one_more(state: State, least: State, scan: Scan) -> State:
    """One cause more than in a state, where that costs less than another does; else the other. It
    is that after which, with the best next one, the cost is least, of those whose refits say so.
    """
    found = [p for p in proposals(state, scan) if p.score > 0]
    rivals = _shaped(_rivals(found), state)
    for proposal in _ahead(rivals, state, scan):
        if (kept := _cheaper(with_new(state, proposal), least)) is not least:
            return kept
    return least


def _shaped(found: Sequence[Proposal], state: State) -> list[Proposal]:
    """Proposals at their best shapes: on a grid of dates or periods a law of many shapes compares
    worse than it is.
    """
    return [best_shape(p, state.fitted, state.whitened) for p in found]


def _ahead(rivals: Sequence[Proposal], state: State, scan: Scan) -> list[Proposal]:
    """Proposals in order of their scores with those of the best that may follow each."""
    if len(rivals) < 2:
        return list(rivals)
    fitted = state.fitted
    trials = [
        refit_linearly(fitted, fitted.terms + p.explanation.terms, state.whitened) for p in rivals
    ]
    scan.products.prepare(trials)
    follow = [float((scan.log_bayes_factors(t) + scan.log_odds).max()) for t in trials]
    scores = [p.score + max(f, 0.0) for p, f in zip(rivals, follow, strict=True)]
    return [rivals[k] for k in np.argsort(-np.array(scores))]


def _exchanged(state: State, which: Sequence[int], scan: Scan) -> State:
    """A state with some causes exchanged for one, or left out, where that costs less."""
    rest = without(state, *which)
    if (kept := _cheaper(rest, state)) is not state:
        return kept
    found = proposals(rest, scan)
    mine = [_use(term) for k in which for term in state.terms(k)]
    if not found or mine == [_use(t) for t in found[0].explanation.terms]:
        return state
    can_be = np.isfinite(state.cost)  # anything costs less than a size that cannot be
    rivals = _rivals(found, rest.cost - state.cost if can_be else 0.0)
    if not rivals:
        return state
    best = max(_shaped(rivals, rest), key=lambda p: p.score)
    return _cheaper(with_new(rest, best), state)


def _use(law: FittedTerm) -> tuple[object, ...]:
    """The place of a law and which of its sizes are in use."""
    return _place(law.hypothesis), set(law.names)
