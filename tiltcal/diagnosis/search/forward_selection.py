"""Which hypotheses stay: forward by penalised score, through the gate of the noise, backward until
every one is needed.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Columns, Observations
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.model.cosine_basis import basis_of, project, projected
from tiltcal.diagnosis.model.fitted_model import (
    FittedModel,
    FittedTerm,
    models,
    noise_under,
    noise_within_stops,
    refit,
    summed,
    whitened_of,
)
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.alternatives import (
    LOOSE,
    OWN,
    Alternative,
    RemovedFinding,
    fair,
    preferred,
    price_of,
    rank_alternatives,
    remove_finding,
)
from tiltcal.diagnosis.search.shape_refinement import at_its_instant, refined
from tiltcal.effects.base import Effect
from tiltcal.effects.electronics.mains import WANDER
from tiltcal.effects.table.readout import ReadoutError
from tiltcal.statistics.noise_spectrum import NoiseFit, white_noise

# of the worth of the best: a name in its own form goes before one that needs curves for more
NEARLY = 0.7
REST = 0.2  # share of a free form that its first curve may leave
ALPHA = 0.01  # family-wise, over everything that was tried
PATIENCE = 6  # hypotheses that may be sent away
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


def log_alternatives(hypothesis: Hypothesis, kept: int, total: int) -> float:
    """Logarithm of how many alternatives stood beside this choice: hypotheses, and subsets of its
    sizes.
    """
    from scipy.special import gammaln

    n = len(hypothesis.names)
    return float(np.log(max(total, 1)) + gammaln(n + 1) - gammaln(kept + 1) - gammaln(n - kept + 1))


def best_alternatives(
    fitted: FittedModel,
    whitened: WhitenedModel,
    wanted: Callable[[Hypothesis], bool],
    alone: bool = False,
) -> list[Alternative]:
    """What would explain most of what is left, the worthiest first: plausible, in its own form, and
    past all that was tried.
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


@dataclass(frozen=True)
class NoiseGate:
    """The noise a term has to stand out of.

    Args:
        static: noise models of each channel from a record at rest, when there is one.
        total: number of hypotheses tried.
    """

    static: tuple[NoiseFit, ...] | None
    total: int

    def noise(self, fitted: FittedModel, whitened: WhitenedModel) -> list[NoiseFit]:
        """The noise when the whole fitted model may be true."""
        return (
            list(self.static)
            if self.static is not None
            else noise_under(fitted, whitened.columns, law=whitened.law)
        )

    def left_by(self, fitted: FittedModel, whitened: WhitenedModel) -> WhitenedModel:
        """The same columns under the noise that a fitted model leaves."""
        return whitened.under(models(self.noise(fitted, whitened)))

    def log_p(
        self, fitted: FittedModel, whitened: WhitenedModel
    ) -> tuple[list[float], WhitenedModel]:
        """Corrected log p-value of each finding under the noisiest models that the recording
        allows, and the columns under the most likely noise.
        """
        fits = self.noise(fitted, whitened)
        bounds = [f.bounds() for f in fits]
        sides = [
            finding_log_p_values(fitted, whitened.under([b[side] for b in bounds]), self.total)
            for side in range(2)
        ]
        worst = [max(pair) for pair in zip(*sides, strict=True)]
        return worst, whitened.under(models(fits))


def finding_log_p_values(
    fitted: FittedModel, whitened: WhitenedModel, total: int, beside: Sequence[Columns] = ()
) -> list[float]:
    """Corrected log p-value of each finding given all others, and columns ``beside`` them, under
    the whitened model's noise.

    That of a step is without the samples next to the instants of steps: what shows in them only is
        a gross error.
    """
    found = []
    near = [
        column
        for t in fitted.terms
        if t.host is None
        for column in _next_to_the_instant(t, whitened.observations)
    ]
    for places in findings(fitted):
        inside = [fitted.terms[k] for k in places]
        step = inside[0].hypothesis.is_step
        removed = remove_finding(fitted, whitened, places, [*beside, *(near if step else ())])
        lengths = [len(t) for t in removed.target]
        columns = whitened_of(whitened, inside, fitted.effects)
        mine = basis_of([projected(removed.basis, c, lengths) for c in columns], lengths)
        along = np.sum([U.T @ r for U, r in zip(mine, removed.target, strict=True)], axis=0)
        tries = sum(log_alternatives(t.hypothesis, len(t.names), total) for t in inside[:1])
        found.append(log_tail(float(along @ along), mine[0].shape[1]) + tries)
    return found


