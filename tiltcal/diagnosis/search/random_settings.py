"""A table that stops at random about its setting, against causes that follow a law.

The rotations of all stops have one normal prior of unknown width: a variance component. Laws are
weighed against it by the cost of the whole model, so that no curve of many numbers takes the place
of chance. A law of an angle that no curve has the form of is weighed against it as a Gaussian
process over that angle (Rasmussen and Williams 2006): stops near each other turn alike.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import logsumexp

from tiltcal.core.arrays import Array
from tiltcal.core.units import DEG
from tiltcal.diagnosis.data_quality.setting_errors import (
    SettingError,
    Stop,
    rotations_of_stops,
    stops_by_axis,
)
from tiltcal.diagnosis.model.channel_noise import noise_within_stops
from tiltcal.diagnosis.model.finding_tests import NoiseGate
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.bayes_factors import SIZES
from tiltcal.diagnosis.search.priors import SOMETHING, UNLISTED
from tiltcal.diagnosis.search.state import State, laws, refitted, repriced, without
from tiltcal.effects.table.readout import IndexError_

LENGTHS = (3 * DEG, 10 * DEG, 30 * DEG, 90 * DEG)
"""Over which a law of an angle changes, rad."""
REST = (0.0, 1e-3, 1e-2, 1e-1)
"""Of the variance of rotations that follow an angle, the share that does not."""
LISTED = float(np.log((1 - UNLISTED) / UNLISTED))
"""What a listed cause has before a nameless one, nats."""


def beside_random_settings(state: State, start: FittedModel, gate: NoiseGate) -> State:
    """A state without its unlisted curves, where random settings of an axis are more probable than
    these, alone or beside the listed causes.
    """
    unlisted = [k for k, law in enumerate(laws(state.fitted)) if not law.listed]
    if not unlisted:
        return state
    rest = refitted(without(state, *unlisted))
    alone = State(start, state.whitened)
    if min(cost_with_random_settings(s) for s in (rest, alone)) > state.cost:
        return state
    return repriced(rest, gate.left_by(rest.fitted, rest.whitened))


def cost_with_random_settings(state: State) -> float:
    """-log posterior of a model with random settings of the axis that they explain most of, nats;
    infinite where no axis has stops enough, and where they follow an angle.
    """
    fitted, whitened = state.fitted, state.whitened
    noise = noise_within_stops(fitted, whitened)
    if noise is None:
        return np.inf
    within = repriced(state, whitened.as_fitted(noise))
    stops = stops_by_axis(whitened.observations, fitted)
    evidences = [_evidence(every, within.fitted, within.whitened) for _, every in stops]
    if not evidences:
        return np.inf
    names = len({h.id for h in whitened.hypotheses if h.listed})
    prior = np.log(SOMETHING * (1 - UNLISTED) / names)
    return within.cost - max(evidences) - float(prior)


def _evidence(stops: Sequence[Stop], fitted: FittedModel, within: WhitenedModel) -> float:
    """Evidence for random settings of an axis, nats; none where they follow an angle."""
    _, values, variances = rotations_of_stops(stops, fitted, within)
    angles = _angles(stops)
    return -np.inf if lawful(values, variances, angles) else common_width(values, variances)


def _angles(stops: Sequence[Stop]) -> dict[str, Array]:
    return {axis: np.array([s.angles[axis] for s in stops]) for axis in stops[0].angles}


def is_lawful(error: SettingError) -> bool:
    """Whether what looks like random settings more probably follows an angle."""
    return lawful(error.rotations, error.variances, _angles(error.stops))


def lawful(values: Array, variances: Array, angles: Mapping[str, Array]) -> bool:
    """Whether rotations more probably follow one of some angles than nothing.

    Args:
        values: of each stop, rad, (n,); variances: of these estimates, rad^2, (n,).
        angles: of each axis at each stop, rad, (n,).
    """
    chance = common_width(values, variances) + LISTED
    processes = [
        _of_process(values, variances, (1 - rest) * likeness + rest * np.eye(len(values)))
        for likeness in (_likeness(a, length) for a in angles.values() for length in LENGTHS)
        for rest in REST
    ]
    return float(logsumexp(processes) - np.log(len(processes))) > chance


def _likeness(angle: Array, length: float) -> Array:
    """Correlation of a law at some angles, (n,) -> (n, n): exponential in the chord, so that a turn
    ends where it began.
    """
    chord = 2 * np.abs(np.sin((angle[:, None] - angle) / 2))
    return np.exp(-chord / length)


def common_width(values: Array, variances: Array) -> float:
    """Evidence for rotations that have one normal prior, averaged over its width, nats.

    Args:
        values: of each stop, rad, (n,).
        variances: of these estimates, rad^2, (n,).
    """
    return _of_process(values, variances, np.eye(len(values)))


def _of_process(values: Array, variances: Array, likeness: Array) -> float:
    """Evidence for rotations that are a normal process of this correlation, averaged over its
    width, nats.
    """
    (width,) = IndexError_.parameters
    size, sigma = width.plausible[1] * width.factor, np.sqrt(variances)
    energies, directions = np.linalg.eigh(likeness / np.outer(sigma, sigma))
    found = directions.T @ (values / sigma)
    ratio = SIZES[:, None] * size**2 * np.maximum(energies, 0.0)
    by_width = 0.5 * (found**2 * ratio / (1 + ratio) - np.log1p(ratio)).sum(axis=1)
    return float(logsumexp(by_width) - np.log(len(SIZES)))
