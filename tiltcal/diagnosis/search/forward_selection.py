"""Which hypotheses stay in the model: forward selection by penalised score, a test against the
noise, then backward elimination.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.model.channel_noise import models, noise_under, noise_within_stops
from tiltcal.diagnosis.model.cosine_basis import project
from tiltcal.diagnosis.model.finding_tests import ALPHA, NoiseGate, log_alternatives, log_tail
from tiltcal.diagnosis.model.fitted_model import FittedModel, FittedTerm, refit, summed
from tiltcal.diagnosis.model.removed_finding import RemovedFinding, price_of, remove_finding
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.alternatives import (
    OWN,
    Alternative,
    preferred,
    rank_alternatives,
)
from tiltcal.diagnosis.search.backward_elimination import backward_elimination
from tiltcal.diagnosis.search.merging import merge_same_cause
from tiltcal.diagnosis.search.shape_refinement import at_its_instant, refined
from tiltcal.statistics.noise_spectrum import NoiseFit, white_noise

# of the worth of the best: a name in its own form goes before one that needs curves for more
NEARLY = 0.7
REST = 0.2  # share of a free form that its first curve may leave
PATIENCE = 6  # hypotheses that may be sent away
MOST = 4  # findings a recording may be given


def best_alternatives(
    fitted: FittedModel,
    whitened: WhitenedModel,
    wanted: Callable[[Hypothesis], bool],
    alone: bool = False,
) -> list[Alternative]:
    """What explains most of the residual, best first: of plausible size, mostly in its own form,
    and significant after correction for everything that was tried.
    """
    removed = RemovedFinding(
        list(fitted.basis), list(fitted.residual), [0 * r for r in fitted.residual]
    )
    total = len(whitened.hypotheses)
    found = rank_alternatives(removed, whitened, wanted, alone)
    return [
        r
        for r in found
        if r.fair
        and log_tail(r.gain, r.sizes) + log_alternatives(r.hypothesis, len(r.terms[0].names), total)
        < np.log(ALPHA)
    ]


def forward_selection(
    fitted: FittedModel,
    whitened: WhitenedModel,
    gate: NoiseGate,
    wanted: Callable[[Hypothesis], bool],
) -> tuple[FittedModel, WhitenedModel]:
    """Add what explains the residual best, as long as it is significant; then drop what is not
    needed.

    The scan weighs by white noise at first, so that no effect is mistaken for noise. A hypothesis
    that is not significant under the noise that is left without it waits, and may pass together
    with another one. Each finding improves the estimate of the noise. When nothing more is
    significant, the scan is repeated under white noise, because a slow effect may have been counted
    as noise; and at last under the noise within the stops, where differences between stops are no
    random walk.

    Returns the fitted model and the columns under the noise that it leaves.
    """
    waiting: tuple[FittedTerm, ...] = ()
    banned: set[int] = set()
    patience, looks = PATIENCE, [] if gate.static is not None else [noise_within_stops]
    look = None
    while len(fitted.findings()) < MOST and patience:
        trial = refit(replace(fitted, terms=fitted.terms + waiting), whitened)
        alternatives = best_alternatives(trial, whitened, _outside(wanted, frozenset(banned)))
        if look is _white_noise:  # some curve fits any slow noise: only a form of its own
            alternatives = [r for r in alternatives if r.own >= OWN]
        # again in another noise: without those that wait, then white, then within the stops
        if not alternatives:
            noise: list[NoiseFit] | None = None
            if waiting:
                noise = gate.noise(refit(fitted, whitened), whitened)
            elif looks:
                look = looks.pop(0)
                noise = look(fitted, whitened)
            if noise is None:
                break
            waiting, whitened = (), whitened.under(models(noise))
            fitted = refit(fitted, whitened)
            continue
        pick = _preferred(alternatives, trial, whitened)
        terms = at_its_instant(refined(pick.terms, trial, whitened), trial, whitened)
        terms = _hosted(terms, pick.gain, trial, whitened)
        trial = refit(replace(trial, terms=trial.terms + terms), whitened)
        values, whitened = gate.log_p(trial, whitened)
        needed = [value < np.log(ALPHA) for value in values]
        fewer = needed[-1] and not all(needed)
        if fewer and (other := _without(trial, needed, fitted, whitened, gate)) is not None:
            (trial, whitened), needed, patience = other, [True], patience - 1
        if all(needed) and (whole := _grown(trial, fitted, whitened)) is not None:
            fitted, waiting, banned, look = whole, (), set(), None
            looks = [] if gate.static is not None else [_white_noise, noise_within_stops]
            continue
        patience -= 1
        banned.add(id(pick.hypothesis))
        waiting = trial.terms[len(fitted.terms) :] if len(waiting) < 2 and not all(needed) else ()
        whitened = gate.left_by(trial if waiting else fitted, whitened)
    return backward_elimination(fitted, whitened, gate)


def _preferred(
    alternatives: Sequence[Alternative], trial: FittedModel, whitened: WhitenedModel
) -> Alternative:
    """The one to take: of those that fit in their own form, where any is nearly the best."""
    nearly = NEARLY * alternatives[0].worth
    own = [r for r in alternatives if r.own >= OWN and r.worth > nearly]
    if not own:
        return preferred(alternatives, trial.residual)
    return preferred(own, signal_of(own[0], trial, whitened))


def _grown(trial: FittedModel, before: FittedModel, whitened: WhitenedModel) -> FittedModel | None:
    """A trial with findings of one cause merged; None where it only adds a further shape of an
    earlier finding and does not lower the cost.
    """
    whole = refit(merge_same_cause(trial), whitened)
    further = len(whole.findings()) == len(before.findings())
    return (
        None
        if further and _cost(whole, whitened) >= _cost(refit(before, whitened), whitened)
        else whole
    )


def _without(
    trial: FittedModel,
    needed: Sequence[bool],
    before: FittedModel,
    whitened: WhitenedModel,
    gate: NoiseGate,
) -> tuple[FittedModel, WhitenedModel] | None:
    """A fitted model without the findings that the newest one makes unnecessary, with the noise
    that it leaves; None where it is no better than the one before.
    """
    terms = [
        trial.terms[k]
        for places, keep in zip(trial.findings(), needed, strict=True)
        if keep
        for k in places
    ]
    other = refit(replace(trial, terms=tuple(terms)), whitened)
    if _cost(other, whitened) >= _cost(refit(before, whitened), whitened):
        return None
    values, left = gate.log_p(other, whitened)
    return (other, left) if all(value < np.log(ALPHA) for value in values) else None


def _cost(fitted: FittedModel, whitened: WhitenedModel) -> float:
    """Deviance plus the BIC price of all parameters."""
    return fitted.deviance + price_of(whitened) * sum(len(t.names) for t in fitted.terms)


def _white_noise(fitted: FittedModel, whitened: WhitenedModel) -> list[NoiseFit]:
    """The noise of each channel without its slow part."""
    return [
        NoiseFit.known(white_noise(fit.model.white))
        for fit in noise_under(fitted, whitened.columns, law=whitened.law)
    ]


def _outside(
    wanted: Callable[[Hypothesis], bool], banned: frozenset[int]
) -> Callable[[Hypothesis], bool]:
    """Wanted, and not rejected already."""
    return lambda hypothesis: wanted(hypothesis) and id(hypothesis) not in banned


def _hosted(
    terms: tuple[FittedTerm, ...], gain: float, fitted: FittedModel, whitened: WhitenedModel
) -> tuple[FittedTerm, ...]:
    """A further function of a channel's own input that completes the much larger curve of a
    converter: it is no finding of its own.
    """
    for places in fitted.findings():
        host = fitted.terms[places[0]].hypothesis
        of_input = terms[0].hypothesis.law.nonlinear_in_input and host.law.nonlinear_in_input
        if of_input and host.law.form == "any":
            energy = sum(float(s @ s) for s in remove_finding(fitted, whitened, places).signal)
            if gain < REST * energy and places[-1] == len(fitted.terms) - 1:
                return tuple(replace(t, host=host) for t in terms)
    return terms


def signal_of(
    alternative: Alternative, fitted: FittedModel, whitened: WhitenedModel
) -> list[Array]:
    """What an alternative adds to the readings, without the part that calibration absorbs."""
    whole = whitened.whiten(summed(alternative.terms, whitened.observations, fitted.effects))
    total = [whole.get(i, np.zeros_like(r)) for i, r in enumerate(fitted.residual)]
    return project(fitted.basis, total)
