"""A table that stops at random about its setting, against causes that follow a law.

The rotations of all stops have one normal prior of unknown width: a variance component. Laws are
weighed against it by the cost of the whole model, so that no curve of many numbers takes the place
of chance.
"""

import numpy as np
from scipy.special import logsumexp

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data_quality.setting_errors import rotations_of_stops, stops_by_axis
from tiltcal.diagnosis.model.channel_noise import noise_within_stops
from tiltcal.diagnosis.model.finding_tests import NoiseGate
from tiltcal.diagnosis.model.fitted_model import FittedModel, refit
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.bayes_factors import SIZES
from tiltcal.diagnosis.search.priors import SOMETHING, UNLISTED
from tiltcal.diagnosis.search.state import State, laws, refitted, repriced, without
from tiltcal.effects.table.readout import IndexError_


def beside_random_settings(state: State, start: FittedModel, gate: NoiseGate) -> State:
    """A state without its unlisted curves, where random settings of an axis are more probable than
    all its causes.
    """
    unlisted = [k for k, law in enumerate(laws(state.fitted)) if not law.listed]
    if not unlisted or random_setting_cost(start, state.whitened) > state.cost:
        return state
    rest = refitted(without(state, *unlisted))
    return repriced(rest, gate.left_by(rest.fitted, rest.whitened))


def random_setting_cost(start: FittedModel, whitened: WhitenedModel) -> float:
    """-log posterior of random settings of the axis that they explain most of, and of no other
    cause, nats; infinite where no axis has stops enough.
    """
    noise = noise_within_stops(start, whitened)
    stops = stops_by_axis(whitened.observations, start)
    if noise is None or not stops:
        return np.inf
    within = whitened.as_fitted(noise)
    fitted = refit(start, within)
    evidence = max(
        common_width(*rotations_of_stops(columns, fitted, within)[1:]) for columns in stops.values()
    )
    names = len({h.id for h in whitened.hypotheses if h.listed})
    prior = np.log(SOMETHING * (1 - UNLISTED) / names)
    return State(fitted, within).cost - evidence - float(prior)


def common_width(values: Array, variances: Array) -> float:
    """Evidence for rotations that have one normal prior, averaged over its width, nats.

    Args:
        values: of each stop, rad, (n,).
        variances: of these estimates, rad^2, (n,).
    """
    (width,) = IndexError_.parameters
    size = width.plausible[1] * width.factor
    ratio = SIZES[:, None] * size**2 / variances
    by_width = 0.5 * (values**2 / variances * ratio / (1 + ratio) - np.log1p(ratio)).sum(axis=1)
    return float(logsumexp(by_width) - np.log(len(SIZES)))
