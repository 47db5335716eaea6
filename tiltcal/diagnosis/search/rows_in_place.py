"""Everything that may stand in the place of a cause, with its posterior odds."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

import numpy as np

from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis, steps_at
from tiltcal.diagnosis.hypotheses.priors import UNLISTED
from tiltcal.diagnosis.search.best_shape import best_shape, in_shapes
from tiltcal.diagnosis.search.explanation import explain, explained_by, explanation_of
from tiltcal.diagnosis.search.local_level import local_level
from tiltcal.diagnosis.search.name_probabilities import (
    LEAST,
    Row,
    coarsened,
)
from tiltcal.diagnosis.search.possible_sizes import possible
from tiltcal.diagnosis.search.proposals import looked_at
from tiltcal.diagnosis.search.rows_without_name import (
    completed,
    imitated,
    misfits,
    of_any_form,
    of_other_source,
    row_of,
)
from tiltcal.diagnosis.search.scan import Scan
from tiltcal.diagnosis.search.shape_refinement import at_shape, shapes
from tiltcal.diagnosis.search.state import Proposal, State, laws, refitted, with_cause, without

FIRST_ORDER = 0.01  # of what a law explains, by which its column may differ from its form


def rows_in_place(state: State, k: int, scan: Scan) -> list[Row]:
    """Everything that may stand in the place of a cause, all others being as they are."""
    rest, whitened, cause = without(state, k), state.whitened, state.causes[k]
    terms = state.terms(k)
    own = explanation_of(terms, cause.tried, rest.fitted, whitened)
    law, every = terms[0].hypothesis, looked_at(rest, scan)
    coarse = coarsened(max(e.gain for e in (own, *(p.explanation for p in every))))
    rows = [row_of(own, cause.log_prior, coarse)]
    known = {id(p.explanation.hypothesis) for p in every}
    first = [p for p in every if possible(p.explanation.terms[0])]
    for p in (*_at_its_shape(law, first, rest), *_at_its_instant(law, rest, scan)):
        if not _same(p.explanation.hypothesis, law):  # once, at the shape that it has
            rows.append(row_of(p.explanation, p.log_prior, coarse, p))
    top = max(row.coarse_score for row in rows)
    rows += _not_looked_at(rest, scan, known, coarse, top + np.log(LEAST))
    rows = list(_fitted(state, k, rows, coarse))
    rows += of_other_source(rows, law)
    rows += [*of_any_form(rows, own, rest, scan, coarse), *completed(rows, own, rest, coarse)]
    shares = imitated(rows, whitened.columns.width, _is_again(state, k))
    return [*rows, *misfits(state, k, rows), *shares]


def _not_looked_at(
    rest: State, scan: Scan, known: Collection[int], coarse: float, counts: float
) -> Iterator[Row]:
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
        yield Row(name, float(fine[k]) + odds, float(fine[k]), float(less[k]), 0.0)


def _fitted(state: State, k: int, rows: Sequence[Row], coarse: float) -> Iterator[Row]:
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
