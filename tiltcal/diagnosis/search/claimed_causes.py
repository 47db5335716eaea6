"""How probable it is that each cause of a model is there, and which of them are claimed."""

from collections.abc import Mapping, Sequence

from scipy.special import expit, logsumexp

from tiltcal.diagnosis.model.finding_tests import NoiseGate
from tiltcal.diagnosis.search.state import Doubt, State, laws, refitted, repriced, without

CLAIM = 0.95  # probability from which a cause is claimed: a false alarm costs 19 times a miss


def believed(state: State, gate: NoiseGate) -> tuple[State, tuple[float, ...], tuple[Doubt, ...]]:
    """A state without causes that are not probable enough to be claimed, the probability of each
    that is left, and those left out that are more probable than not.

    A cause is as probable as the models together that hold it (Bayesian model averaging: Hoeting
    et al., Stat. Sci. 14, 1999), over those of a backward elimination: one that is not sure beside
    a cause that may take its place counts without that cause as well.
    """
    every = frozenset(range(len(state.causes)))
    models, held = {every: state}, every
    while held:
        for k, cause in enumerate(sorted(held)):
            fewer = held - {cause}
            models[fewer] = _without(models[held], [k], gate)
        weakest = min(held, key=lambda cause: models[held - {cause}].cost)
        if _probability(models[held - {weakest}].cost - models[held].cost) >= CLAIM:
            break
        held -= {weakest}
    costs = {kept: model.cost for kept, model in models.items()}
    chance = {cause: probability_of(cause, costs) for cause in every}
    claimed = sorted(cause for cause in every if chance[cause] >= CLAIM)
    doubts = [
        Doubt(law, chance[cause])
        for cause, law in enumerate(laws(state.fitted))
        if 0.5 < chance[cause] < CLAIM
    ]
    if (kept := frozenset(claimed)) not in models:
        models[kept] = _without(state, sorted(every - kept), gate)
    return models[kept], tuple(chance[cause] for cause in claimed), tuple(doubts)


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


def _without(state: State, which: Sequence[int], gate: NoiseGate) -> State:
    """A state without some of its causes, under its own noise or that which it leaves, whichever
    costs less.
    """
    rest = refitted(without(state, *which))
    return min(rest, repriced(rest, gate.left_by(rest.fitted, rest.whitened)), key=lambda s: s.cost)
