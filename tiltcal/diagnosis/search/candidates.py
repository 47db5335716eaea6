"""What may stand in the place of a cause: every candidate with its posterior odds, among the listed
names and as a hypothesis that no list has, and from these the probability of every name, and of
none.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.special import logsumexp, ndtr

from tiltcal.design.identifiability import SEPARABLE
from tiltcal.diagnosis.hypotheses import priors
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis, steps_at
from tiltcal.diagnosis.hypotheses.priors import UNLISTED
from tiltcal.diagnosis.model.fitted_model import FittedTerm, summed
from tiltcal.diagnosis.search.best_shape import at_shape, best_shape, in_shapes, shapes
from tiltcal.diagnosis.search.curve_misfit import (
    energy_beside,
    misfit_odds,
    of_other_kind,
)
from tiltcal.diagnosis.search.explanation import (
    Explanation,
    explain,
    explained_by,
    explanation_of,
    local_level,
    possible,
)
from tiltcal.diagnosis.search.scan import Scan
from tiltcal.diagnosis.search.state import (
    Proposal,
    State,
    laws,
    looked_at,
    refitted,
    with_cause,
    without,
)

LEAST = 1e-4  # probability of a name that is shown


CREDIBLE = 0.9  # of a class: one that lacks the cause costs nine times as much as one name more


SHOWN = 8  # rivals


FAR, STEPS = 8.0, 2000  # sigma beyond what is hidden, and steps of the integral over what is not


COARSE = 3000.0
"""Nats of a law at which the data count half: what is known of its form is no better (coarsened
posterior: Miller and Dunson, J. Am. Stat. Assoc. 114, 2019).
"""


TAKEN, TWICE, LISTED_TWICE = 0.15, 0.27, 0.024
"""Share of the laws that no list has and that a name is taken for; of these laws, and of listed
ones, the share whose name stands in the model more than once. ``docs/diagnosis_model.md`` says how
they were learnt.
"""


AGAIN = float(priors.UNLISTED_ODDS + np.log(TAKEN * TWICE / LISTED_TWICE))
"""Log odds of a cause outside the catalogue, of which a name explains a share and the same name the
remainder, to causes of that name.
"""


@dataclass(frozen=True)
class Names:
    """What a cause may be.

    Args:
        probability: of each name, ``unlisted`` for none of the catalogue; they sum to one.
        alike: names that the recording cannot tell from the most probable one, which is the first:
            those that explain as much, in their textbook forms where it does so in its own, and
            those that a class of CREDIBLE probability needs; none where that is no name of the
            catalogue.
        in_doubt: whether such a class needs ``unlisted`` beside them.
        perhaps: where none of the catalogue is the most probable, the names that a class of
            CREDIBLE probability needs beside it.
        rivals: (name, cosine, separation) of the nearest names, the most probable first, each
            against the stated one: the multiple correlation of its fit with what that explains, and
            twice the nats that it lacks, as the class has it.
        late: whether no curve over the temperature of now explains it.
    """

    probability: Mapping[str, float]
    alike: tuple[str, ...]
    rivals: tuple[tuple[str, float, float], ...]
    late: bool = False
    in_doubt: bool = False
    perhaps: tuple[str, ...] = ()

    @property
    def members(self) -> tuple[str, ...]:
        """The class: the names that are alike, and ``unlisted`` where that is needed."""
        return (*self.alike, *((UNLISTED,) if self.in_doubt else ()))

    @property
    def listed(self) -> bool:
        """Whether a name of the catalogue is more probable than none of them."""
        return self.probability.get(UNLISTED, 0.0) <= 0.5


@dataclass(frozen=True)
class Candidate:
    """An explanation in a cause's place: log posterior odds and evidence, nats; gain, the fall of
    the deviance.

    coarse_evidence: where the likelihood is coarsened, nats.
    deviation: part of the evidence that the deviation of its form from the textbook's adds, nats.
    textbook_gain: of its textbook form alone; none where it has no such form, or not at
        sizes that its prior allows.

    misfit: whether it is what the nameless causes leave of their laws.
    partial: whether it is the share of a cause without a name that a listed form explains.
    """

    name: str
    score: float
    evidence: float
    coarse_evidence: float
    gain: float
    proposal: Proposal | None = None
    deviation: float = 0.0
    textbook_gain: float = -np.inf
    misfit: bool = False
    partial: bool = False

    @property
    def plain_evidence(self) -> float:
        """Evidence for its textbook form, nats."""
        return self.evidence - self.deviation

    @property
    def coarse_score(self) -> float:
        """Log posterior odds where the likelihood is coarsened; the prior is not."""
        return self.score - self.evidence + self.coarse_evidence


def imitation_odds(gain: float, columns: int) -> float:
    """Log odds of a cause outside the catalogue, of which a name explains a share, to a cause of
    that name, where nothing else is found; nats.

    Every share is as probable as another. The rest is one direction among many: up to the energy of
    the largest noise among them it is more likely missed than seen (Ingster, Math. Methods Statist.
    6, 1997: the limit of detection of one direction among many).

    Args:
        gain: what the name explains, fall of the deviance.
        columns: directions in which the rest would be looked for.
    """
    gain, limit = max(gain, LEAST), np.sqrt(2 * np.log(max(columns, 2)))
    signal = np.linspace(0.0, limit + FAR, STEPS)  # square root of the energy of the rest
    missed = ndtr(limit - signal)
    share = 2 * signal * gain / (gain + signal**2) ** 2  # density of the rest's share, by signal
    unseen = float(np.trapezoid(missed * share, signal))
    return priors.UNLISTED_ODDS + float(np.log(min(unseen, 1.0)))


def coarsened(gain: float) -> float:
    """By how much less a difference says where a law explains this much: the larger a law, the more
    it deviates from every form that was tried. gain: fall of the deviance.
    """
    return 1 + gain / (2 * COARSE)


def name_probabilities(rows: Sequence[Candidate]) -> Names:
    """Probabilities under the coarsened posterior."""
    score = {
        name: float(logsumexp([r.coarse_score for r in rows if r.name == name]))
        for name in {r.name for r in rows}
    }
    whole = logsumexp(list(score.values()))
    order = sorted(score, key=lambda name: -score[name])
    chance = {n: float(np.exp(score[n] - whole)) for n in order}
    shown = {n: p for n, p in chance.items() if p > LEAST}
    best = {n: max((r for r in rows if r.name == n), key=lambda r: r.evidence) for n in order}
    first = next((n for n in order if n != UNLISTED), "")
    as_good = {r.name for r in rows if first and _behind(r, best[first]) < SEPARABLE / 2}
    near = [n for n in order if n not in (first, UNLISTED) and n in as_good]
    more = _needed(chance, {first, *near})
    in_doubt = UNLISTED in more
    near += [n for n in more if n != UNLISTED]
    perhaps: list[str] = []
    if chance.get(UNLISTED, 0.0) > 0.5:
        near, first, in_doubt = [], "", False
        perhaps = _needed(chance, {UNLISTED})
    stated = best[first] if first else max(rows, key=lambda r: r.score)
    rivals = [n for n in order if n not in (first, UNLISTED) and best[n].gain][:SHOWN]
    return Names(
        shown,
        (first, *near) if first else (),
        tuple(
            (
                n,
                float(np.sqrt(min(best[n].gain / stated.gain, 1.0))) if stated.gain > 0 else 0.0,
                2 * max(min(_behind(r, stated) for r in rows if r.name == n), 0.0),
            )
            for n in rivals
        ),
        in_doubt=in_doubt,
        perhaps=tuple(perhaps),
    )


def _behind(row: Candidate, first: Candidate) -> float:
    """How much less a row explains than the first one, nats: by their evidence, in textbook form
    where the first has that; or by the fit of its textbook form, however many sizes that takes,
    where the first was fitted.
    """
    evidence = row.evidence if first.deviation else row.plain_evidence
    behind = first.evidence - evidence
    return min(behind, (first.gain - row.textbook_gain) / 2) if first.gain > 0 else behind


def _needed(chance: Mapping[str, float], alike: Collection[str]) -> list[str]:
    """The fewest names that hold the cause with a probability of CREDIBLE beside others.

    Args:
        chance: of each name, the most probable first; alike: the others.
    """
    held, found = sum(p for n, p in chance.items() if n in alike), []
    for name, p in chance.items():
        if held < CREDIBLE and name not in alike:
            found.append(name)
            held += p
    return found


def of_other_source(rows: Sequence[Candidate], law: Hypothesis) -> Iterator[Candidate]:
    """What is listed in a cause's place and whose shape tells its source, such as the frequency of
    a tone, as a law of that shape from a source that no list has. It acts on the same channels
    alike, which no curve of one channel does.

    Args:
        rows: in the cause's place; law: of the first of them.
    """
    curves = [r for r in rows if r.name == UNLISTED and r.proposal is not None]
    if not curves:
        return
    curve = max(curves, key=lambda r: r.score)
    other = priors.UNLISTED_ODDS
    for k, row in enumerate(rows):
        source = law if k == 0 else row.proposal and row.proposal.explanation.hypothesis
        if source and source.listed and source.log_odds:
            score = row.score - source.log_odds + other
            yield replace(row, name=UNLISTED, score=score, proposal=curve.proposal)


def of_any_form(
    rows: Sequence[Candidate], own: Explanation, rest: State, scan: Scan, coarse: float
) -> Iterator[Candidate]:
    """What is listed in a cause's place and has a curve of any form, as such a curve without a
    name: it is as probable there as a nameless curve over the same coordinate.

    Args:
        rows: in the cause's place; own: the explanation of the first of them.
        rest: the other causes; scan: of the hypotheses.
        coarse: the likelihood is raised to the power 1/coarse.
    """
    nameless = {
        priors.kind(h): float(odds)
        for h, odds in zip(rest.whitened.hypotheses, scan.log_odds, strict=True)
        if not h.listed
    }
    for _, told in _named(rows, own):
        curves = [t for t in told.terms if _is_of_any_form(t.hypothesis)]
        law = _led_by_curve(told, curves, rest) if curves else told
        if curves and (odds := nameless.get(priors.kind(law.hypothesis))) is not None:
            yield row_of(law, odds, coarse, Proposal(law, odds))


def completed(
    rows: Sequence[Candidate], own: Explanation, rest: State, coarse: float
) -> Iterator[Candidate]:
    """What is listed in a cause's place and completed by nameless curves, as a law that no list
    has: the name explains any share of it.

    Args:
        rows: in the cause's place; own: the explanation of the first of them.
        rest: the other causes; coarse: the likelihood is raised to the power 1/coarse.
    """
    odds = priors.UNLISTED_ODDS + float(np.log(TAKEN))
    for row, told in _named(rows, own):
        curves = [t for t in told.terms[1:] if not t.hypothesis.listed]
        if curves:
            law, prior = _led_by_curve(told, curves, rest), row.score - row.evidence + odds
            yield row_of(law, prior, coarse, Proposal(law, prior))


def misfits(state: State, k: int, rows: Sequence[Candidate]) -> Iterator[Candidate]:
    """What is listed in the place of a listed cause, as what the nameless ones leave of their laws:
    which of the listed takes that up is as open as which is a cause, but they leave it for certain.
    The form is the same; what differs is the prior of its size, which no coarsening blurs.
    """
    listed = laws(state.fitted)[k].listed
    energy = energy_beside(state, k, of_other_kind(state, k)) if listed else 0.0
    for row in rows:
        if energy > 0 and row.name != UNLISTED and row.gain > 0:
            odds = misfit_odds(row.gain, energy) - priors.NAMED
            yield replace(row, name=UNLISTED, score=row.score + odds, misfit=True)


def partial_matches(rows: Sequence[Candidate], columns: int, again: bool) -> Iterator[Candidate]:
    """What is listed in a cause's place, as what explains a share of a cause outside the list. It
    leaves the rest where nothing finds it, or the same name takes that up again.

    Args:
        rows: in the cause's place, its own first.
        columns: directions in which the rest would be looked for.
        again: whether the cause's name is in the model again.
    """
    for k, row in enumerate(rows):
        if row.name != UNLISTED:
            found = again and k == 0
            odds = AGAIN if found else imitation_odds(max(row.gain, 2 * row.evidence, 0), columns)
            yield replace(row, name=UNLISTED, score=row.score + odds, partial=True)


def _named(rows: Sequence[Candidate], own: Explanation) -> Iterator[tuple[Candidate, Explanation]]:
    """The rows under a name, each with its explanation, where that was worked out."""
    for k, row in enumerate(rows):
        told = own if k == 0 else row.proposal and row.proposal.explanation
        if told and row.name != UNLISTED:
            yield row, told


def _is_of_any_form(law: Hypothesis) -> bool:
    """Whether a law is a curve of any form under a name."""
    return law.alias is not None and law.law.form == "any"


def _led_by_curve(told: Explanation, curves: Sequence[FittedTerm], rest: State) -> Explanation:
    """An explanation under a name as a law without one, which the largest of its curves leads."""
    if curves[0] is not told.terms[0]:
        told = explanation_of(told.terms, told.tried, rest.fitted, rest.whitened, curves)
        lead = max(curves, key=lambda t: _energy_of(t, rest))
    else:
        lead = curves[0]
    law = replace(lead.hypothesis, alias=None)
    others = (replace(t, host=law) for t in told.terms if t is not lead)
    return replace(told, terms=(replace(lead, hypothesis=law, host=None), *others), plain=None)


def _energy_of(term: FittedTerm, state: State) -> float:
    """Energy of a term's signal, in units of the noise."""
    signal = state.whitened.weighed(summed([term], state.whitened))
    return sum(float(part @ part) for part in signal.values())


