"""What a search comes to: a fitted model, and how probable each of its causes is.

How probable it is that each cause of a model is there, and which of them are claimed.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from scipy.special import expit, logsumexp

from tiltcal.diagnosis.data_faults.fault import Fault
from tiltcal.diagnosis.model.finding_tests import NoiseSource
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.residual_checks.oscillations import MovingTone, NarrowBand
from tiltcal.diagnosis.residual_checks.random_motion import RandomMotion
from tiltcal.diagnosis.residual_checks.slow_variation import SlowVariation
from tiltcal.diagnosis.residual_checks.varying_noise import VaryingNoise
from tiltcal.diagnosis.search.candidates import Names
from tiltcal.diagnosis.search.explanation import possible
from tiltcal.diagnosis.search.slow_laws import SlowLaw
from tiltcal.diagnosis.search.state import Doubt, State, laws, refitted, repriced, without


@dataclass(frozen=True)
class Explained:
    """The most probable explanation of some recordings.

    Args:
        fitted: the model; whitened: its columns under the noise that it leaves.
        random_settings: random setting errors of a table axis.
        noise_source: says where the noise comes from.
        names: what each finding may be; probability: that each is there.
        slow: variation that is too large to be noise, more probably than not.
        bands: of frequency that hold more than noise; tones: whose frequency moves; both more
            probably than not, and where nothing else was found.
        varying: noise that follows an angle or a cycle, almost certainly, where nothing else was
            found.
        motions: at random, more probably than not, and where nothing else was found.
        doubts: causes that the noise may be instead.
        in_noise: laws that the slow noise of some channels may be.
    """

    fitted: FittedModel
    whitened: WhitenedModel
    random_settings: tuple[Fault, ...]
    noise_source: NoiseSource
    names: tuple[Names, ...]
    probability: tuple[float, ...]
    slow: tuple[SlowVariation, ...]
    bands: tuple[NarrowBand, ...] = ()
    tones: tuple[MovingTone, ...] = ()
    varying: tuple[VaryingNoise, ...] = ()
    motions: tuple[RandomMotion, ...] = ()
    doubts: tuple[Doubt, ...] = ()
    in_noise: tuple[SlowLaw, ...] = ()


CLAIM = 0.99
"""Probability from which a cause is claimed: a false alarm costs 99 times a miss, so at most one
claim in a hundred is wrong, if the priors hold.
"""
DOUBTED = 0.5  # from which one is told as a doubt: it is more probable than not


def select_claims(
    state: State, noise_source: NoiseSource
) -> tuple[State, tuple[float, ...], tuple[Doubt, ...]]:
    """A state without causes that are not probable enough to be claimed, the probability of each
    that is left, and those left out that are more probable than not.

    A cause is as probable as the models together that hold it (Bayesian model averaging: Hoeting
    et al., Stat. Sci. 14, 1999), over those of a backward elimination: one that is not sure beside
    a cause that may take its place counts without that cause as well.
    """
    every = frozenset(range(len(state.causes)))
    models, held = {every: state}, every
    while held:
        fewer = {}
        for cause in sorted(held):
            fewer[cause], model = _without(models[held], held, {cause}, noise_source)
            known = models.get(fewer[cause], model)  # reached before, another way
            models[fewer[cause]] = min(known, model, key=lambda one: one.cost)
        weakest = min(held, key=lambda cause: models[fewer[cause]].cost)
        if _probability(models[fewer[weakest]].cost - models[held].cost) >= CLAIM:
            break
        held = fewer[weakest]
    costs = {kept: model.cost for kept, model in models.items()}
    chance = {cause: probability_of(cause, costs) for cause in every}
    claimed = frozenset(cause for cause in every if chance[cause] >= CLAIM)
    if claimed not in models:
        claimed, models[claimed] = _without(state, every, every - claimed, noise_source)
    doubts = []
    for cause, law in enumerate(laws(state.fitted)):
        if DOUBTED < chance[cause] < CLAIM:
            others = every - claimed - {cause}
            _, model = _without(state, every, others, noise_source) if others else (every, state)
            doubts.append(Doubt(law, chance[cause], model, model.cost - models[claimed].cost))
    return models[claimed], tuple(chance[cause] for cause in sorted(claimed)), tuple(doubts)


def probability_of(cause: int, costs: Mapping[frozenset[int], float]) -> float:
    """Probability that a cause is there: the share of the models with it.

    Args:
        cause: which.
        costs: -log posterior of each model, by the causes that it holds, nats.
    """
    without_it = [-cost for held, cost in costs.items() if cause not in held]
    with_it = [-cost for held, cost in costs.items() if cause in held]
    return _probability(logsumexp(with_it) - logsumexp(without_it))


def _probability(log_odds: float) -> float:
    return float(expit(log_odds))


def _without(
    state: State, held: Collection[int], gone: Collection[int], noise_source: NoiseSource
) -> tuple[frozenset[int], State]:
    """The causes that are left of those held when some are taken out, and the state with them,
    under its own noise or that which it leaves, whichever costs less. A cause whose sizes cannot be
    without those taken out goes with them.
    """
    which = [place for place, cause in enumerate(sorted(held)) if cause in gone]
    kept = sorted(frozenset(held) - frozenset(gone))
    rest = refitted(without(state, *which))
    impossible = [
        cause
        for cause, places in zip(kept, rest.fitted.findings(), strict=True)
        if not all(possible(rest.fitted.terms[i]) for i in places)
    ]
    if impossible:
        return _without(rest, kept, impossible, noise_source)
    left = repriced(rest, noise_source.left_by(rest.fitted, rest.whitened))
    return frozenset(kept), min(rest, left, key=lambda s: s.cost)
