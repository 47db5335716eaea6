"""A model in the search: its causes, what they cost, and how one is taken in or out.

A change is worked out to first order. Only a model that is kept is fitted to simulated readings:
``refitted``.

What may explain its residual are the hypotheses of the largest evidence, worked out: ``proposals``.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np

from tiltcal.diagnosis.data_faults.quantisation_limit import above_codes
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.hypotheses.priors import kind
from tiltcal.diagnosis.model.fitted_model import FittedModel, FittedTerm
from tiltcal.diagnosis.model.hypothesis_columns import HypothesisColumns
from tiltcal.diagnosis.model.noise_prior import noise_price
from tiltcal.diagnosis.model.refitting import log_det_information, refit, refit_linearly
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.explanation import Explanation, explained_by, explanation_of, possible
from tiltcal.diagnosis.search.scan import Scan


@dataclass(frozen=True)
class Cause:
    """What the price of a cause depends on beside its terms: its log prior odds, nats, and how many
    columns its deviation may be made of.
    """

    log_prior: float
    tried: int


@dataclass(frozen=True)
class State:
    """A model, its causes in the order of its findings, and their prices, nats.

    Attributes:
        reduced_models: the same without some of the causes, by their numbers, as asked for.
        proposals: what may explain its residual, as a scan says.
    """

    fitted: FittedModel
    whitened: WhitenedModel
    causes: tuple[Cause, ...] = ()
    prices: tuple[float, ...] = ()
    reduced_models: dict[tuple[int, ...], "State"] = field(
        default_factory=dict, init=False, repr=False
    )
    proposals: "WeakKeyDictionary[Scan, list[Proposal]]" = field(
        default_factory=WeakKeyDictionary, init=False, repr=False
    )

    @cached_property
    def cost(self) -> float:
        """-log posterior but for a constant, nats; infinite where a size cannot be, or coarse codes
        would hide a cause.
        """
        every = range(len(self.fitted.findings()))
        if not all(possible(term) for term in self.fitted.terms) or not all(
            above_codes(self.terms(k), self.fitted, self.whitened) for k in every
        ):
            return np.inf
        fit = self.fitted.deviance + self.fitted.penalty + log_det_information(self.fitted)
        return fit / 2 + self.whitened.log_volume + noise_price(self.whitened) + sum(self.prices)

    def terms(self, k: int) -> tuple[FittedTerm, ...]:
        """The terms of the k-th cause."""
        return tuple(self.fitted.terms[i] for i in self.fitted.findings()[k])

    def over(self, columns: HypothesisColumns) -> "State":
        """The same model among other hypotheses."""
        return replace(self, whitened=replace(self.whitened, columns=columns))


@dataclass(frozen=True)
class Doubt:
    """A cause that is more probable than not, and not probable enough to be claimed.

    Args:
        law: the cause; probability: that it is there.
        model: the causes that are claimed and this one; more: what it costs more than these alone,
            nats.
    """

    law: Hypothesis
    probability: float
    model: State
    more: float


@dataclass(frozen=True)
class Proposal:
    """An explanation with its log prior odds, nats: those of one cause more among them."""

    explanation: Explanation
    log_prior: float

    @property
    def score(self) -> float:
        """Log posterior odds against nothing in its place."""
        return self.explanation.evidence + self.log_prior


def laws(fitted: FittedModel) -> list[Hypothesis]:
    """The law of each cause."""
    return [fitted.terms[places[0]].hypothesis for places in fitted.findings()]


def one_cause(one: Hypothesis, other: Hypothesis) -> bool:
    """Whether two hypotheses are one cause at two shapes: an event is one at its own instant."""
    if not one.listed or one.place != other.place:
        return False
    return one.instant == other.instant


def without(state: State, *which: int) -> State:
    """A state without some of its causes."""
    if which in state.reduced_models:
        return state.reduced_models[which]
    places = {i for k in which for i in state.fitted.findings()[k]}
    terms = tuple(t for i, t in enumerate(state.fitted.terms) if i not in places)
    fitted = refit_linearly(state.fitted, terms, state.whitened)
    causes = tuple(c for i, c in enumerate(state.causes) if i not in which)
    prices = tuple(p for i, p in enumerate(state.prices) if i not in which)
    state.reduced_models[which] = State(fitted, state.whitened, causes, prices)
    return state.reduced_models[which]


def with_new(state: State, proposal: Proposal) -> State:
    """A state with one more cause, or with a further shape of one that it has."""
    new = proposal.explanation
    same = [k for k, law in enumerate(laws(state.fitted)) if one_cause(law, new.hypothesis)]
    if same:
        return _with_part(state, same[0], proposal)
    terms = state.fitted.terms + new.terms
    return State(
        refit_linearly(state.fitted, terms, state.whitened),
        state.whitened,
        (*state.causes, Cause(proposal.log_prior, new.tried)),
        (*state.prices, new.price - proposal.log_prior),
    )


def _with_part(state: State, k: int, proposal: Proposal) -> State:
    """A state whose k-th cause has a further shape, one of all that it may have, or further sizes
    at a shape that it has.
    """
    fitted, law = state.fitted, laws(state.fitted)[k]
    places = fitted.findings()[k]
    own = [fitted.terms[i] for i in places]
    for new in proposal.explanation.terms:
        same = [i for i, t in enumerate(own) if t.hypothesis == new.hypothesis]
        if same:
            own[same[0]] = _with_sizes(own[same[0]], new)
        else:
            own.append(replace(new, host=law))
    terms = (*fitted.terms[: places[0]], *own, *fitted.terms[places[-1] + 1 :])
    shapes = (h for h in state.whitened.hypotheses if h is not law and one_cause(h, law))
    tried = max(state.causes[k].tried, sum(len(h.names) for h in shapes))
    causes = [replace(c, tried=tried) if i == k else c for i, c in enumerate(state.causes)]
    fitted = refit_linearly(fitted, terms, state.whitened)
    return _priced(replace(state, fitted=fitted, causes=tuple(causes)))


def _with_sizes(term: FittedTerm, new: FittedTerm) -> FittedTerm:
    """A term with those of another as well."""
    sizes = dict(zip(term.names, term.values, strict=True))
    for name, value in zip(new.names, new.values, strict=True):
        sizes[name] = sizes.get(name, 0.0) + value
    return replace(term, names=tuple(sorted(sizes)), values=tuple(sizes[n] for n in sorted(sizes)))


def with_cause(state: State, k: int, proposal: Proposal) -> State:
    """A state with another explanation in the place of its k-th cause."""
    rest = without(state, k)
    before = sum(len(p) for p in rest.fitted.findings()[:k])
    own = rest.fitted.terms
    terms = (*own[:before], *proposal.explanation.terms, *own[before:])
    cause = Cause(proposal.log_prior, proposal.explanation.tried)
    price = proposal.explanation.price - proposal.log_prior
    return State(
        refit_linearly(rest.fitted, terms, state.whitened),
        state.whitened,
        (*rest.causes[:k], cause, *rest.causes[k:]),
        (*rest.prices[:k], price, *rest.prices[k:]),
    )


def with_terms(state: State, k: int, terms: Sequence[FittedTerm]) -> State:
    """A state with the terms of its k-th cause exchanged, as many as there were."""
    places = state.fitted.findings()[k]
    every = list(state.fitted.terms)
    every[places[0] : places[-1] + 1] = terms
    fitted = refit_linearly(state.fitted, every, state.whitened)
    return _priced(replace(state, fitted=fitted))


def refitted(state: State) -> State:
    """The same state with all values fitted to simulated readings."""
    return replace(state, fitted=refit(state.fitted, state.whitened))


def repriced(state: State, whitened: WhitenedModel) -> State:
    """The same model under another noise."""
    fitted = refit(state.fitted, whitened)
    return _priced(replace(state, fitted=fitted, whitened=whitened))


def _priced(state: State) -> State:
    """A state with the prices of its causes as they are beside each other."""
    fitted, prices = state.fitted, []
    for k, (cause, places) in enumerate(zip(state.causes, fitted.findings(), strict=True)):
        rest = without(state, k).fitted
        terms = [fitted.terms[i] for i in places]
        told = explanation_of(terms, cause.tried, rest, state.whitened)
        prices.append(told.price - cause.log_prior)
    return replace(state, prices=tuple(prices))


LOOKED_AT = 14  # hypotheses of the largest evidence whose deviations are worked out


def proposals(state: State, scan: Scan) -> list[Proposal]:
    """What may explain the residual of a model, best first, each place at its best shape. It is
    kept with the state: several steps of a search ask for it.
    """
    if scan not in state.proposals:
        found = [
            p
            for p in looked_at(state, scan)
            if possible(p.explanation.terms[0])
            and above_codes(p.explanation.terms, state.fitted, state.whitened)
        ]
        state.proposals[scan] = sorted(found, key=lambda p: -p.score)
    return state.proposals[scan]


def looked_at(state: State, scan: Scan, *, listed_only: bool = False) -> list[Proposal]:
    """The hypotheses of the largest evidence, with sizes that cannot be among them.

    Args:
        state: the model.
        scan: under its noise.
        listed_only: whether curves are left out.
    """
    fitted, whitened = state.fitted, state.whitened
    score = scan.log_bayes_factors(fitted) + scan.log_odds
    seen: dict[object, int] = {}
    for k in np.argsort(-score):
        hypothesis = whitened.hypotheses[k]
        if listed_only and not hypothesis.listed:
            continue
        place = (hypothesis.place, hypothesis.alias) if hypothesis.listed else kind(hypothesis)
        seen.setdefault((place, 0 if hypothesis.listed else len(hypothesis.names)), int(k))
        if len(seen) == LOOKED_AT:
            break
    normals = [(k, scan.products.normal_equations(k, fitted)) for k in seen.values()]
    told = [(k, explained_by(normal, fitted, whitened)) for k, normal in normals]
    return [Proposal(t, float(scan.log_odds[k])) for k, t in told if t is not None]