def row_of(
    told: Explanation, prior: float, coarse: float, proposal: Proposal | None = None
) -> Candidate:
    """An explanation under its own name."""
    evidence, less = told.evidence, told.coarsely(coarse)
    deviation = evidence - told.plain.evidence if told.plain else 0.0
    name, gain, plain = name_of(told.terms), told.gain, told.plain or told
    in_form = plain.hypothesis.textbook and all(n.plausible for n in plain.numbers)
    textbook = plain.gain if in_form else -np.inf
    return Candidate(name, evidence + prior, evidence, less, gain, proposal, deviation, textbook)


def name_of(terms: Sequence[FittedTerm]) -> str:
    """The name of a cause with these terms."""
    law = terms[0].hypothesis
    return law.id if law.listed else UNLISTED


FIRST_ORDER = 0.01  # of what a law explains, by which its column may differ from its form


def candidates_for_cause(state: State, k: int, scan: Scan) -> list[Candidate]:
    """Everything that may stand in the place of a cause, all others being as they are."""
    rest, cause = without(state, k), state.causes[k]
    own = explanation_of(state.terms(k), cause.tried, rest.fitted, state.whitened)
    fitted = partial(_fitted, state, k)
    mine = Proposal(own, cause.log_prior)
    rows = candidates_in_place(rest, scan, mine, fitted, again=_is_again(state, k))
    return [*rows, *misfits(state, k, rows)]


