"""Listed laws that slow noise may be: a random walk or flicker of free size fits a slow course as
well as the law that made it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.model.finding_tests import NoiseSource
from tiltcal.diagnosis.model.refitting import refit
from tiltcal.diagnosis.search.explanation import possible
from tiltcal.diagnosis.search.scan import Scan
from tiltcal.diagnosis.search.state import (
    Doubt,
    Proposal,
    State,
    looked_at,
    repriced,
    with_new,
)
from tiltcal.statistics.noise_spectrum import white_noise

HIDES = 10.0  # nats that slow noise takes in a channel: white noise alone is out (20 000 to 1)
# nats: odds of 20 to 1, where evidence is strong (Kass, Raftery, J. Am. Stat. Assoc. 90, 1995); a
# law that costs no more than that beyond the noise explains a channel as well
AS_WELL = 3.0


@dataclass(frozen=True)
class SlowLaw:
    """A law that the slow noise of some channels may be.

    Args:
        law: of the catalogue.
        channels: numbers of those whose slow noise it takes up.
        more: what the model with it costs more than the model with that noise, nats.
    """

    law: Hypothesis
    channels: tuple[int, ...]
    more: float


def probabilities(found: Sequence[SlowLaw], channel: int) -> dict[str, float]:
    """Ids of the laws that the slow noise of a channel may be, each with its probability against
    this noise and the other laws, the most probable first.
    """
    own = {law.law.id: law.more for law in reversed(found) if channel in law.channels}
    every = logsumexp([0.0, *(-more for more in own.values())])
    return {id: float(np.exp(-own[id] - every)) for id in sorted(own, key=lambda id: own[id])}


def slow_laws(
    state: State, noise_source: NoiseSource, doubts: Sequence[Doubt]
) -> tuple[SlowLaw, ...]:
    """The listed laws that explain the slow noise which a model leaves as well as noise does, those
    that cost least first.

    Each is added to the model, and the noise estimated again beside it: it counts where that costs
    at most ``AS_WELL`` more. Nothing is asked where the noise was taken from a record at rest.

    Args:
        state: the model.
        noise_source: the noise under a model.
        doubts: laws that were left out of it, and the models with them.
    """
    if noise_source.static is not None:
        return ()
    before = [fit.slow_gain for fit in state.whitened.fits]
    hiding = [i for i, gain in enumerate(before) if gain > HIDES]
    if not hiding:
        return ()
    tried = [(d.law, d.model, d.more) for d in doubts if d.law.listed]
    for proposal in _proposed(state, hiding):
        with_law = with_new(state, proposal)
        with_law = repriced(with_law, noise_source.left_by(with_law.fitted, with_law.whitened))
        tried.append((proposal.explanation.hypothesis, with_law, with_law.cost - state.cost))
    found: dict[object, SlowLaw] = {}
    for law, with_law, more in sorted(tried, key=lambda one: one[2]):
        fits = with_law.whitened.fits
        taken = tuple(i for i in hiding if fits[i].slow_gain < before[i] / 2)
        if taken and more < AS_WELL:
            found.setdefault(law.place, SlowLaw(law, taken, more))
    return tuple(found.values())


def _proposed(state: State, hiding: Sequence[int]) -> list[Proposal]:
    """Listed laws that may explain what slow noise hides in some channels: under their white noise
    alone.
    """
    fits = state.whitened.fits
    noise = [
        white_noise(fit.model.white) if i in hiding else fit.model for i, fit in enumerate(fits)
    ]
    whitened = state.whitened.under(noise)
    bare = replace(state, fitted=refit(state.fitted, whitened), whitened=whitened)
    found = looked_at(bare, Scan(whitened), listed_only=True)
    return [p for p in found if possible(p.explanation.terms[0])]
