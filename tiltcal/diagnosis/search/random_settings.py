"""A table that stops at random about its setting, against causes that follow a law.

The rotations of all stops have one normal prior of unknown width: a variance component. Laws are
weighed against it by the cost of the whole model, so that no curve of many numbers takes the place
of chance. A law of an angle or of the history that no curve has the form of is weighed against it
as a Gaussian process over that angle, or over the order of the stops (Rasmussen and Williams 2006):
stops near each other turn alike.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import logsumexp

from tiltcal.core.arrays import Array
from tiltcal.core.units import DEG
from tiltcal.diagnosis.data_faults.setting_errors import (
    Rotations,
    SettingError,
    Stop,
    rotations_of_stops,
    stops_by_axis,
)
from tiltcal.diagnosis.hypotheses.priors import EXPECTED_CAUSES, UNLISTED_ODDS, kind, share_of_name
from tiltcal.diagnosis.model.channel_noise import noise_within_stops
from tiltcal.diagnosis.model.finding_tests import NoiseSource
from tiltcal.diagnosis.search.state import State, laws, refitted, repriced, without
from tiltcal.effects.table.readout import SettingScatter

LENGTHS = (3 * DEG, 10 * DEG, 30 * DEG, 90 * DEG)
"""Over which a law of an angle changes, rad."""
STOPS = (3.0, 10.0, 30.0, 100.0)  # numbers of stops over which a law of the history changes
REST = (0.0, 1e-3, 1e-2, 1e-1)
"""Of the variance of rotations that follow a law, the share that does not."""
WIDTHS = 10.0 ** np.arange(-6, 2.1, 0.25)
"""Prior variances of the rotations, in plausible sizes squared: so close to each other that a
correlation does not stand in for a width between two of them.
"""


def beside_random_settings(state: State, noise_source: NoiseSource) -> tuple[State, bool]:
    """A state without its unlisted curves, where random settings of an axis are more probable than
    these, and whether they are; beside those of the listed causes with which that costs least. A
    law may have been fitted to settings, so causes are left out one after the other.
    """
    unlisted = [k for k, law in enumerate(laws(state.fitted)) if not law.listed]
    if not unlisted:
        return state, False
    rest = refitted(without(state, *unlisted))
    least, random = cost_with_random_settings(rest)
    tried = [(random, rest)]
    while rest.causes and np.isfinite(least):
        fewer = [refitted(without(rest, k)) for k in range(len(rest.causes))]
        costs = [cost_with_random_settings(s) for s in fewer]
        tried += [(c[1], s) for c, s in zip(costs, fewer, strict=True)]
        k = int(np.argmin([c[0] for c in costs]))
        if not costs[k][0] < least:
            break
        least, rest = costs[k][0], fewer[k]
    cost, best = min(tried, key=lambda pair: pair[0])
    if cost > state.cost:
        return state, False
    return repriced(best, noise_source.left_by(best.fitted, best.whitened)), True


def cost_with_random_settings(state: State) -> tuple[float, float]:
    """-log posterior of a model with random settings of the axis that they explain most of, nats:
    of any axis, and of those whose settings follow no law. Infinite where none is.
    """
    fitted, whitened = state.fitted, state.whitened
    noise = noise_within_stops(fitted, whitened)
    if noise is None:
        return np.inf, np.inf
    within = repriced(state, whitened.as_fitted(noise))
    stops = stops_by_axis(whitened.observations, fitted)
    prior = float(np.log(EXPECTED_CAUSES * share_of_name({kind(h) for h in whitened.hypotheses})))
    evidence = any_axis = -np.inf
    for _, every in stops:
        rotations = rotations_of_stops(every, within.fitted, within.whitened)
        any_axis = max(any_axis, common_width(rotations))
        if not is_systematic(rotations, _angles(every)):
            evidence = max(evidence, common_width(rotations))
    return within.cost - any_axis - prior, within.cost - evidence - prior


def _angles(stops: Sequence[Stop]) -> dict[str, Array]:
    return {axis: np.array([s.angles[axis] for s in stops]) for axis in stops[0].angles}


def is_systematic_error(error: SettingError) -> bool:
    """Whether what looks like random settings more probably follows a law."""
    return is_systematic(error.rotations, _angles(error.stops))


def is_systematic(rotations: Rotations, angles: Mapping[str, Array]) -> bool:
    """Whether rotations more probably follow one of some angles, or those before, than nothing.

    Args:
        rotations: of n stops in their order; angles: of each axis at each stop, rad, (n,).
    """
    chance = common_width(rotations) - UNLISTED_ODDS
    order = np.arange(rotations.root.shape[1])
    alike = [_likeness(_chord(a), length) for a in angles.values() for length in LENGTHS]
    alike += [_likeness(np.abs(order[:, None] - order), length) for length in STOPS]
    processes = [
        _of_process(rotations, (1 - rest) * likeness + rest * np.eye(len(order)))
        for likeness in alike
        for rest in REST
    ]
    return float(logsumexp(processes) - np.log(len(processes))) > chance


def _chord(angle: Array) -> Array:
    """Distance of angles, (n,) -> (n, n): a turn ends where it began."""
    return 2 * np.abs(np.sin((angle[:, None] - angle) / 2))


def _likeness(distance: Array, length: float) -> Array:
    """Correlation of a law at some distances, (n, n): exponential."""
    return np.exp(-distance / length)


def common_width(rotations: Rotations) -> float:
    """Evidence for rotations that have one normal prior, averaged over its width, nats."""
    return _of_process(rotations, np.eye(rotations.root.shape[1]))


def _of_process(rotations: Rotations, likeness: Array) -> float:
    """Evidence for rotations that are a normal process of this correlation, averaged over its
    width, nats. likeness: (n, n).
    """
    (width,) = SettingScatter.parameters
    size, root = width.plausible[1] * width.factor, rotations.root
    energies, directions = np.linalg.eigh(root @ likeness @ root.T)
    found = directions.T @ rotations.projections
    ratio = WIDTHS[:, None] * size**2 * np.maximum(energies, 0.0)
    by_width = 0.5 * (found**2 * ratio / (1 + ratio) - np.log1p(ratio)).sum(axis=1)
    return float(logsumexp(by_width) - np.log(len(WIDTHS)))
