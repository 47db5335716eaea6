"""Where no effect of the catalogue fits: a curve in place of a finding, or of the residual."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.model.channel_noise import models, noise_within_stops
from tiltcal.diagnosis.model.finding_tests import ALPHA, NoiseGate, log_alternatives, log_tail
from tiltcal.diagnosis.model.fitted_model import FittedModel, FittedTerm, refit
from tiltcal.diagnosis.model.removed_finding import RemovedFinding, price_of, remove_finding
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.alternatives import (
    EQUAL,
    LOOSE,
    OWN,
    Alternative,
    preferred,
    rank_alternatives,
)
from tiltcal.diagnosis.search.backward_elimination import backward_elimination
from tiltcal.diagnosis.search.localised_curves import angle_of, echo, is_echo, local
from tiltcal.diagnosis.search.shape_refinement import refined
from tiltcal.effects.electronics.mains import WANDER
from tiltcal.effects.learned import LearnedReading

MARGIN = 10.0  # nats of evidence, twice, that a nameless curve has to be better by than a name
# and this share of the gain: a law that is some per cent off its textbook form keeps its name
SHARE = 1 - OWN


def is_curve(hypothesis: Hypothesis) -> bool:
    """Whether it has no form of its own: it has no name, or its name states only where it acts."""
    return not hypothesis.textbook


def prefer_unlisted_curve(
    fitted: FittedModel, whitened: WhitenedModel, gate: NoiseGate
) -> tuple[FittedModel, WhitenedModel]:
    """One cause in place of several where it explains as much, a curve where no name fits; then the
    residual. Also returns the noise that is left.
    """
    groups = fitted.findings()
    together = [[k for places in groups for k in places]] if len(groups) > 1 else []
    for places in together + groups:
        inside = [fitted.terms[k] for k in places]
        if not all(t.hypothesis.textbook for t in inside if t.host is None):
            continue
        weakest = min(
            float(_power(remove_finding(fitted, whitened, own).signal).sum()) for own in groups
        )
        better = _better(inside, remove_finding(fitted, whitened, places), whitened, weakest)
        if better is None:
            continue
        kept = tuple(t for k, t in enumerate(fitted.terms) if k not in places)
        base = refit(replace(fitted, terms=kept), whitened)
        trial = refit(replace(base, terms=kept + refined(better.terms, base, whitened)), whitened)
        values, whitened = gate.log_p(trial, whitened)
        if values[-1] < np.log(ALPHA):
            return prefer_unlisted_curve(trial, whitened, gate)
    return leftover_curve(fitted, whitened, gate)


def _better(
    inside: Sequence[FittedTerm],
    removed: RemovedFinding,
    whitened: WhitenedModel,
    weakest: float = 0.0,
) -> Alternative | None:
    """What should replace some findings: one name for several, or a curve for names that do not
    fit.

    Args:
        weakest: energy of the weakest of several findings: one name for all may miss a share of
            that at most.
    """
    ranked = rank_alternatives(removed, whitened, lambda s: s.textbook)
    named = [r for r in ranked if r.fair and r.own >= OWN]
    sizes = sum(len(t.names) for t in inside)
    single = preferred(named, removed.signal) if named else None
    joint, several = _worth_of(inside, removed, whitened), sum(t.host is None for t in inside)
    # it may miss a share, but not where it needs more numbers for it: these fit anything
    if several > 1 and single is not None:
        miss = MARGIN * (several - 1)
        if single.sizes <= sizes:
            miss = EQUAL + min(LOOSE * single.gain, SHARE * weakest)
        if single.worth > joint - miss:
            return single
    curve = best_curve(removed, whitened)
    if curve is None:
        return None
    if several > 1 and (single is None or joint > single.worth + MARGIN + SHARE * curve.gain):
        fewer = several - causes(curve)  # one is likelier than several
        enough = curve.worth > joint - MARGIN * fewer - LOOSE * curve.gain
        return curve if fewer > 0 and enough else None
    fits = len(inside) == 1 or (
        several == 1 and any(r.hypothesis.place == inside[0].hypothesis.place for r in named)
    )
    level = 0.0 if single is None else max(single.worth, joint if fits else 0.0)
    # no form that a name could keep to
    of_any_form = several_lines(inside) or (single is not None and single.form < OWN)
    far_off = curve.worth > level + MARGIN + (0.0 if of_any_form else SHARE * curve.gain)
    # a name whose own form says little: a curve that says as much by itself goes before it
    if several == 1 and not fits:
        far_off &= curve.worth > joint - EQUAL - LOOSE * curve.gain
    if several > 1 and curve.sizes <= sizes and curve.worth > joint - EQUAL:
        # one cause with as few numbers says the same as several
        return curve if far_off else single
    return curve if far_off else None


def drop_formless_names(fitted: FittedModel, whitened: WhitenedModel) -> FittedModel:
    """The fitted model without names of findings that are significant only by their completing
    curves.
    """
    price = price_of(whitened)
    terms: list[FittedTerm] = []
    for places in fitted.findings():
        first, *rest = (fitted.terms[k] for k in places)
        told = (
            np.asarray(first.values) / np.maximum(fitted.sigmas(places[0]), np.finfo(float).tiny)
        ) ** 2
        if (
            first.hypothesis.textbook
            and rest
            and told.max(initial=0.0) < price
            and not any(t.hypothesis.textbook for t in rest)
        ):
            terms += [replace(t, host=None if t is rest[0] else rest[0].hypothesis) for t in rest]
        else:
            terms += [first, *rest]
    return (
        fitted
        if len(terms) == len(fitted.terms)
        else refit(replace(fitted, terms=tuple(terms)), whitened)
    )


def causes(curve: Alternative) -> int:
    """How many causes a curve stands for: curves in the readings of two channels are
    independent.
    """
    return len(
        {
            (e.sensor, e.axis) if isinstance(e, LearnedReading) else None
            for e in (t.hypothesis.effect for t in curve.terms)
        }
    )


def several_lines(inside: Sequence[FittedTerm]) -> bool:
    """Whether a name stands for lines that do not belong together: they have no common form."""
    lines = [t.hypothesis for t in inside if t.hypothesis.law.spectral_line == "time"]
    tones = [line.effect.values["frequency"] for line in lines]
    return len(tones) > 1 and max(tones) - min(tones) > WANDER


def _worth_of(
    inside: Sequence[FittedTerm], removed: RemovedFinding, whitened: WhitenedModel
) -> float:
    """Gain of the findings less the price of their parameters and of the shapes tried."""
    whole = sum(float(t @ t) for t in removed.target)
    left = sum(
        float((t - s) @ (t - s)) for t, s in zip(removed.target, removed.signal, strict=True)
    )
    tried = 2 * sum(float(np.log(t.hypothesis.variants)) for t in inside if t.host is None)
    return whole - left - price_of(whitened) * sum(len(t.names) for t in inside) - tried


def leftover_curve(
    fitted: FittedModel, whitened: WhitenedModel, gate: NoiseGate
) -> tuple[FittedModel, WhitenedModel]:
    """A curve for what is significant in the residual, also under the noise within the stops: what
    differs from stop to stop is a random walk to the spectrum of the whole record, but not within
    the stops.
    """
    if gate.static is None and (still := noise_within_stops(fitted, whitened)) is not None:
        within = whitened.under(models(still))
        found, left = _leftover(refit(fitted, within), within, gate)
        if len(found.terms) > len(fitted.terms):
            return backward_elimination(found, left, gate)
        fitted = refit(fitted, whitened)
    return _leftover(fitted, whitened, gate)


def _leftover(
    fitted: FittedModel, whitened: WhitenedModel, gate: NoiseGate
) -> tuple[FittedModel, WhitenedModel]:
    """A curve for the residual: part of a much larger finding in the same channels, else a finding
    of its own.
    """
    removed = RemovedFinding(
        list(fitted.basis), list(fitted.residual), [0 * r for r in fitted.residual]
    )
    curve = best_curve(removed, whitened)
    if curve is None:
        return fitted, whitened
    chance = log_tail(curve.gain, curve.sizes) + log_alternatives(
        curve.hypothesis, curve.sizes, len(whitened.hypotheses)
    )
    if chance > np.log(ALPHA):
        return fitted, whitened
    best = refined(curve.terms, fitted, whitened)
    trial = refit(replace(fitted, terms=fitted.terms + best), whitened)
    values, whitened = gate.log_p(trial, whitened)
    if values[-1] >= np.log(ALPHA) or _dear(trial, len(fitted.terms), whitened):
        return refit(fitted, whitened), whitened
    shares = [
        _power(remove_finding(fitted, whitened, places).signal) for places in fitted.findings()
    ]
    gains = [float(p.sum()) for p in shares]
    if (
        gains
        and curve.gain < SHARE * max(gains)
        and _alike(shares[k := int(np.argmax(gains))], curve, trial, whitened)
    ):
        places = fitted.findings()[k]
        host = fitted.terms[places[0]].hypothesis
        rest = tuple(replace(t, host=host) for t in best)
        terms = fitted.terms[: places[-1] + 1] + rest + fitted.terms[places[-1] + 1 :]
        return refit(replace(fitted, terms=terms), whitened), whitened
    return trial, whitened


def _dear(trial: FittedModel, start: int, whitened: WhitenedModel) -> bool:
    """Whether the terms from ``start`` on gain less than they cost, once the noise and all others
    are re-fitted.
    """
    places = list(range(start, len(trial.terms)))
    gain = (
        sum(float(t @ t) for t in remove_finding(trial, whitened, places).target) - trial.deviance
    )
    return gain < price_of(whitened) * sum(len(trial.terms[k].names) for k in places)


def _power(signal: Sequence[Array]) -> Array:
    """Energy of a signal in each channel, (channels,)."""
    return np.array([float(s @ s) for s in signal])


def _alike(power: Array, curve: Alternative, trial: FittedModel, whitened: WhitenedModel) -> bool:
    """Whether a curve shows in the channels that a finding shows in."""
    other = _power(
        remove_finding(
            trial, whitened, list(range(len(trial.terms) - len(curve.terms), len(trial.terms)))
        ).signal
    )
    return float(other[power > SHARE * power.sum()].sum()) > OWN * float(other.sum())


def best_curve(removed: RemovedFinding, whitened: WhitenedModel) -> Alternative | None:
    """The best curve, with a localised form where that explains the same with fewer parameters."""
    found = rank_alternatives(removed, whitened, is_curve)
    if not found:
        return None
    of_angle = next((r for r in found if angle_of(r) is not None), None)
    rings = next((r for r in found if is_echo(r)), None)
    trials = [
        *found,
        *(local(of_angle, removed, whitened) if of_angle else []),
        *([echo(rings, removed, whitened)] if rings else []),
    ]
    top = max(r.worth for r in trials)
    equal = [r for r in trials if r.worth > top - EQUAL - LOOSE * r.gain]
    # the table or the mount may be to blame as well
    moves_all = any(r.hypothesis.effect.sensor is None for r in equal)

    def rank(
        r: Alternative,
    ) -> tuple[bool, bool, float]:  # a known place first, then the reading itself
        return (
            r.hypothesis.alias is None or moves_all,
            not isinstance(r.hypothesis.effect, LearnedReading),
            -r.worth,
        )

    return min(equal, key=rank)