def candidates_in_place(
    rest: State,
    scan: Scan,
    mine: Proposal | None = None,
    fitted: Callable[[list[Candidate], float], Iterable[Candidate]] | None = None,
    again: bool = False,
) -> list[Candidate]:
    """Everything that may stand in one place of a model, but for what nameless causes leave.

    Args:
        rest: the model without the cause in this place.
        scan: of the hypotheses.
        mine: the cause that stands there, the first of the candidates; the most probable if not
            given.
        fitted: candidates at their own fit, from those to first order and what the likelihood is
            coarsened by; to first order if not given.
        again: whether the cause's name is in the model again.
    """
    every = looked_at(rest, scan)
    mine = mine or max(every, key=lambda p: p.score)
    own, law = mine.explanation, mine.explanation.hypothesis
    coarse = coarsened(max(e.gain for e in (own, *(p.explanation for p in every))))
    rows = [row_of(own, mine.log_prior, coarse)]
    known = {id(p.explanation.hypothesis) for p in every}
    first = [p for p in every if possible(p.explanation.terms[0])]
    for p in (*_at_its_shape(law, first, rest), *_at_its_instant(law, rest, scan)):
        if not _same(p.explanation.hypothesis, law):  # once, at the shape that it has
            rows.append(row_of(p.explanation, p.log_prior, coarse, p))
    top = max(row.coarse_score for row in rows)
    rows += _not_looked_at(rest, scan, known, coarse, top + np.log(LEAST))
    rows = list(_with_listed_deviations(list(fitted(rows, coarse) if fitted else rows), own))
    rows += of_other_source(rows, law)
    rows += [*of_any_form(rows, own, rest, scan, coarse), *completed(rows, own, rest, coarse)]
    return [*rows, *partial_matches(rows, scan.width, again)]