def _next_to_the_instant(term: FittedTerm, observations: Observations) -> Iterator[Columns]:
    """Each sample next to the instant of a step, one column for each."""
    if not term.hypothesis.is_step:
        return
    for i, channel in enumerate(observations.channels):
        if channel.derived or channel.recording or len(channel.time) < 2:
            continue
        away = np.abs(
            channel.time - observations.recordings[0].time[0] - term.effect.values["time"]
        )
        for row in np.flatnonzero(away < NEXT * np.median(np.diff(channel.time))):
            yield {i: (np.arange(len(away)) == row).astype(float)}


def forward_selection(
    fitted: FittedModel,
    whitened: WhitenedModel,
    gate: NoiseGate,
    wanted: Callable[[Hypothesis], bool],
) -> tuple[FittedModel, WhitenedModel]:
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
    waiting: tuple[FittedTerm, ...] = ()
    banned: set[int] = set()
    patience, looks = PATIENCE, [] if gate.static is not None else [noise_within_stops]
    look = None
    while len(findings(fitted)) < MOST and patience:
        trial = refit(replace(fitted, terms=fitted.terms + waiting), whitened)
        alternatives = best_alternatives(trial, whitened, _outside(wanted, frozenset(banned)))
        if look is _white_noise:  # some curve fits any slow noise: only a form of its own
            alternatives = [r for r in alternatives if r.own >= OWN]
        if (
            not alternatives
        ):  # look again in another noise: without those who wait, then white, then within the stops
            noise: list[NoiseFit] | None = None
            if waiting:
                noise = gate.noise(refit(fitted, whitened), whitened)
            elif looks:
                look = looks.pop(0)
                noise = look(fitted, whitened)
            if noise is None:
                break
            waiting = ()
            whitened = whitened.under(models(noise))
            fitted = refit(fitted, whitened)
            continue
        own = [r for r in alternatives if r.own >= OWN and r.worth > NEARLY * alternatives[0].worth]
        pick = preferred(
            own or alternatives, trial.residual if not own else signal_of(own[0], trial, whitened)
        )
        terms = _hosted(
            at_its_instant(refined(pick.terms, trial, whitened), trial, whitened),
            pick.gain,
            trial,
            whitened,
        )
        trial = refit(replace(trial, terms=trial.terms + terms), whitened)
        values, whitened = gate.log_p(trial, whitened)
        needed = [value < np.log(ALPHA) for value in values]
        if (
            needed[-1]
            and not all(needed)
            and (other := _without(trial, needed, fitted, whitened, gate)) is not None
        ):
            (trial, whitened), needed, patience = other, [True], patience - 1
        if all(needed) and (whole := _grown(trial, fitted, whitened)) is not None:
            fitted, waiting, banned = whole, (), set()
            looks, look = (
                [] if gate.static is not None else [_white_noise, noise_within_stops],
                None,
            )
            continue
        patience -= 1
        banned.add(id(pick.hypothesis))
        waiting = trial.terms[len(fitted.terms) :] if len(waiting) < 2 and not all(needed) else ()
        whitened = gate.left_by(trial if waiting else fitted, whitened)
    return backward_elimination(fitted, whitened, gate)


def _grown(trial: FittedModel, before: FittedModel, whitened: WhitenedModel) -> FittedModel | None:
    """A trial with its findings joined; None where one is a further shape of what was there before,
    and brings nothing.
    """
    whole = refit(merge_same_cause(trial), whitened)
    further = len(findings(whole)) == len(findings(before))
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
    """A fitted model without the findings that the newest one makes needless, under the noise that
    it leaves; None where it is no better than the one before.
    """
    terms = [
        trial.terms[k]
        for places, keep in zip(findings(trial), needed, strict=True)
        if keep
        for k in places
    ]
    other = refit(replace(trial, terms=tuple(terms)), whitened)
    if _cost(other, whitened) >= _cost(refit(before, whitened), whitened):
        return None
    values, left = gate.log_p(other, whitened)
    return (other, left) if all(value < np.log(ALPHA) for value in values) else None


