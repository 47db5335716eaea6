"""A second search: textbook forms only, several at once, each exchanged for another as long as that
is better.

A form with completing curves is flexible: where two effects act, the curves of one absorb part of
the other. Plain forms cannot. The fitted model that explains as much with fewer parameters is kept.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.model.finding_tests import NoiseGate
from tiltcal.diagnosis.model.fitted_model import FittedModel, refit
from tiltcal.diagnosis.model.removed_finding import price_of, remove_finding
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.alternatives import EQUAL, LOOSE, preferred, rank_alternatives
from tiltcal.diagnosis.search.backward_elimination import backward_elimination
from tiltcal.diagnosis.search.forward_selection import MOST, best_alternatives, signal_of
from tiltcal.diagnosis.search.merging import merge_same_cause
from tiltcal.diagnosis.search.shape_refinement import at_its_instant, refined, shapes
from tiltcal.statistics.noise_spectrum import robust_white, white_noise

FINDING = 10.0  # of deviance: one cause is likelier than two
EXCHANGES = 6


def swap_search(
    rich: FittedModel,
    start: FittedModel,
    whitened: WhitenedModel,
    gate: NoiseGate,
    wanted: Callable[[Hypothesis], bool],
) -> tuple[FittedModel, WhitenedModel]:
    """The fitted model in plain forms where it explains as much as ``rich`` with fewer parameters;
    else ``rich``. Also returns the noise that it leaves.

    Args:
        start: without findings; the search begins under the noise that is left when ``rich`` is
            taken away.
    """
    if not rich.terms:
        return _several(rich, start, whitened, gate, wanted)
    if len(rich.terms) == 1:  # found while the noise was not known yet
        other, left = backward_elimination(exchanged(rich, whitened, wanted), whitened, gate)
        return (other, left) if other.terms else backward_elimination(rich, left, gate)
    plain = [plainly(start, whitened, gate, forms)[0] for forms in _forms(wanted, whitened)]
    other = refit(rich, whitened)
    gain = refit(replace(start, terms=()), whitened).deviance - other.deviance
    least, one = min(
        ((description_length(p, whitened, gate), p) for p in plain if p.terms),
        key=lambda pair: pair[0],
        default=(np.inf, rich),
    )
    if least <= description_length(rich, whitened, gate) + LOOSE * gain:
        left = gate.left_by(one, whitened)
        return refit(one, left), left
    return other, whitened


def _several(
    rich: FittedModel,
    start: FittedModel,
    whitened: WhitenedModel,
    gate: NoiseGate,
    wanted: Callable[[Hypothesis], bool],
) -> tuple[FittedModel, WhitenedModel]:
    """What several textbook forms explain together where none is significant by itself; else
    ``rich``.

    Searched under white noise: together they look like a random walk to the record.
    """
    residuals = whitened.observations.residuals(start.effects)
    white = whitened.under([white_noise(robust_white(r)) for r in residuals])
    for forms in _forms(wanted, whitened):
        several, left = plainly(start, white, gate, forms)
        if several.terms:
            return several, left
    return rich, whitened


def _forms(
    wanted: Callable[[Hypothesis], bool], whitened: WhitenedModel
) -> list[Callable[[Hypothesis], bool]]:
    """Textbook laws, then lagged or curved ones among them, if any: these are flexible
    themselves.
    """
    supple = any(wanted(s) and s.alias is not None for s in whitened.hypotheses)
    return [lambda s: wanted(s) and s.alias is None, *([wanted] if supple else [])]


def plainly(
    fitted: FittedModel,
    whitened: WhitenedModel,
    gate: NoiseGate,
    wanted: Callable[[Hypothesis], bool],
) -> tuple[FittedModel, WhitenedModel]:
    """Up to MOST textbook forms, each in turn the best in its place; then those dropped that are
    not significant.
    """
    fitted = refit(fitted, whitened)
    while len(fitted.findings()) < MOST:
        alternatives = best_alternatives(fitted, whitened, wanted, alone=True)
        if not alternatives:
            break
        pick = preferred(alternatives, signal_of(alternatives[0], fitted, whitened))
        terms = at_its_instant(refined(pick.terms, fitted, whitened), fitted, whitened, alone=True)
        fitted = exchanged(
            refit(replace(fitted, terms=fitted.terms + terms), whitened), whitened, wanted
        )
        fitted = refine_all_shapes(fitted, whitened)
    fitted, whitened = backward_elimination(fitted, whitened, gate)
    return backward_elimination(
        trimmed(merge_same_cause(exchanged(fitted, whitened, wanted)), whitened), whitened, gate
    )


def trimmed(fitted: FittedModel, whitened: WhitenedModel) -> FittedModel:
    """The fitted model without parameters that gain less than they cost: a finding had them from
    what others explain since.

    The last parameter of a finding stays: findings are tested as a whole.
    """
    price = price_of(whitened)
    while True:
        fitted = refit(fitted, whitened)
        # 0: not determined
        sigmas = [
            np.maximum(fitted.sigmas(k), np.finfo(float).tiny) for k in range(len(fitted.terms))
        ]
        told = [
            (np.asarray(t.values) / sigma) ** 2
            for t, sigma in zip(fitted.terms, sigmas, strict=True)
        ]
        least = [(float(x.min()), k, int(x.argmin())) for k, x in enumerate(told) if len(x) > 1]
        if not least or min(least)[0] >= price:
            return fitted
        _, k, i = min(least)
        terms = list(fitted.terms)
        term = terms[k]
        terms[k] = replace(
            term,
            names=term.names[:i] + term.names[i + 1 :],
            values=term.values[:i] + term.values[i + 1 :],
        )
        fitted = replace(fitted, terms=tuple(terms))


def exchanged(
    fitted: FittedModel, whitened: WhitenedModel, wanted: Callable[[Hypothesis], bool]
) -> FittedModel:
    """The fitted model with each finding replaced by what explains more in its place."""
    for _ in range(EXCHANGES):
        for places in fitted.findings():
            removed = remove_finding(fitted, whitened, places)
            whole = sum(float(t @ t) for t in removed.target)
            left = sum(
                float((t - s) @ (t - s))
                for t, s in zip(removed.target, removed.signal, strict=True)
            )
            mine = (
                whole - left - price_of(whitened) * sum(len(fitted.terms[k].names) for k in places)
            )
            found = [r for r in rank_alternatives(removed, whitened, wanted, alone=True) if r.fair]
            if (
                found
                and found[0].hypothesis.place != fitted.terms[places[0]].hypothesis.place
                and found[0].worth > mine + EQUAL
            ):
                kept = tuple(t for k, t in enumerate(fitted.terms) if k not in places)
                base = refit(replace(fitted, terms=kept), whitened)
                terms = at_its_instant(
                    refined(found[0].terms, base, whitened), base, whitened, alone=True
                )
                fitted = refit(replace(base, terms=kept + terms), whitened)
                break
        else:
            break
    return fitted


def refine_all_shapes(fitted: FittedModel, whitened: WhitenedModel) -> FittedModel:
    """The fitted model with the shapes of its findings refined again: a finding that was found
    alone absorbed part of the others, under another noise.
    """
    groups = fitted.findings()
    for _ in range(EXCHANGES if len(groups) > 1 else 1):
        before = fitted.deviance
        for places in groups:
            if shapes(fitted.terms[places[0]].hypothesis):
                fitted = _reshaped(fitted, places, whitened)
        if fitted.deviance > before - EQUAL:
            break
    return fitted


def _reshaped(fitted: FittedModel, places: Sequence[int], whitened: WhitenedModel) -> FittedModel:
    """The fitted model with one finding at its best shape nearby, where that is better; the sizes
    of all others are re-fitted.
    """
    others = tuple(t for k, t in enumerate(fitted.terms) if k not in places)
    new = refined(
        tuple(fitted.terms[k] for k in places),
        refit(replace(fitted, terms=others), whitened),
        whitened,
    )
    terms = list(fitted.terms)
    terms[places[0] : places[-1] + 1] = new
    trial = refit(replace(fitted, terms=tuple(terms)), whitened)
    return trial if trial.deviance < fitted.deviance else fitted


def description_length(fitted: FittedModel, whitened: WhitenedModel, gate: NoiseGate) -> float:
    """Twice the negative log likelihood, but for a constant, plus the price of all parameters and
    findings.

    Under the noise that the fitted model leaves itself: under another noise it would be charged for
    what it counts as noise.
    """
    left = gate.left_by(fitted, whitened)
    spread = sum(
        float(np.log(m.spectrum(len(c.values))).sum())
        for m, c in zip(left.noise, whitened.observations.channels, strict=True)
    )
    sizes = sum(len(t.names) for t in fitted.terms)
    return (
        refit(fitted, left).deviance
        + spread
        + price_of(whitened) * sizes
        + FINDING * len(fitted.findings())
    )