def _not_looked_at(
    rest: State, scan: Scan, known: Collection[int], coarse: float, counts: float
) -> Iterator[Candidate]:
    """The hypotheses that were not worked out, by the evidence of their columns.

    Args:
        rest: the other causes; known: ids of those hypotheses that were.
        counts: coarse score from which a hypothesis counts, so that its sizes have to be possible.
    """
    fitted, whitened = rest.fitted, rest.whitened
    fine = scan.log_bayes_factors(fitted)
    levels = np.ones(len(fine))
    for k, hypothesis in enumerate(whitened.hypotheses):
        if hypothesis.line_hz and fine[k] > 0 and id(hypothesis) not in known:
            levels[k] = local_level(hypothesis, (), fitted, whitened)
    if (levels > 1).any():
        fine = scan.log_bayes_factors(fitted, levels)
    less = scan.log_bayes_factors(fitted, coarse * levels)
    for k, hypothesis in enumerate(whitened.hypotheses):
        if id(hypothesis) in known:
            continue
        odds = float(scan.log_odds[k])
        if hypothesis.listed and less[k] + odds > counts:
            told = explained_by(scan.products.normal_equations(k, fitted), fitted, whitened)
            if told is None or not possible(told.terms[0]):
                continue
        name = hypothesis.id if hypothesis.listed else UNLISTED
        yield Candidate(name, float(fine[k]) + odds, float(fine[k]), float(less[k]), 0.0)


