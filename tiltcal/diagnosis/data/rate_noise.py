"""How much more uncertain readings are while a table moves: their prediction holds the noise of the
rates and the accelerations that the readout tells.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.block_grid import Sampling
from tiltcal.diagnosis.data.observations import Channel
from tiltcal.forward.nominal_motion import NominalMotion
from tiltcal.recordings.replay import Replay
from tiltcal.setup.trajectory import Jet
from tiltcal.statistics.noise_spectrum import white_at_rest

ALIKE = 1.001  # largest standard deviation of rows that are alike, over the least


def with_spread(
    channels: Sequence[Channel],
    courses: Sequence[Replay],
    watches: Sequence[NominalMotion],
    samplings: Sequence[Sampling],
    block: int,
) -> Iterator[Channel]:
    """Channels with the spread of their rows.

    Args:
        channels: as they were read.
        courses, watches: of each recording, what its readout says and what its sensors sense.
        samplings: of each channel, from the instants of its recording's watch to its rows.
        block: samples that are averaged into one row.
    """
    variances = [np.zeros(len(c.values)) for c in channels]
    for number, (course, watch) in enumerate(zip(courses, watches, strict=True)):
        for axis in course.angles:
            for changes in _by_noise(axis, course, watch):
                for i, c in enumerate(channels):
                    if c.recording == number and c.sensor in changes:
                        each = changes[c.sensor][:, c.column]
                        variances[i] += samplings[i].of(each) ** 2 / block
    for channel, variance in zip(channels, variances, strict=True):
        spread = np.sqrt(1 + variance / white_at_rest(channel.values, channel.stop) ** 2)
        yield replace(channel, spread=spread) if spread.max() > ALIKE else channel


def _by_noise(axis: str, course: Replay, watch: NominalMotion) -> Iterator[dict[str, Array]]:
    """What one standard deviation of the rate of an axis, and of its acceleration, does to the
    readings of each sensor, SI, (n, k).
    """
    rate, acceleration = (
        np.interp(watch.time, course.time, noise) for noise in course.motion_noise(axis)
    )
    nothing = np.zeros(len(watch.time))
    if rate.any():
        yield watch.by_motion(axis, Jet(nothing, rate))
    if acceleration.any():
        yield watch.by_motion(axis, Jet(nothing, nothing, acceleration))
