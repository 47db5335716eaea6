"""Which suspects stay: forward by penalised score, through the gate of the noise, backward until
every one is needed.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Columns, Observations
from tiltcal.diagnosis.hypotheses.families import FREE_FORM, OF_INPUT, WANDER
from tiltcal.diagnosis.hypotheses.hypothesis import SHIFTS, STEPS, Suspect
from tiltcal.diagnosis.model.fitted_model import (
    Account,
    Term,
    models,
    noise_under,
    noise_within_stops,
    settle,
    summed,
    whitened_of,
)
from tiltcal.diagnosis.model.hypothesis_columns import Ledger, basis_of, project, projected
from tiltcal.diagnosis.search.alternatives import (
    LOOSE,
    OWN,
    Case,
    Rival,
    case_of,
    explanations,
    fair,
    preferred,
    price_of,
)
from tiltcal.diagnosis.search.shape_refinement import at_its_instant, refined
from tiltcal.effects.base import Effect
from tiltcal.statistics.noise_spectrum import NoiseFit, NoiseModel

# of the worth of the best: a name in its own form goes before one that needs curves for more
NEARLY = 0.7
REST = 0.2  # share of a free form that its first curve may leave
ALPHA = 0.01  # family-wise, over everything that was tried
PATIENCE = 6  # suspects that may be sent away
MOST = 4  # findings a recording may be given
NEXT = 2.0  # samples to either side of a step's instant that it has to show without


def log_tail(gain: float, dof: int) -> float:
    """Natural logarithm of the chance that chi-square exceeds ``gain``."""
    from scipy.special import gammaincc, gammaln

    if dof <= 0:
        return 0.0
    p = float(gammaincc(dof / 2, gain / 2))
    if p > 1e-290:
        return float(np.log(p))
    x = gain / 2
    return float(-x + (dof / 2 - 1) * np.log(x) - gammaln(dof / 2))


def log_tries(suspect: Suspect, kept: int, total: int) -> float:
    """Logarithm of how many alternatives stood beside this choice: suspects, and subsets of its
    sizes.
    """
    from scipy.special import gammaln

    n = len(suspect.names)
    return float(np.log(max(total, 1)) + gammaln(n + 1) - gammaln(kept + 1) - gammaln(n - kept + 1))


def best_explanation(
    account: Account, ledger: Ledger, wanted: Callable[[Suspect], bool], alone: bool = False
) -> list[Rival]:
    """What would explain most of what is left, the worthiest first: plausible, in its own form, and
    past all that was tried.
    """
    case = Case(list(account.basis), list(account.residual), [0 * r for r in account.residual])
    total = len(ledger.suspects)
    found = explanations(case, ledger, wanted, alone)
    return [
        r
        for r in found
        if r.fair
        and log_tail(r.gain, r.sizes) + log_tries(r.suspect, len(r.terms[0].names), total)
        < np.log(ALPHA)
    ]


@dataclass(frozen=True)
class Gate:
    """The noise a term has to stand out of.

    Args:
        static: noise models of each channel from a record at rest, when there is one.
        total: number of suspects tried.
    """

    static: tuple[NoiseFit, ...] | None
    total: int

    def noise(self, account: Account, ledger: Ledger) -> list[NoiseFit]:
        """The noise when the whole account may be true."""
        return list(self.static) if self.static is not None else noise_under(account, ledger)

    def log_p(self, account: Account, ledger: Ledger) -> list[float]:
        """Corrected log p-value of each found term, in the noisiest way that the recording
        allows.
        """
        fits = self.noise(account, ledger)
        bounds = [f.bounds() for f in fits]
        worst = [-np.inf] * len(findings(account))
        for side in range(2):
            ledger.under([b[side] for b in bounds])
            for k, value in enumerate(standing(account, ledger, self.total)):
                worst[k] = max(worst[k], value)
        ledger.under(models(fits))
        return [float(w) for w in worst]


def standing(
    account: Account, ledger: Ledger, total: int, beside: Sequence[Columns] = ()
) -> list[float]:
    """Corrected log p-value of each finding given all others, and columns ``beside`` them, under
    the ledger's noise.

    That of a step is without the samples next to the instants of steps: what shows in them only is
        a gross error.
    """
    found = []
    near = [
        column
        for t in account.terms
        if t.host is None
        for column in _next_to_the_instant(t, ledger.observations)
    ]
    for places in findings(account):
        inside = [account.terms[k] for k in places]
        step = inside[0].suspect.id in SHIFTS
        case = case_of(account, ledger, places, [*beside, *(near if step else ())])
        lengths = [len(t) for t in case.target]
        columns = whitened_of(ledger, inside, account.effects)
        mine = basis_of([projected(case.basis, c, lengths) for c in columns], lengths)
        along = np.sum([U.T @ r for U, r in zip(mine, case.target, strict=True)], axis=0)
        tries = sum(log_tries(t.suspect, len(t.names), total) for t in inside[:1])
        found.append(log_tail(float(along @ along), mine[0].shape[1]) + tries)
    return found


def _next_to_the_instant(term: Term, observations: Observations) -> Iterator[Columns]:
    """Each sample next to the instant of a step, one column for each."""
    if term.suspect.id not in SHIFTS:
        return
    for i, channel in enumerate(observations.channels):
        if channel.derived or channel.recording or len(channel.time) < 2:
            continue
        away = np.abs(
            channel.time - observations.recordings[0].time[0] - term.effect.values["time"]
        )
        for row in np.flatnonzero(away < NEXT * np.median(np.diff(channel.time))):
            yield {i: (np.arange(len(away)) == row).astype(float)}


def select(
    account: Account, ledger: Ledger, gate: Gate, wanted: Callable[[Suspect], bool]
) -> Account:
    """Add what explains the residual best, as long as it stands out of the noise; then drop what is
    not needed.

    The scan weighs by white noise at first, so that no effect is taken for noise; what does not
    stand out of the noise that
    is left when it is taken away waits, and may pass together with another. With each that is kept
    the noise is known better;
    where nothing stands out of it any more the scan weighs by white noise again, for a slow effect
    was in that noise, and in
    the end by the noise within the stops, where what differs from stop to stop is no random walk.
    """
    waiting: tuple[Term, ...] = ()
    banned: set[int] = set()
    patience, looks = PATIENCE, [] if gate.static is not None else [noise_within_stops]
    look = None
    while len(findings(account)) < MOST and patience:
        trial = settle(replace(account, terms=account.terms + waiting), ledger)
        rivals = best_explanation(trial, ledger, _outside(wanted, frozenset(banned)))
        if look is _white_noise:  # some curve fits any slow noise: only a form of its own
            rivals = [r for r in rivals if r.own >= OWN]
        if (
            not rivals
        ):  # look again in another noise: without those who wait, then white, then within the stops
            noise: list[NoiseFit] | None = None
            if waiting:
                noise = gate.noise(settle(account, ledger), ledger)
            elif looks:
                look = looks.pop(0)
                noise = look(account, ledger)
            if noise is None:
                break
            waiting = ()
            ledger.under(models(noise))
            account = settle(account, ledger)
            continue
        own = [r for r in rivals if r.own >= OWN and r.worth > NEARLY * rivals[0].worth]
        pick = preferred(
            own or rivals, trial.residual if not own else signal_of(own[0], trial, ledger)
        )
        terms = _hosted(
            at_its_instant(refined(pick.terms, trial, ledger), trial, ledger),
            pick.gain,
            trial,
            ledger,
        )
        trial = settle(replace(trial, terms=trial.terms + terms), ledger)
        needed = [value < np.log(ALPHA) for value in gate.log_p(trial, ledger)]
        if (
            needed[-1]
            and not all(needed)
            and (other := _without(trial, needed, account, ledger, gate)) is not None
        ):
            trial, needed, patience = other, [True], patience - 1
        if all(needed) and (whole := _grown(trial, account, ledger)) is not None:
            account, waiting, banned = whole, (), set()
            looks, look = (
                [] if gate.static is not None else [_white_noise, noise_within_stops],
                None,
            )
            continue
        patience -= 1
        banned.add(id(pick.suspect))
        waiting = trial.terms[len(account.terms) :] if len(waiting) < 2 and not all(needed) else ()
        ledger.under(models(gate.noise(trial if waiting else account, ledger)))
    return backward(account, ledger, gate)


def _grown(trial: Account, before: Account, ledger: Ledger) -> Account | None:
    """A trial with its findings joined; None where one is a further shape of what was there before,
    and brings nothing.
    """
    whole = settle(joined(trial), ledger)
    further = len(findings(whole)) == len(findings(before))
    return (
        None if further and _cost(whole, ledger) >= _cost(settle(before, ledger), ledger) else whole
    )


def _without(
    trial: Account, needed: Sequence[bool], before: Account, ledger: Ledger, gate: Gate
) -> Account | None:
    """An account without the findings that the newest one makes needless; None where it is no
    better than the one before.
    """
    terms = [
        trial.terms[k]
        for places, keep in zip(findings(trial), needed, strict=True)
        if keep
        for k in places
    ]
    other = settle(replace(trial, terms=tuple(terms)), ledger)
    cheaper = _cost(other, ledger) < _cost(settle(before, ledger), ledger)
    return (
        other
        if cheaper and all(value < np.log(ALPHA) for value in gate.log_p(other, ledger))
        else None
    )


def _cost(account: Account, ledger: Ledger) -> float:
    """Deviance and the price of all sizes."""
    return account.deviance + price_of(ledger) * sum(len(t.names) for t in account.terms)


def _white_noise(account: Account, ledger: Ledger) -> list[NoiseFit]:
    """The noise of each channel without what is slow in it."""
    return [NoiseFit.whole(NoiseModel(fit.model.white)) for fit in noise_under(account, ledger)]


def _outside(
    wanted: Callable[[Suspect], bool], banned: frozenset[int]
) -> Callable[[Suspect], bool]:
    """Wanted, and not sent away already."""
    return lambda suspect: wanted(suspect) and id(suspect) not in banned


def _hosted(
    terms: tuple[Term, ...], gain: float, account: Account, ledger: Ledger
) -> tuple[Term, ...]:
    """A further function of a channel's own input completes a converter's curve that is much
    larger: no finding of its own.
    """
    for places in findings(account):
        host = account.terms[places[0]].suspect
        if host.id in FREE_FORM and terms[0].suspect.id in OF_INPUT and host.id in OF_INPUT:
            energy = sum(float(s @ s) for s in case_of(account, ledger, places).signal)
            if gain < REST * energy and places[-1] == len(account.terms) - 1:
                return tuple(replace(t, host=host) for t in terms)
    return terms


KINDS = ("motion", "direction", "vibration")  # of excitation, whose laws are alike
ENCODER = {
    "table_encoder_eccentricity",
    "table_encoder_2rev",
    "table_encoder_sde",
}  # harmonics of one curve
TONES = ("mains_pickup", "base_vibration")  # a line that wanders leaves lines beside it


def absorbed(account: Account, ledger: Ledger) -> Account:
    """The account with small findings made a part of a much larger one that the same kind of motion
    excites, in its channels.

    A law that is some per cent off its textbook form leaves something of its own kind over, and a
        neighbour takes it: a share of
    what the law explains without that neighbour, for both may do nearly the same.
    """
    groups = findings(account)

    def power_of(places: Sequence[int]) -> Array:
        return np.array([float(s @ s) for s in case_of(account, ledger, places).signal])

    power = [power_of(places) for places in groups]
    hosts = {}
    for j, small in enumerate(groups):
        mine = account.terms[small[0]].suspect.effect
        for k, large in enumerate(groups):
            other = account.terms[large[0]].suspect.effect
            share = _left_over(mine, other) if j != k else 0.0
            if not share or k in hosts:
                continue
            alone = power_of(sorted([*small, *large])) - power[j]
            inside = (
                share == 1
                or np.minimum(power[j], share * np.maximum(alone, 0.0)).sum() > OWN * power[j].sum()
            )
            if inside and power[j].sum() < min(share * alone.sum(), power[k].sum()):
                hosts[j] = k
    if not hosts:
        return account
    terms: list[Term] = []
    for k, places in enumerate(groups):
        if k in hosts:
            continue
        terms += [account.terms[i] for i in places]
        host = account.terms[places[0]].suspect
        terms += [
            replace(account.terms[i], host=host)
            for j, large in hosts.items()
            if large == k
            for i in groups[j]
        ]
    return settle(replace(account, terms=tuple(terms)), ledger)


def _left_over(small: Effect, large: Effect) -> float:
    """Share of the energy of a large effect that may be left over of it in the form of a small one.

    All of it where a line wanders: it leaves lines beside it. Motion that excites both, or one
        encoder's curve over its angle,
    is never quite of a textbook form. Laws of one sensor's own input are told apart to a
    thousandth.
    """
    ids = {small.id, large.id}
    if ids <= set(TONES):
        near = abs(small.value("frequency") - large.value("frequency")) < WANDER
        return 1.0 if near else 1 - OWN
    if small.needs == large.needs in KINDS or (ids <= ENCODER and small.axis == large.axis):
        return 1 - OWN
    return LOOSE if ids <= OF_INPUT and small.sensor == large.sensor else 0.0


def joined(account: Account) -> Account:
    """The account with a second finding of one name at one place made a part of the first: a law at
    a further shape.
    """
    groups = findings(account)
    order: list[list[Term]] = []
    for places in groups:
        inside = [account.terms[k] for k in places]
        mine = inside[0].suspect
        first = next(
            (
                g
                for g in order
                if g[0].suspect.place == mine.place and _one_event(g[0].suspect, mine)
            ),
            None,
        )
        if first is None:
            order.append(inside)
        else:
            first += [replace(t, host=first[0].suspect) for t in inside]
    return (
        account
        if len(order) == len(groups)
        else replace(account, terms=tuple(t for g in order for t in g))
    )


def _one_event(one: Suspect, other: Suspect) -> bool:
    """Whether two of one name are one: steps where one creeps on that began within its time
    constant of the other.
    """
    if one.id not in STEPS:
        return True
    creeps = [s.effect.values.get("creep", 0.0) for s in (one, other)]
    apart = abs(one.effect.values["time"] - other.effect.values["time"])
    return min(creeps) == 0 and apart < max(creeps)


def signal_of(rival: Rival, account: Account, ledger: Ledger) -> list[Array]:
    """What a rival would put into the readings, without the part that is re-tuned away."""
    whole = ledger.whitened(summed(rival.terms, ledger.observations, account.effects))
    total = [whole.get(i, np.zeros_like(r)) for i, r in enumerate(account.residual)]
    return project(account.basis, total)


def findings(account: Account) -> list[list[int]]:
    """Places of the terms of each finding: what stands by itself and what completes its form."""
    found: list[list[int]] = []
    for k, term in enumerate(account.terms):
        if term.host is None:
            found.append([k])
        else:
            found[-1].append(k)
    return found


def backward(account: Account, ledger: Ledger, gate: Gate) -> Account:
    """Drop findings one by one that do not stand out once the others are there."""
    while account.terms:
        account = plausible(settle(account, ledger), ledger)
        if not account.terms:
            break
        values = gate.log_p(account, ledger)
        groups = findings(account)
        worst = max(range(len(groups)), key=lambda j: values[j])
        if values[worst] < np.log(ALPHA):
            break
        account = replace(
            account, terms=tuple(t for k, t in enumerate(account.terms) if k not in groups[worst])
        )
    ledger.under(models(gate.noise(account, ledger)))
    return settle(account, ledger)


def worth_their_numbers(account: Account, ledger: Ledger, gate: Gate) -> Account:
    """The account under the noise that it leaves itself, without findings that bring less there
    than their numbers cost.
    """
    while True:
        ledger.under(models(gate.noise(account, ledger)))
        account = settle(account, ledger)
        groups = findings(account)
        worth = [_worth(account, ledger, places) for places in groups]
        if not groups or min(worth) >= 0:
            return account
        worst = groups[worth.index(min(worth))]
        account = replace(
            account, terms=tuple(t for k, t in enumerate(account.terms) if k not in worst)
        )


def _worth(account: Account, ledger: Ledger, places: Sequence[int]) -> float:
    """Fall of the deviance by a finding less the price of its numbers."""
    gain = sum(float(t @ t) for t in case_of(account, ledger, places).target) - account.deviance
    return gain - price_of(ledger) * sum(len(account.terms[k].names) for k in places)


def plausible(account: Account, ledger: Ledger) -> Account:
    """The account without findings whose sizes, once all others are there, are those of no
    instrument.

    What completes a form goes too where it has a size that no file may give it: a width below
        nothing.
    """
    while True:
        good = [places for places in findings(account) if fair(account.terms[places[0]])]
        terms = tuple(
            account.terms[k]
            for places in good
            for k in places
            if k == places[0] or _written(account.terms[k])
        )
        if len(terms) == len(account.terms):
            return account
        account = settle(replace(account, terms=terms), ledger)


def _written(term: Term) -> bool:
    """Whether a scenario file may give an effect these sizes."""
    positive = {p.name for p in term.suspect.effect.parameters if p.positive}
    return all(
        value >= 0 for name, value in zip(term.names, term.values, strict=True) if name in positive
    )
