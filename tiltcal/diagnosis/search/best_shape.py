"""A proposal at its best shape: continuous shapes refined, an event at its instant, a curve at its
best resolution or in a localised form.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis, steps_at
from tiltcal.diagnosis.hypotheses.localised_curves import STEPS
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.curve_resolution import RESOLUTIONS, resolutions
from tiltcal.diagnosis.search.explanation import explain
from tiltcal.diagnosis.search.nearest_forms import nearest_forms
from tiltcal.diagnosis.search.possible_sizes import possible
from tiltcal.diagnosis.search.shape_refinement import refined
from tiltcal.diagnosis.search.state import Proposal
from tiltcal.effects.learned import Learned

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
    changed = terms[0].hypothesis is not hypothesis
    near = [t.hypothesis for t in terms] if changed else []
    if (instant := terms[0].hypothesis.instant) is not None:
        scenario = whitened.observations.scenario
        near += list(steps_at(scenario, instant))
    best = _best([proposal, *in_shapes(proposal, near, fitted, whitened)])
    other = _resolved(proposal, fitted, whitened)
    return _best([best, *other, *_localised(best, fitted, whitened)])


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