def _fitted(state: State, k: int, rows: Sequence[Candidate], coarse: float) -> Iterator[Candidate]:
    """Rows, those of other names that explain nearly as much as the first at their own fit, where
    that is better: a column is its law's form to first order only.
    """
    own = rows[0]
    for row in rows:
        near = row.gain > (1 - FIRST_ORDER) * own.gain
        if row.proposal is None or row.name == own.name or not near:
            yield row
            continue
        worse = refitted(with_cause(state, k, row.proposal)).cost - state.cost
        shift = max(own.score - worse - row.score, 0.0)
        yield replace(
            row,
            score=row.score + shift,
            evidence=row.evidence + shift,
            coarse_evidence=row.coarse_evidence + shift / coarse,
            gain=row.gain + 2 * shift,
            textbook_gain=row.textbook_gain + 2 * shift,
        )


def _with_listed_deviations(rows: Sequence[Candidate], own: Explanation) -> Iterator[Candidate]:
    """Rows, a name that deviates from its textbook form only as far as another name is in its own,
    as both causes together: what has a name is no deviation, and is as probable as a further cause
    of that name.

    Args:
        rows: in a cause's place; own: the explanation of the first of them.
    """
    told = {id(row): explanation for row, explanation in _named(rows, own)}
    plain = [r for r in rows if id(r) in told and not r.deviation and np.isfinite(r.textbook_gain)]
    best = max(plain, key=lambda r: r.evidence, default=None)
    for row in rows:
        if best is None or not row.deviation or row.evidence > best.evidence or id(row) not in told:
            yield row
            continue
        deviation = told[id(row)].terms[1:]
        price = sum(len(t.names) for t in deviation) * np.log(1 + told[id(row)].tried)
        yield replace(row, score=row.score - max(best.evidence - best.score - price, 0.0))


def _at_its_instant(law: Hypothesis, rest: State, scan: Scan) -> Iterator[Proposal]:
    """Other events at the instant of one, which is known to a sample."""
    if (instant := law.instant) is None:
        return
    whitened, fitted = rest.whitened, rest.fitted
    odds = {  # in a pause between recordings an event is more probable than at any other instant
        h.place: float(prior)
        for h, prior in zip(whitened.hypotheses, scan.log_odds, strict=True)
        if h.instant is not None and h.instant.in_pause == instant.in_pause
    }
    steps = list(steps_at(whitened.observations.scenario, instant))
    local = whitened.beside([h for h in steps if h.place in odds])
    for k in range(len(whitened.hypotheses), len(local.hypotheses)):
        place = local.hypotheses[k].place
        if place != law.place:
            told = explain(k, fitted, local)
            if told is not None and possible(told.terms[0]):
                yield Proposal(told, odds[place])


def _at_its_shape(law: Hypothesis, found: Sequence[Proposal], rest: State) -> Iterator[Proposal]:
    """Proposals, the best of each other name at the shape of a cause, which was refined: a lag that
    both have is compared at the same value, and lines in time each at their own best frequency. Of
    events see ``_at_its_instant``.
    """
    mine = {} if law.has_instant else shapes(law)
    seen = {law.id}
    for p in found:
        terms = p.explanation.terms
        common = mine.keys() & shapes(terms[0].hypothesis).keys()
        if law.line_hz and terms[0].hypothesis.line_hz and terms[0].hypothesis.id not in seen:
            seen.add(terms[0].hypothesis.id)
            p = best_shape(p, rest.fitted, rest.whitened)
        elif common and terms[0].hypothesis.id not in seen:
            seen.add(terms[0].hypothesis.id)
            moved = [t.hypothesis for t in terms if common <= shapes(t.hypothesis).keys()]
            for name in sorted(common):
                moved = [at_shape(h, name, mine[name]) for h in moved]
            p = max([p, *in_shapes(p, moved, rest.fitted, rest.whitened)], key=lambda q: q.score)
        yield p


def _is_again(state: State, k: int) -> bool:
    """Whether a cause has its textbook form at several shapes, or that is another cause in the same
    place as well. Vibrations and pick-up are of several lines by nature.
    """
    every = laws(state.fitted)
    law, terms = every[k], state.terms(k)
    others = [t.hypothesis for t in terms[1:]] + [other for other in every if other is not law]
    once = law.textbook and not law.line_hz
    return once and any(h.textbook and h.place == law.place for h in others)


def _same(one: Hypothesis, other: Hypothesis) -> bool:
    """Whether two hypotheses are one law in one place, at any shape."""
    return one is other or (one.listed and (one.place, one.alias) == (other.place, other.alias))