def _cost(fitted: FittedModel, whitened: WhitenedModel) -> float:
    """Deviance and the price of all sizes."""
    return fitted.deviance + price_of(whitened) * sum(len(t.names) for t in fitted.terms)


def _white_noise(fitted: FittedModel, whitened: WhitenedModel) -> list[NoiseFit]:
    """The noise of each channel without what is slow in it."""
    return [
        NoiseFit.known(white_noise(fit.model.white))
        for fit in noise_under(fitted, whitened.columns, law=whitened.law)
    ]


def _outside(
    wanted: Callable[[Hypothesis], bool], banned: frozenset[int]
) -> Callable[[Hypothesis], bool]:
    """Wanted, and not sent away already."""
    return lambda hypothesis: wanted(hypothesis) and id(hypothesis) not in banned


def _hosted(
    terms: tuple[FittedTerm, ...], gain: float, fitted: FittedModel, whitened: WhitenedModel
) -> tuple[FittedTerm, ...]:
    """A further function of a channel's own input completes a converter's curve that is much
    larger: no finding of its own.
    """
    for places in findings(fitted):
        host = fitted.terms[places[0]].hypothesis
        of_input = terms[0].hypothesis.law.nonlinear_in_input and host.law.nonlinear_in_input
        if of_input and host.law.form == "any":
            energy = sum(float(s @ s) for s in remove_finding(fitted, whitened, places).signal)
            if gain < REST * energy and places[-1] == len(fitted.terms) - 1:
                return tuple(replace(t, host=host) for t in terms)
    return terms


KINDS = ("motion", "direction", "vibration")  # of excitation, whose laws are alike


def merge_small_findings(fitted: FittedModel, whitened: WhitenedModel) -> FittedModel:
    """The fitted model with small findings made a part of a much larger one that the same kind of
    motion
    excites, in its channels.

    A law that is some per cent off its textbook form leaves something of its own kind over, and a
        neighbour takes it: a share of
    what the law explains without that neighbour, for both may do nearly the same.
    """
    groups = findings(fitted)

    def power_of(places: Sequence[int]) -> Array:
        return np.array([float(s @ s) for s in remove_finding(fitted, whitened, places).signal])

    power = [power_of(places) for places in groups]
    hosts = {}
    for j, small in enumerate(groups):
        mine = fitted.terms[small[0]].hypothesis.effect
        for k, large in enumerate(groups):
            other = fitted.terms[large[0]].hypothesis.effect
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
        return fitted
    terms: list[FittedTerm] = []
    for k, places in enumerate(groups):
        if k in hosts:
            continue
        terms += [fitted.terms[i] for i in places]
        host = fitted.terms[places[0]].hypothesis
        terms += [
            replace(fitted.terms[i], host=host)
            for j, large in hosts.items()
            if large == k
            for i in groups[j]
        ]
    return refit(replace(fitted, terms=tuple(terms)), whitened)


def _left_over(small: Effect, large: Effect) -> float:
    """Share of the energy of a large effect that may be left over of it in the form of a small one.

    All of it where a line wanders: it leaves lines beside it. Motion that excites both, or one
        encoder's curve over its angle,
    is never quite of a textbook form. Laws of one sensor's own input are told apart to a
    thousandth.
    """
    both = (small, large)
    if all(e.spectral_line == "time" for e in both):
        near = abs(small.value("frequency") - large.value("frequency")) < WANDER
        return 1.0 if near else 1 - OWN
    readouts = all(isinstance(e, ReadoutError) for e in both) and small.axis == large.axis
    if small.needs == large.needs in KINDS or readouts:
        return 1 - OWN
    of_input = all(e.nonlinear_in_input for e in both) and small.sensor == large.sensor
    return LOOSE if of_input else 0.0


def merge_same_cause(fitted: FittedModel) -> FittedModel:
    """The fitted model with a second finding of one name at one place made a part of the first: a
    law at
    a further shape.
    """
    groups = findings(fitted)
    order: list[list[FittedTerm]] = []
    for places in groups:
        inside = [fitted.terms[k] for k in places]
        mine = inside[0].hypothesis
        first = next(
            (
                g
                for g in order
                if g[0].hypothesis.place == mine.place and _one_event(g[0].hypothesis, mine)
            ),
            None,
        )
        if first is None:
            order.append(inside)
        else:
            first += [replace(t, host=first[0].hypothesis) for t in inside]
    return (
        fitted
        if len(order) == len(groups)
        else replace(fitted, terms=tuple(t for g in order for t in g))
    )


