"""Slow variation that is too large to be an instrument's noise, and that no cause explains.

It fits a random walk or flicker as well as any other slow course, so that only the prior decides:
instruments have grades, the axes of one are alike, and so is one in several recordings.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.special import expit

from tiltcal.diagnosis.hypotheses.priors import NAMELESS
from tiltcal.diagnosis.model.noise_prior import (
    NOTHING,
    InstrumentPrior,
    above_price,
    instruments,
    unlike_others,
)
from tiltcal.diagnosis.model.score_test import ENERGIES
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.recordings.recording import stem
from tiltcal.statistics.noise_spectrum import NoiseFit

SLOW = 0.1
"""Of the band: below it noise counts as slow."""


@dataclass(frozen=True)
class SlowVariation:
    """Slow variation of one axis of a sensor, or of all of them in one of several recordings.

    Args:
        sensor, axes: whose.
        recording: which, in words; None where there is one only.
        times: the slow noise of the worst grade, that it is as large as; or that of the other axes
            and recordings of the sensor, where that says more.
        beside_others: whether it is that.
        whole: whether all axes in the recording have it.
        probability: that it is no noise.
    """

    sensor: str
    axes: tuple[str, ...]
    recording: str | None
    times: float
    beside_others: bool
    whole: bool
    probability: float


def slow_variations(whitened: WhitenedModel, least: float) -> tuple[SlowVariation, ...]:
    """The slow noise that is no noise with at least this probability: beyond that of the worst
    grade by its size, not only beside the white noise, or unlike that of the sensor's other axes,
    or of other recordings. None below what coarse codes do is told.

    Args:
        whitened: the noise that a model leaves.
        least: probability from which one is told.
    """
    # that it is there, on this axis, and has this size
    prior = NAMELESS - float(np.log(len(whitened.observations.channels) * len(ENERGIES)))
    found = []
    for one in instruments(whitened):
        every = _of_instrument(one, whitened, prior)
        taken: set[int] = set()
        for slow, places in sorted(every, key=lambda told: -told[0].probability):
            # of two apart, the one with more; of a recording and an axis in it the more probable
            if slow.probability >= least and slow.times >= 1 and not taken & set(places):
                taken |= set(places)
                found.append(slow)
    return tuple(found)


def _of_instrument(
    one: InstrumentPrior, whitened: WhitenedModel, prior: float
) -> Iterator[tuple[SlowVariation, list[int]]]:
    """The slow noise of each axis, and of all axes in each of several recordings, with their
    places in the instrument.
    """
    fits = [whitened.fits[i] for i in one.which]
    channels = [whitened.observations.channels[i] for i in one.which]
    together = one.most_probable(fits)  # a record at rest has others
    recordings = whitened.observations.recordings
    several = len(recordings) > 1
    numbers = dict.fromkeys(c.recording for c in channels) if several else {}
    whole = [[k for k, c in enumerate(channels) if c.recording == number] for number in numbers]
    for places in [*whole, *([k] for k in range(len(fits)) if [k] not in whole)]:
        axes = [(one.axes[k], fits[k], channels[k]) for k in places]
        if any(
            c.derived or axis.level(fit.model) < np.log(whitened.floors.get(c.sensor) or NOTHING)
            for axis, fit, c in axes
        ):
            continue
        above = [np.min(axis.above(f.model), axis=0) * _share(f) for axis, f, _ in axes]
        large = sum(above_price(x.tolist()) for x in above)
        unlike, times = unlike_others(one, places, together)
        own = channels[places[0]]
        slow = SlowVariation(
            own.sensor,
            tuple(c.axis for *_, c in axes),
            stem(recordings[own.recording].source) if several else None,
            times if unlike > large else float(np.max(above)),
            unlike > large,
            places in whole,
            float(expit(large + unlike + prior)),
        )
        yield slow, places


def _share(fit: NoiseFit) -> float:
    """How much of its fitted slow noise a record holds where it is slow, at most one: the end of a
    filter's band looks like flicker and says nothing of what is slow.
    """
    bins = fit.bins
    slow = bins.inverse > 1 / (2 * np.sin(np.pi / 2 * SLOW))
    if not slow.any():
        return 1.0
    expected = fit.model.density(1 / bins.inverse[slow])
    power = bins.scale * float((bins.power[slow] / expected).sum())
    return float(np.sqrt(min(power / float(bins.weight[slow].sum()), 1.0)))
