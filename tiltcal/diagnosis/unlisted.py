"""When no name fits: a curve in place of a finding, or of what the findings leave over."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from tiltcal.diagnosis.account import Account, Term, models, noise_within_stops, settle
from tiltcal.diagnosis.evidence import Ledger
from tiltcal.diagnosis.rivals import EQUAL, LOOSE, OWN, Case, Rival, case_of, explain, explanations, preferred, price_of
from tiltcal.diagnosis.select import ALPHA, Gate, backward, findings, log_tail, log_tries
from tiltcal.diagnosis.suspects import Suspect
from tiltcal.effects.learned import ANGLES, Learned, LearnedReading
from tiltcal.frames import Array

MARGIN = 10.0  # nats of evidence, twice, that a nameless curve has to be better by than a name
SHARPER = 4  # times three
SHARE = 1 - OWN  # and this share of the gain: a law that is some per cent off its textbook form keeps its name

Shape = tuple[tuple[float, ...], tuple[int, ...]]
"""Knots of a curve, and those of them that are free."""

STEP = (0, 2)  # knots of a step: the middle one has nothing, so that a step has two numbers, one of them an offset


def is_curve(suspect: Suspect) -> bool:
    """Whether it has no form of its own: no name, or a name that says only where it acts."""
    return not suspect.textbook


def nameless(account: Account, ledger: Ledger, gate: Gate) -> Account:
    """One cause in place of several where it explains as much, a curve where no name does; then what is left over."""
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
        trial = settle(replace(account, terms=kept + better.terms), ledger)
        if gate.log_p(trial, ledger)[-1] < np.log(ALPHA):
            return nameless(trial, ledger, gate)
    return leftover(account, ledger, gate)


def _better(inside: Sequence[Term], case: Case, ledger: Ledger, weakest: float = 0.0) -> Rival | None:
    """What should stand in the place of some findings: one name for several, or a curve for names that do not fit.

    Args:
        weakest: energy of the weakest of several findings: one name for all may miss a share of that at most.
    """
    named = [r for r in explanations(case, ledger, lambda s: s.textbook) if r.fair and r.own >= OWN]
    single = preferred(named, case.signal) if named else None
    joint, several = _worth_of(inside, case, ledger), sum(t.host is None for t in inside)
    if several > 1 and single is not None and single.worth > joint - EQUAL - min(LOOSE * single.gain, SHARE * weakest):
        return single
    curve = best_curve(case, ledger)
    if curve is None:
        return None
    if several > 1 and (single is None or joint > single.worth + MARGIN + SHARE * curve.gain):
        one_cause = curve.worth > joint - MARGIN * (several - 1) - LOOSE * curve.gain  # is likelier than several
        return curve if one_cause else None
    level = 0.0 if single is None else max(single.worth, joint if several == 1 else 0.0)
    far_off = curve.worth > level + MARGIN + SHARE * curve.gain
    if several > 1 and curve.sizes <= sum(len(t.names) for t in inside) and curve.worth > joint - EQUAL:
        return curve if far_off else single  # one cause with as few numbers says the same as several
    return curve if far_off else None


def _worth_of(inside: Sequence[Term], case: Case, ledger: Ledger) -> float:
    """What the findings bring less the price of their sizes."""
    whole = sum(float(t @ t) for t in case.target)
    left = sum(float((t - s) @ (t - s)) for t, s in zip(case.target, case.signal, strict=True))
    return whole - left - price_of(ledger) * sum(len(t.names) for t in inside)


def leftover(account: Account, ledger: Ledger, gate: Gate) -> Account:
    """What is left over and significant, looked for in the noise within the stops too: what differs from stop to stop by any
    law of its own is a random walk to the spectrum of the whole record, and within the stops it is not there.
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
    chance = log_tail(curve.gain, curve.sizes) + log_tries(curve.suspect, curve.sizes, len(ledger.suspects))
    if chance > np.log(ALPHA):
        return account
    trial = settle(replace(account, terms=account.terms + curve.terms), ledger)
    if gate.log_p(trial, ledger)[-1] >= np.log(ALPHA) or _dear(trial, len(account.terms), ledger):
        return settle(account, ledger)
    shares = [_power(case_of(account, ledger, places).signal) for places in findings(account)]
    gains = [float(p.sum()) for p in shares]
    if gains and curve.gain < SHARE * max(gains) and _alike(shares[k := int(np.argmax(gains))], curve, trial, ledger):
        places = findings(account)[k]
        host = account.terms[places[0]].suspect
        rest = tuple(replace(t, host=host) for t in curve.terms)
        terms = account.terms[: places[-1] + 1] + rest + account.terms[places[-1] + 1 :]
        return settle(replace(account, terms=terms), ledger)
    return trial


def _dear(trial: Account, start: int, ledger: Ledger) -> bool:
    """Whether the terms from ``start`` on bring less than their sizes cost, once the noise and all others are fitted anew."""
    places = list(range(start, len(trial.terms)))
    gain = sum(float(t @ t) for t in case_of(trial, ledger, places).target) - trial.deviance
    return gain < price_of(ledger) * sum(len(trial.terms[k].names) for k in places)


