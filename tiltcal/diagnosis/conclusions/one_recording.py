"""What a curve without a cause says of other recordings.

A curve over time, or over how many moves there were, is the history of one recording. Another one
begins with the instrument in a state that is not known: it keeps the mean of the curve over the
recording, which is what a model without the curve predicts. Several recordings that one such curve
fits do say that it repeats.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Columns, Observations
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.effects.base import Effect
from tiltcal.effects.learned import Learned
from tiltcal.statistics.dwell_noise import second_difference_noise

HISTORY = ("time", "moves")
"""Coordinates that no other recording goes through again."""


def is_history(effect: Effect, observations: Observations) -> bool:
    """Whether a curve tells the history of the only recording there is."""
    return (
        isinstance(effect, Learned)
        and effect.coordinate in HISTORY
        and bool(effect.knots or effect.power)
        and not effect.period
        and len(observations.recordings) == 1
    )


def mean_and_rest(
    fitted: FittedModel,
    places: Sequence[int],
    effects: Sequence[Effect],
    observations: Observations,
) -> list[Effect]:
    """The effects of a finding that is the history of one recording: its mean over the recording,
    which lasts, and what is left of it, which does not.

    Args:
        fitted: the whole model.
        places: of the finding's terms in it.
        effects: of those terms, as the amended scenario would hold them.
        observations: the recording.
    """
    levels = [_level(effect) for effect in effects if isinstance(effect, Learned)]
    own = [fitted.terms[k].effect for k in places]
    changes = [
        [_stacked(observations.changes(e, fitted.effects), observations) for e in group]
        for group in (levels, own)
    ]
    shares = np.linalg.lstsq(np.column_stack(changes[0]), sum(changes[1]), rcond=None)[0]
    means = [_times(level, share) for level, share in zip(levels, shares, strict=True)]
    first = observations.recordings[0].fingerprint
    rest = [*effects, *(_times(mean, -1.0) for mean in means)]
    return [*means, *(replace(e, seen_in=first, lasts=False) for e in rest)]


def _times(curve: Learned, factor: float) -> Learned:
    return replace(curve, values={n: factor * v for n, v in curve.values.items()})


def _level(curve: Learned) -> Learned:
    """A constant in the place of a curve, of the curve's size."""
    size = float(np.abs(curve.coefficients).max()) or 1.0
    ends = (0.0, 1.0)
    return replace(
        curve, values={"c0": size, "c1": size}, sigmas={}, knots=ends, power=0.0, odd=False
    )


def _stacked(columns: Columns, observations: Observations) -> Array:
    """The changes of all channels, each in units of its white noise, (n,)."""
    return np.concatenate(
        [
            columns.get(i, np.zeros(len(c.values))) / (second_difference_noise(c.values) or 1.0)
            for i, c in enumerate(observations.channels)
        ]
    )
