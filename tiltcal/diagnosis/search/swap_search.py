"""A second way to an account: textbook forms only, several at once, each exchanged for another as
long as that is better.

A form with its family is supple: where two effects are at work, the family of one takes a part of
    the other with it. Plain
forms have no such reach. Whichever account says the same with fewer numbers is kept.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tiltcal.diagnosis.hypotheses.hypothesis import Suspect
from tiltcal.diagnosis.model.fitted_model import Account, models, settle
from tiltcal.diagnosis.model.hypothesis_columns import Ledger
from tiltcal.diagnosis.search.alternatives import (
    EQUAL,
    LOOSE,
    case_of,
    explanations,
    preferred,
    price_of,
)
from tiltcal.diagnosis.search.forward_selection import (
    MOST,
    Gate,
    backward,
    best_explanation,
    findings,
    joined,
    signal_of,
)
from tiltcal.diagnosis.search.shape_refinement import at_its_instant, refined, shapes
from tiltcal.statistics.noise_spectrum import NoiseModel, robust_white

FINDING = 10.0  # of deviance: one cause is likelier than two
EXCHANGES = 6


def plainer(
    rich: Account, start: Account, ledger: Ledger, gate: Gate, wanted: Callable[[Suspect], bool]
) -> Account:
    """The account in plain forms where it says as much as ``rich`` with fewer numbers; else
    ``rich``.

    Args:
        start: without findings; the search begins under the noise that is left when ``rich`` is
            taken away.
    """
    if not rich.terms:
        return _several(rich, start, ledger, gate, wanted)
    if len(rich.terms) == 1:  # found while the noise was not known yet
        other = backward(exchanged(rich, ledger, wanted), ledger, gate)
        return other if other.terms else backward(rich, ledger, gate)
    after = ledger.roots
    plain = []
    for forms in _forms(wanted, ledger):
        plain.append(plainly(start, ledger, gate, forms))
        ledger.weigh(after)
    other = settle(rich, ledger)
    gain = settle(replace(start, terms=()), ledger).deviance - other.deviance
    least, one = min(
        ((burden(p, ledger, gate), p) for p in plain if p.terms),
        key=lambda pair: pair[0],
        default=(np.inf, rich),
    )
    if least <= burden(rich, ledger, gate) + LOOSE * gain:
        ledger.under(models(gate.noise(one, ledger)))
        return settle(one, ledger)
    ledger.weigh(after)
    return other


def _several(
    rich: Account, start: Account, ledger: Ledger, gate: Gate, wanted: Callable[[Suspect], bool]
) -> Account:
    """What several textbook forms do together, where none by itself stands out; else ``rich``.

    Looked for in white noise: together they are a random walk to the record.
    """
    usual = ledger.roots
    for forms in _forms(wanted, ledger):
        ledger.under(
            [NoiseModel(robust_white(r)) for r in ledger.observations.residuals(start.effects)]
        )
        several = plainly(start, ledger, gate, forms)
        if several.terms:
            return several
    ledger.weigh(usual)
    return rich


def _forms(wanted: Callable[[Suspect], bool], ledger: Ledger) -> list[Callable[[Suspect], bool]]:
    """The laws as they are printed, then those that are felt late or bent among them, if any: these
    are supple themselves.
    """
    supple = any(wanted(s) and s.alias is not None for s in ledger.suspects)
    return [lambda s: wanted(s) and s.alias is None, *([wanted] if supple else [])]


def plainly(
    account: Account, ledger: Ledger, gate: Gate, wanted: Callable[[Suspect], bool]
) -> Account:
    """Up to MOST textbook forms, each in its turn the best in its place; then those dropped that do
    not stand out.
    """
    account = settle(account, ledger)
    while len(findings(account)) < MOST:
        rivals = best_explanation(account, ledger, wanted, alone=True)
        if not rivals:
            break
        pick = preferred(rivals, signal_of(rivals[0], account, ledger))
        terms = at_its_instant(refined(pick.terms, account, ledger), account, ledger, alone=True)
        account = exchanged(
            settle(replace(account, terms=account.terms + terms), ledger), ledger, wanted
        )
        account = reshaped(account, ledger)
    account = backward(account, ledger, gate)
    return backward(trimmed(joined(exchanged(account, ledger, wanted)), ledger), ledger, gate)


def trimmed(account: Account, ledger: Ledger) -> Account:
    """The account without sizes that bring less than they cost: a finding had them from what others
    explain since.

    The last size of a finding stays: whether it is needed is asked of findings as a whole.
    """
    price = price_of(ledger)
    while True:
        account = settle(account, ledger)
        sigmas = [
            np.maximum(account.sigmas(k), np.finfo(float).tiny) for k in range(len(account.terms))
        ]  # 0: not determined
        told = [
            (np.asarray(t.values) / sigma) ** 2
            for t, sigma in zip(account.terms, sigmas, strict=True)
        ]
        least = [(float(x.min()), k, int(x.argmin())) for k, x in enumerate(told) if len(x) > 1]
        if not least or min(least)[0] >= price:
            return account
        _, k, i = min(least)
        terms = list(account.terms)
        term = terms[k]
        terms[k] = replace(
            term,
            names=term.names[:i] + term.names[i + 1 :],
            values=term.values[:i] + term.values[i + 1 :],
        )
        account = replace(account, terms=tuple(terms))


def exchanged(account: Account, ledger: Ledger, wanted: Callable[[Suspect], bool]) -> Account:
    """The account with each finding replaced by what explains more in its place."""
    for _ in range(EXCHANGES):
        for places in findings(account):
            case = case_of(account, ledger, places)
            whole = sum(float(t @ t) for t in case.target)
            left = sum(
                float((t - s) @ (t - s)) for t, s in zip(case.target, case.signal, strict=True)
            )
            mine = (
                whole - left - price_of(ledger) * sum(len(account.terms[k].names) for k in places)
            )
            found = [r for r in explanations(case, ledger, wanted, alone=True) if r.fair]
            if (
                found
                and found[0].suspect.place != account.terms[places[0]].suspect.place
                and found[0].worth > mine + EQUAL
            ):
                kept = tuple(t for k, t in enumerate(account.terms) if k not in places)
                base = settle(replace(account, terms=kept), ledger)
                terms = at_its_instant(
                    refined(found[0].terms, base, ledger), base, ledger, alone=True
                )
                account = settle(replace(base, terms=kept + terms), ledger)
                break
        else:
            break
    return account


def reshaped(account: Account, ledger: Ledger) -> Account:
    """The account with the shapes of its findings found again: one that was found by itself took a
    part of the others, and the
    noise was another.
    """
    groups = findings(account)
    for _ in range(EXCHANGES if len(groups) > 1 else 1):
        before = account.deviance
        for places in groups:
            if shapes(account.terms[places[0]].suspect):
                account = _reshaped(account, places, ledger)
        if account.deviance > before - EQUAL:
            break
    return account


def _reshaped(account: Account, places: Sequence[int], ledger: Ledger) -> Account:
    """The account with one finding at its best shape nearby, where that is better; the sizes of all
    others are free meanwhile.
    """
    others = tuple(t for k, t in enumerate(account.terms) if k not in places)
    new = refined(
        tuple(account.terms[k] for k in places),
        settle(replace(account, terms=others), ledger),
        ledger,
    )
    terms = list(account.terms)
    terms[places[0] : places[-1] + 1] = new
    trial = settle(replace(account, terms=tuple(terms)), ledger)
    return trial if trial.deviance < account.deviance else account


def burden(account: Account, ledger: Ledger, gate: Gate) -> float:
    """Twice the negative log likelihood, but for a constant, with the price of all numbers and of
    all findings.

    Under the noise that the account itself leaves: under that of another it would be charged for
        what it calls noise.
    """
    noise = models(gate.noise(account, ledger))
    ledger.under(noise)
    spread = sum(
        float(np.log(m.spectrum(len(c.values))).sum())
        for m, c in zip(noise, ledger.observations.channels, strict=True)
    )
    sizes = sum(len(t.names) for t in account.terms)
    return (
        settle(account, ledger).deviance
        + spread
        + price_of(ledger) * sizes
        + FINDING * len(findings(account))
    )