def _power(signal: Sequence[Array]) -> Array:
    """Energy of a signal in each channel, (channels,)."""
    return np.array([float(s @ s) for s in signal])


def _alike(power: Array, curve: Rival, trial: Account, ledger: Ledger) -> bool:
    """Whether a curve shows in the channels that a finding shows in."""
    other = _power(case_of(trial, ledger, list(range(len(trial.terms) - len(curve.terms), len(trial.terms)))).signal)
    return float(other[power > SHARE * power.sum()].sum()) > OWN * float(other.sum())


def best_curve(case: Case, ledger: Ledger) -> Rival | None:
    """The worthiest curve, its form made local when that says the same with fewer numbers."""
    found = explanations(case, ledger, is_curve)
    if not found:
        return None
    of_angle = next((r for r in found if _angle_of(r) is not None), None)
    trials = [*found, *(_local(of_angle, case, ledger) if of_angle else [])]
    top = max(r.worth for r in trials)
    equal = [r for r in trials if r.worth > top - EQUAL - LOOSE * r.gain]

    def rank(r: Rival) -> tuple[bool, bool, float]:  # a known place first, then the reading itself
        return r.suspect.alias is None, not isinstance(r.suspect.effect, LearnedReading), -r.worth

    return min(equal, key=rank)


def _local(rival: Rival, case: Case, ledger: Ledger) -> list[Rival]:
    """Bumps and steps over the coordinate of a curve, in its place, on all the axes that it may act on."""
    column = ANGLES[_angle_of(rival) or ""]
    angles = [a for r in ledger.observations.recordings if (a := r.table(column)) is not None]
    low, high = min(float(np.nanmin(a)) for a in angles), max(float(np.nanmax(a)) for a in angles)
    found = _best_of(local_shapes(low, high), rival, case, ledger)
    steps = _best_of([s for s in local_shapes(low, high) if s[1] == STEP], rival, case, ledger)
    for _ in range(SHARPER if steps else 0):  # as sharp as it is crossed
        left, middle, right = _knots_of(steps[0].suspect)
        reach = (right - left) / 2
        near = [step_at(middle + reach * k / 4, reach / 3) for k in range(-4, 5)]
        steps = max(steps, _best_of(near, rival, case, ledger), key=lambda f: f[0].worth if f else -np.inf)
        if _knots_of(steps[0].suspect) == (left, middle, right):
            break
    return [*found[:2], *steps[:1]]


def _angle_of(rival: Rival) -> str | None:
    """The one table angle that a curve goes over."""
    effect = rival.suspect.effect
    return effect.coordinate if isinstance(effect, Learned) and effect.coordinate in ANGLES and not effect.beside else None


def _best_of(shapes: Sequence[Shape], rival: Rival, case: Case, ledger: Ledger) -> list[Rival]:
    """The best two of some shapes, each on all axes that the rival acts on; all that were tried are paid for."""
    own = Ledger(ledger.observations)
    for suspect in shaped(rival, shapes):
        own.add(suspect, ())
    own.roots = ledger.roots
    best: dict[tuple[float, ...], float] = {}
    scores = own.scores(case.basis, case.target)
    for score in scores:
        knots = _knots_of(score.suspect)
        best[knots] = best.get(knots, 0.0) + score.best(price_of(ledger))[0]
    found = []
    for knots in sorted(best, key=lambda k: -best[k])[:2]:
        mine = max((s for s in scores if _knots_of(s.suspect) == knots), key=lambda s: s.gain()[0])
        if (local := explain(mine.suspect, case, own)) is not None:
            found.append(replace(local, worth=local.worth - 2 * np.log(len(best))))
    return found


def _knots_of(suspect: Suspect) -> tuple[float, ...]:
    return getattr(suspect.effect, "knots", ())


def local_shapes(low: float, high: float) -> list[Shape]:
    """Bumps and steps at every position and width over an angle from ``low`` to ``high``."""
    found: list[Shape] = []
    for width in (0.15, 0.3, 0.6):
        for middle in np.arange(low, high, width):
            found.append((tuple(float(middle + width * k) for k in (-3, -2, -1, 0, 1, 2, 3)), (2, 3, 4)))
            found.append(step_at(middle, 1.5 * width))
    return found


def step_at(middle: float, reach: float) -> Shape:
    """From one level to another within ``reach`` to both sides of an angle."""
    return tuple(float(middle + reach * k) for k in (-1, 0, 1)), STEP


def shaped(rival: Rival, shapes: Sequence[Shape]) -> Iterator[Suspect]:
    """The curves of a rival in other shapes."""
    for knots, free in shapes:
        values = {f"c{k}": 1e-6 for k in free}
        for term in rival.terms:
            if isinstance(term.suspect.effect, Learned):
                yield Suspect(replace(term.suspect.effect, values=values, knots=knots), tuple(values))
