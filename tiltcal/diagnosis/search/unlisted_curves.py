"""When no name fits: a curve in place of a finding, or of what the findings leave over."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.hypotheses.families import WANDER
from tiltcal.diagnosis.hypotheses.hypothesis import Suspect
from tiltcal.diagnosis.model.fitted_model import Account, Term, models, noise_within_stops, settle
from tiltcal.diagnosis.model.hypothesis_columns import Ledger
from tiltcal.diagnosis.search.alternatives import (
    EQUAL,
    LOOSE,
    OWN,
    Case,
    Rival,
    case_of,
    explanations,
    preferred,
    price_of,
)
from tiltcal.diagnosis.search.forward_selection import (
    ALPHA,
    TONES,
    Gate,
    backward,
    findings,
    log_tail,
    log_tries,
)
from tiltcal.diagnosis.search.localised_curves import angle_of, echo, is_echo, local
from tiltcal.diagnosis.search.shape_refinement import refined
from tiltcal.effects.learned import LearnedReading

MARGIN = 10.0  # nats of evidence, twice, that a nameless curve has to be better by than a name
SHARE = (
    1 - OWN
)  # and this share of the gain: a law that is some per cent off its textbook form keeps its name


def is_curve(suspect: Suspect) -> bool:
    """Whether it has no form of its own: no name, or a name that says only where it acts."""
    return not suspect.textbook


def nameless(account: Account, ledger: Ledger, gate: Gate) -> Account:
    """One cause in place of several where it explains as much, a curve where no name does; then
    what is left over.
    """
    groups = findings(account)
    together = [[k for places in groups for k in places]] if len(groups) > 1 else []
    for places in together + groups:
        inside = [account.terms[k] for k in places]
        if not all(t.suspect.textbook for t in inside if t.host is None):
            continue
        weakest = min(float(_power(case_of(account, ledger, own).signal).sum()) for own in groups)
        better = _better(inside, case_of(account, ledger, places), ledger, weakest)
        if better is None:
            continue
        kept = tuple(t for k, t in enumerate(account.terms) if k not in places)
        base = settle(replace(account, terms=kept), ledger)
        trial = settle(replace(base, terms=kept + refined(better.terms, base, ledger)), ledger)
        if gate.log_p(trial, ledger)[-1] < np.log(ALPHA):
            return nameless(trial, ledger, gate)
    return leftover(account, ledger, gate)


def _better(
    inside: Sequence[Term], case: Case, ledger: Ledger, weakest: float = 0.0
) -> Rival | None:
    """What should stand in the place of some findings: one name for several, or a curve for names
    that do not fit.

    Args:
        weakest: energy of the weakest of several findings: one name for all may miss a share of
            that at most.
    """
    named = [r for r in explanations(case, ledger, lambda s: s.textbook) if r.fair and r.own >= OWN]
    single = preferred(named, case.signal) if named else None
    joint, several = _worth_of(inside, case, ledger), sum(t.host is None for t in inside)
    if (
        several > 1 and single is not None
    ):  # it may miss a share, but not where it needs more numbers for it: these fit anything
        as_few = single.sizes <= sum(len(t.names) for t in inside)
        miss = (
            EQUAL + min(LOOSE * single.gain, SHARE * weakest) if as_few else MARGIN * (several - 1)
        )
        if single.worth > joint - miss:
            return single
    curve = best_curve(case, ledger)
    if curve is None:
        return None
    if several > 1 and (single is None or joint > single.worth + MARGIN + SHARE * curve.gain):
        fewer = several - causes(curve)  # one is likelier than several
        return (
            curve
            if fewer > 0 and curve.worth > joint - MARGIN * fewer - LOOSE * curve.gain
            else None
        )
    fits = len(inside) == 1 or (
        several == 1 and any(r.suspect.place == inside[0].suspect.place for r in named)
    )
    level = 0.0 if single is None else max(single.worth, joint if fits else 0.0)
    of_any_form = several_lines(inside) or (
        single is not None and single.form < OWN
    )  # no form that a name could keep to
    far_off = curve.worth > level + MARGIN + (0.0 if of_any_form else SHARE * curve.gain)
    if (
        several == 1 and not fits
    ):  # a name whose own form says little: a curve that says as much by itself goes before it
        far_off &= curve.worth > joint - EQUAL - LOOSE * curve.gain
    if (
        several > 1
        and curve.sizes <= sum(len(t.names) for t in inside)
        and curve.worth > joint - EQUAL
    ):
        return (
            curve if far_off else single
        )  # one cause with as few numbers says the same as several
    return curve if far_off else None


def without_a_form(account: Account, ledger: Ledger) -> Account:
    """The account with names taken from findings that hold by the curves beside them: no size of
    their own stands out any more.
    """
    price = price_of(ledger)
    terms: list[Term] = []
    for places in findings(account):
        first, *rest = (account.terms[k] for k in places)
        told = (
            np.asarray(first.values) / np.maximum(account.sigmas(places[0]), np.finfo(float).tiny)
        ) ** 2
        if (
            first.suspect.textbook
            and rest
            and told.max(initial=0.0) < price
            and not any(t.suspect.textbook for t in rest)
        ):
            terms += [replace(t, host=None if t is rest[0] else rest[0].suspect) for t in rest]
        else:
            terms += [first, *rest]
    return (
        account
        if len(terms) == len(account.terms)
        else settle(replace(account, terms=tuple(terms)), ledger)
    )


def causes(curve: Rival) -> int:
    """How many a curve stands for: those of two channels' readings have nothing to do with each
    other.
    """
    return len(
        {
            (e.sensor, e.axis) if isinstance(e, LearnedReading) else None
            for e in (t.suspect.effect for t in curve.terms)
        }
    )


def several_lines(inside: Sequence[Term]) -> bool:
    """Whether a name stands for lines that do not belong together: no form is theirs that the name
    could keep to.
    """
    tones = [t.suspect.effect.values["frequency"] for t in inside if t.suspect.id in TONES]
    return len(tones) > 1 and max(tones) - min(tones) > WANDER


def _worth_of(inside: Sequence[Term], case: Case, ledger: Ledger) -> float:
    """What the findings bring less the price of their sizes and of the shapes that were tried."""
    whole = sum(float(t @ t) for t in case.target)
    left = sum(float((t - s) @ (t - s)) for t, s in zip(case.target, case.signal, strict=True))
    tried = 2 * sum(float(np.log(t.suspect.variants)) for t in inside if t.host is None)
    return whole - left - price_of(ledger) * sum(len(t.names) for t in inside) - tried


def leftover(account: Account, ledger: Ledger, gate: Gate) -> Account:
    """What is left over and significant, looked for in the noise within the stops too: what differs
    from stop to stop by any
    law of its own is a random walk to the spectrum of the whole record, and within the stops it is
    not there.
    """
    if gate.static is None and (still := noise_within_stops(account, ledger)) is not None:
        usual = ledger.roots
        ledger.under(models(still))
        found = _leftover(settle(account, ledger), ledger, gate)
        if len(found.terms) > len(account.terms):
            return backward(found, ledger, gate)
        ledger.weigh(usual)
        account = settle(account, ledger)
    return _leftover(account, ledger, gate)


def _leftover(account: Account, ledger: Ledger, gate: Gate) -> Account:
    """The rest of a finding's own form when it is small beside it, else a finding."""
    case = Case(list(account.basis), list(account.residual), [0 * r for r in account.residual])
    curve = best_curve(case, ledger)
    if curve is None:
        return account
    chance = log_tail(curve.gain, curve.sizes) + log_tries(
        curve.suspect, curve.sizes, len(ledger.suspects)
    )
    if chance > np.log(ALPHA):
        return account
    best = refined(curve.terms, account, ledger)
    trial = settle(replace(account, terms=account.terms + best), ledger)
    if gate.log_p(trial, ledger)[-1] >= np.log(ALPHA) or _dear(trial, len(account.terms), ledger):
        return settle(account, ledger)
    shares = [_power(case_of(account, ledger, places).signal) for places in findings(account)]
    gains = [float(p.sum()) for p in shares]
    if (
        gains
        and curve.gain < SHARE * max(gains)
        and _alike(shares[k := int(np.argmax(gains))], curve, trial, ledger)
    ):
        places = findings(account)[k]
        host = account.terms[places[0]].suspect
        rest = tuple(replace(t, host=host) for t in best)
        terms = account.terms[: places[-1] + 1] + rest + account.terms[places[-1] + 1 :]
        return settle(replace(account, terms=terms), ledger)
    return trial