def _one_event(one: Hypothesis, other: Hypothesis) -> bool:
    """Whether two of one name are one: steps where one creeps on that began within its time
    constant of the other.
    """
    if not one.has_instant:
        return True
    creeps = [s.effect.values.get("creep", 0.0) for s in (one, other)]
    apart = abs(one.effect.values["time"] - other.effect.values["time"])
    return min(creeps) == 0 and apart < max(creeps)


def signal_of(
    alternative: Alternative, fitted: FittedModel, whitened: WhitenedModel
) -> list[Array]:
    """What a alternative would put into the readings, without the part that is re-tuned away."""
    whole = whitened.whiten(summed(alternative.terms, whitened.observations, fitted.effects))
    total = [whole.get(i, np.zeros_like(r)) for i, r in enumerate(fitted.residual)]
    return project(fitted.basis, total)


def findings(fitted: FittedModel) -> list[list[int]]:
    """Places of the terms of each finding: what stands by itself and what completes its form."""
    found: list[list[int]] = []
    for k, term in enumerate(fitted.terms):
        if term.host is None:
            found.append([k])
        else:
            found[-1].append(k)
    return found


def backward_elimination(
    fitted: FittedModel, whitened: WhitenedModel, gate: NoiseGate
) -> tuple[FittedModel, WhitenedModel]:
    """Drop findings one by one that do not stand out once the others are there."""
    while fitted.terms:
        fitted = drop_implausible_sizes(refit(fitted, whitened), whitened)
        if not fitted.terms:
            break
        values, whitened = gate.log_p(fitted, whitened)
        groups = findings(fitted)
        worst = max(range(len(groups)), key=lambda j: values[j])
        if values[worst] < np.log(ALPHA):
            break
        fitted = replace(
            fitted, terms=tuple(t for k, t in enumerate(fitted.terms) if k not in groups[worst])
        )
    whitened = gate.left_by(fitted, whitened)
    return refit(fitted, whitened), whitened


def drop_below_bic(
    fitted: FittedModel, whitened: WhitenedModel, gate: NoiseGate
) -> tuple[FittedModel, WhitenedModel]:
    """The fitted model under the noise that it leaves itself, without findings that bring less
    there
    than their numbers cost.
    """
    while True:
        whitened = gate.left_by(fitted, whitened)
        fitted = refit(fitted, whitened)
        groups = findings(fitted)
        worth = [_worth(fitted, whitened, places) for places in groups]
        if not groups or min(worth) >= 0:
            return fitted, whitened
        worst = groups[worth.index(min(worth))]
        fitted = replace(
            fitted, terms=tuple(t for k, t in enumerate(fitted.terms) if k not in worst)
        )


def _worth(fitted: FittedModel, whitened: WhitenedModel, places: Sequence[int]) -> float:
    """Fall of the deviance by a finding less the price of its numbers."""
    gain = (
        sum(float(t @ t) for t in remove_finding(fitted, whitened, places).target) - fitted.deviance
    )
    return gain - price_of(whitened) * sum(len(fitted.terms[k].names) for k in places)


def drop_implausible_sizes(fitted: FittedModel, whitened: WhitenedModel) -> FittedModel:
    """The fitted model without findings whose sizes, once all others are there, are those of no
    instrument.

    What completes a form goes too where it has a size that no file may give it: a width below
        nothing.
    """
    while True:
        good = [places for places in findings(fitted) if fair(fitted.terms[places[0]])]
        terms = tuple(
            fitted.terms[k]
            for places in good
            for k in places
            if k == places[0] or _written(fitted.terms[k])
        )
        if len(terms) == len(fitted.terms):
            return fitted
        fitted = refit(replace(fitted, terms=terms), whitened)


def _written(term: FittedTerm) -> bool:
    """Whether a scenario file may give an effect these sizes."""
    positive = {p.name for p in term.hypothesis.effect.parameters if p.positive}
    return all(
        value >= 0 for name, value in zip(term.names, term.values, strict=True) if name in positive
    )
