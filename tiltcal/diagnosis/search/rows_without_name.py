"""A name that may stand in a cause's place, as a law that no list has: what it would be then, and
how probable that is beside the name.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from tiltcal.diagnosis.hypotheses import priors
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.hypotheses.priors import UNLISTED
from tiltcal.diagnosis.model.fitted_model import FittedTerm, summed
from tiltcal.diagnosis.search.curve_misfit import energy_beside, misfit_odds, of_other_kind
from tiltcal.diagnosis.search.explanation import Explanation, explanation_of
from tiltcal.diagnosis.search.name_probabilities import (
    AGAIN,
    TAKEN,
    Row,
    imitation_odds,
)
from tiltcal.diagnosis.search.scan import Scan
from tiltcal.diagnosis.search.state import Proposal, State, laws


def of_other_source(rows: Sequence[Row], law: Hypothesis) -> Iterator[Row]:
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
    rows: Sequence[Row], own: Explanation, rest: State, scan: Scan, coarse: float
) -> Iterator[Row]:
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


def completed(rows: Sequence[Row], own: Explanation, rest: State, coarse: float) -> Iterator[Row]:
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


def misfits(state: State, k: int, rows: Sequence[Row]) -> Iterator[Row]:
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


def imitated(rows: Sequence[Row], columns: int, again: bool) -> Iterator[Row]:
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
            odds = AGAIN if found else imitation_odds(max(row.gain, 2 * row.evidence, 0), columns)
            yield replace(row, name=UNLISTED, score=row.score + odds, imitated=True)


def _named(rows: Sequence[Row], own: Explanation) -> Iterator[tuple[Row, Explanation]]:
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
    whitened = state.whitened
    signal = whitened.whiten(summed([term], whitened.observations, state.fitted.effects))
    return sum(float(part @ part) for part in signal.values())


def row_of(told: Explanation, prior: float, coarse: float, proposal: Proposal | None = None) -> Row:
    """An explanation under its own name."""
    evidence, less = told.evidence, told.coarsely(coarse)
    deviation = evidence - told.plain.evidence if told.plain else 0.0
    name, gain, plain = name_of(told.terms), told.gain, told.plain or told
    in_form = plain.hypothesis.textbook and all(n.plausible for n in plain.numbers)
    textbook = plain.gain if in_form else -np.inf
    return Row(name, evidence + prior, evidence, less, gain, proposal, deviation, textbook)


def name_of(terms: Sequence[FittedTerm]) -> str:
    """The name of a cause with these terms."""
    law = terms[0].hypothesis
    return law.id if law.listed else UNLISTED