def _dear(trial: Account, start: int, ledger: Ledger) -> bool:
    """Whether the terms from ``start`` on bring less than their sizes cost, once the noise and all
    others are fitted anew.
    """
    places = list(range(start, len(trial.terms)))
    gain = sum(float(t @ t) for t in case_of(trial, ledger, places).target) - trial.deviance
    return gain < price_of(ledger) * sum(len(trial.terms[k].names) for k in places)


def _power(signal: Sequence[Array]) -> Array:
    """Energy of a signal in each channel, (channels,)."""
    return np.array([float(s @ s) for s in signal])


def _alike(power: Array, curve: Rival, trial: Account, ledger: Ledger) -> bool:
    """Whether a curve shows in the channels that a finding shows in."""
    other = _power(
        case_of(
            trial, ledger, list(range(len(trial.terms) - len(curve.terms), len(trial.terms)))
        ).signal
    )
    return float(other[power > SHARE * power.sum()].sum()) > OWN * float(other.sum())


def best_curve(case: Case, ledger: Ledger) -> Rival | None:
    """The worthiest curve, its form made local when that says the same with fewer numbers."""
    found = explanations(case, ledger, is_curve)
    if not found:
        return None
    of_angle = next((r for r in found if angle_of(r) is not None), None)
    rings = next((r for r in found if is_echo(r)), None)
    trials = [
        *found,
        *(local(of_angle, case, ledger) if of_angle else []),
        *([echo(rings, case, ledger)] if rings else []),
    ]
    top = max(r.worth for r in trials)
    equal = [r for r in trials if r.worth > top - EQUAL - LOOSE * r.gain]
    moves_all = any(
        r.suspect.effect.sensor is None for r in equal
    )  # the table or the mount may be to blame as well

    def rank(r: Rival) -> tuple[bool, bool, float]:  # a known place first, then the reading itself
        return (
            r.suspect.alias is None or moves_all,
            not isinstance(r.suspect.effect, LearnedReading),
            -r.worth,
        )

    return min(equal, key=rank)
