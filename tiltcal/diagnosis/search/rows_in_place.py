"""Everything that may stand in the place of a cause, with its posterior odds."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis, steps_at
from tiltcal.diagnosis.model.fitted_model import FittedTerm
from tiltcal.diagnosis.search import priors
from tiltcal.diagnosis.search.best_shape import best_shape, in_shapes
from tiltcal.diagnosis.search.curve_misfit import (
    energy_beside,
    misfit_odds,
    of_other_kind,
)
from tiltcal.diagnosis.search.explanation import (
    Explanation,
    evidence_in_place,
    explain,
    possible,
)
from tiltcal.diagnosis.search.local_level import local_level
from tiltcal.diagnosis.search.model_search import looked_at
from tiltcal.diagnosis.search.name_probabilities import (
    AGAIN,
    UNLISTED,
    Row,
    imitation_odds,
)
from tiltcal.diagnosis.search.scan import Scan
from tiltcal.diagnosis.search.shape_refinement import at_shape, shapes
from tiltcal.diagnosis.search.state import Proposal, State, laws, refitted, with_cause, without

FURTHER = float(np.log(priors.SOMETHING * (1 - priors.UNLISTED)))
"""Log odds that a listed cause is there beside others."""
FIRST_ORDER = 0.01  # of what a law explains, by which its column may differ from its form


def rows_in_place(state: State, k: int, scan: Scan) -> list[Row]:
    """Everything that may stand in the place of a cause, all others being as they are."""
    rest, whitened, cause = without(state, k), state.whitened, state.causes[k]
    terms = terms_of(state, k)
    evidence, gain = evidence_in_place(terms, cause.tried, rest.fitted, whitened)
    rows = [Row(name_of(terms), evidence + cause.prior, evidence, gain / 2)]
    law, every = terms[0].hypothesis, looked_at(rest.fitted, whitened, scan)
    known = {id(p.explanation.hypothesis) for p in every}
    first = [p for p in every if possible(p.explanation.terms[0])]
    for p in (*_at_its_shape(law, first, rest), *_at_its_instant(law, rest, scan)):
        e = p.explanation
        if not _same(e.hypothesis, law):  # once, at the shape that it has
            rows.append(Row(name_of(e.terms), p.score, e.evidence, e.gain / 2, p))
    factors = scan.log_bayes_factors(rest.fitted)
    for hypothesis, factor, odds in zip(whitened.hypotheses, factors, scan.log_odds, strict=True):
        if id(hypothesis) not in known:
            if hypothesis.line_hz and factor > 0:
                factor /= local_level(hypothesis, (), rest.fitted, whitened)
            name = hypothesis.id if hypothesis.listed else UNLISTED
            rows.append(Row(name, float(factor + odds), float(factor), 0.0))
    rows = list(_fitted(state, k, rows))
    rows += _of_other_source(rows, law)
    own = Explanation(terms, evidence, gain, cause.tried)
    rows += _of_any_form(rows, own, scan, whitened.hypotheses)
    imitated = _imitated(rows, whitened.columns.width, _is_again(state, k))
    return [*rows, *_misfits(state, k, rows), *imitated]


def _fitted(state: State, k: int, rows: Sequence[Row]) -> Iterator[Row]:
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
            row, score=row.score + shift, evidence=row.evidence + shift, gain=row.gain + shift
        )


def _at_its_instant(law: Hypothesis, rest: State, scan: Scan) -> Iterator[Proposal]:
    """Other events at the instant of one, which is known to a sample."""
    if (instant := law.instant) is None:
        return
    whitened, fitted = rest.whitened, rest.fitted
    odds = {
        h.place: float(prior)
        for h, prior in zip(whitened.hypotheses, scan.log_odds, strict=True)
        if h.has_instant
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


def _of_other_source(rows: Sequence[Row], law: Hypothesis) -> Iterator[Row]:
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
    other = float(np.log(priors.UNLISTED / (1 - priors.UNLISTED)))
    for k, row in enumerate(rows):
        source = law if k == 0 else row.proposal and row.proposal.explanation.hypothesis
        if source and source.listed and source.odds:
            score = row.score - source.odds + other
            yield replace(row, name=UNLISTED, score=score, proposal=curve.proposal)


def _of_any_form(
    rows: Sequence[Row], own: Explanation, scan: Scan, hypotheses: Sequence[Hypothesis]
) -> Iterator[Row]:
    """What is listed in a cause's place and holds for a curve of any form, as such a curve without
    a name: it is as probable there as a nameless curve over the same coordinate.

    Args:
        rows: in the cause's place; own: the explanation of the first of them.
        scan: of the hypotheses.
    """
    nameless = {
        priors.kind(h): float(odds)
        for h, odds in zip(hypotheses, scan.log_odds, strict=True)
        if not h.listed
    }
    for k, row in enumerate(rows):
        told = own if k == 0 else row.proposal and row.proposal.explanation
        if not (told and told.hypothesis.alias and told.hypothesis.law.form == "any"):
            continue
        law = replace(told.hypothesis, alias=None)
        if (odds := nameless.get(priors.kind(law))) is not None:
            first, *others = told.terms
            terms = (replace(first, hypothesis=law), *(replace(t, host=law) for t in others))
            curve = Proposal(replace(told, terms=terms, plain=None), odds)
            yield replace(row, name=UNLISTED, score=row.evidence + odds, proposal=curve)


def _misfits(state: State, k: int, rows: Sequence[Row]) -> Iterator[Row]:
    """What is listed in the place of a listed cause, as what the nameless ones leave of their laws:
    which of the listed takes that up is as open as which is a cause, but they leave it for certain.
    The form is the same; what differs is the prior of its size, which no coarsening blurs.
    """
    listed = laws(state.fitted)[k].listed
    energy = energy_beside(state, k, of_other_kind(state, k)) if listed else 0.0
    for row in rows:
        if energy > 0 and row.name != UNLISTED and row.gain > 0:
            odds = misfit_odds(2 * row.gain, energy) - FURTHER
            yield replace(row, name=UNLISTED, score=row.score + odds, misfit=True)


def _imitated(rows: Sequence[Row], columns: int, again: bool) -> Iterator[Row]:
    """What is listed in a cause's place, as what explains a share of a law that no list has. It
    leaves the rest where nothing finds it, or the same name takes that up again.

    Args:
        rows: in the cause's place, its own first.
        columns: directions in which the rest would be looked for.
        again: whether the cause's name is in the model again.
    """
    for k, row in enumerate(rows):
        if row.name != UNLISTED:
            found = again and k == 0
            odds = AGAIN if found else imitation_odds(2 * max(row.gain, row.evidence, 0), columns)
            yield replace(row, name=UNLISTED, score=row.score + odds, imitated=True)


def _is_again(state: State, k: int) -> bool:
    """Whether a cause has its textbook form at several shapes, or that is another cause in the same
    place as well. Vibrations and pick-up are of several lines by nature.
    """
    every = laws(state.fitted)
    law, terms = every[k], terms_of(state, k)
    others = [t.hypothesis for t in terms[1:]] + [other for other in every if other is not law]
    once = law.textbook and not law.line_hz
    return once and any(h.textbook and h.place == law.place for h in others)


def _same(one: Hypothesis, other: Hypothesis) -> bool:
    """Whether two hypotheses are one law in one place, at any shape."""
    return one is other or (one.listed and (one.place, one.alias) == (other.place, other.alias))


def terms_of(state: State, k: int) -> tuple[FittedTerm, ...]:
    """The terms of a cause."""
    return tuple(state.fitted.terms[i] for i in state.fitted.findings()[k])


def name_of(terms: Sequence[FittedTerm]) -> str:
    """The name of a cause with these terms."""
    law = terms[0].hypothesis
    return law.id if law.listed else UNLISTED
