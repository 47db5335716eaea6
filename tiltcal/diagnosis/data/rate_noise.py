"""How much more uncertain readings are while a table moves: their prediction holds the noise of the
rates and the accelerations that the readout tells, and their own noise may grow.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.diagnosis.data.block_grid import Sampling
from tiltcal.diagnosis.data.observations import Channel
from tiltcal.forward.nominal_motion import NominalMotion
from tiltcal.recordings.replay import Replay
from tiltcal.setup.trajectory import Jet
from tiltcal.statistics.dwell_noise import white_at_rest
from tiltcal.statistics.noise_in_motion import noise_growth

ALIKE = 1.001  # largest standard deviation of rows that are alike, over the least
# of noise that grows, family-wise over the channels: taken wrongly it spoils the weight of each
# row, and where it is not seen all rows weigh alike, as they do without it
SIGNIFICANCE = 1e-4


def with_spread(
    channels: Sequence[Channel],
    courses: Sequence[Replay],
    watches: Sequence[NominalMotion],
    samplings: Sequence[Sampling],
    counts: Sequence[Index],
    cut: Mapping[str, float],
) -> Iterator[Channel]:
    """Channels with the spread of their rows.

    Args:
        channels: as they were read.
        courses, watches: of each recording, what its readout says and what its sensors sense.
        samplings: of each channel, from the instants of its recording's watch to its rows.
        counts: of each channel, samples that are averaged into each row, (n,): a row of fewer is
            noisier.
        cut: steps that a readout is cut to, of those axes that have any, rad. An angle may be
            anywhere within one, and stays there while its axis rests: no average tells more.
    """
    variances = [np.zeros(len(c.values)) for c in channels]
    for number, (course, watch) in enumerate(zip(courses, watches, strict=True)):
        for axis in course.angles:
            unknown = Jet(np.full(len(watch.time), cut.get(axis, 0.0) / np.sqrt(12)))
            by_angle = watch.by_motion(axis, unknown) if axis in cut else {}
            for i, c in enumerate(channels):
                if c.recording == number and c.sensor in by_angle:
                    variances[i] += samplings[i].of(by_angle[c.sensor][:, c.column]) ** 2
            for changes in _by_noise(axis, course, watch):
                for i, c in enumerate(channels):
                    if c.recording == number and c.sensor in changes:
                        each = changes[c.sensor][:, c.column]
                        variances[i] += samplings[i].of(each) ** 2 / counts[i]
    for channel, variance, count in zip(channels, variances, counts, strict=True):
        own = count.max(initial=1) / count
        spread = np.sqrt(own + variance / white_at_rest(channel.values, channel.stop) ** 2)
        yield replace(channel, spread=spread) if spread.max() > ALIKE else channel


def with_growth(
    channels: Sequence[Channel], predicted: Sequence[Array], courses: Sequence[Replay]
) -> Iterator[Channel]:
    """Channels whose spread is that of their own noise too, where it grows with the motion or the
    input.

    Args:
        channels: with the spread of what is predicted.
        predicted: readings of each without any cause, SI, (n,).
        courses: of each recording.
    """
    speeds = [course.speed for course in courses]
    for c, p in zip(channels, predicted, strict=True):
        read, said = c.weighed(c.values), c.weighed(p)
        speed = speeds[c.recording][c.rows]
        level = SIGNIFICANCE / len(channels)
        yield _grown(c, noise_growth(read, said, c.stop, speed, np.abs(p), level))


def with_growth_of(
    whole: Sequence[Channel],
    blocks: Sequence[Channel],
    means: Sequence[Callable[[Array], Array]],
) -> Iterator[Channel]:
    """Channels of blocks whose noise grows as that of their samples.

    Args:
        whole: sample by sample. blocks: the same, averaged.
        means: of each channel, over the samples of each block, (n,) -> (blocks,).
    """
    for one, c, mean in zip(whole, blocks, means, strict=True):
        growth = one.growth
        yield _grown(c, None if growth is None else np.sqrt(mean(growth**2)))


def _grown(channel: Channel, growth: Array | None) -> Channel:
    """A channel whose noise grows so much. growth: (n,), of each row; None: it does not."""
    if growth is None:
        return channel
    spread = growth if channel.spread is None else channel.spread * growth
    return replace(channel, spread=spread, growth=growth)


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
