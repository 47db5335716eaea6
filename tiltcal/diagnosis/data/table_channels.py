"""Channels of recordings on a table whose angles were read.

How much more uncertain readings are while a table moves: their prediction holds the noise of the
rates and the accelerations that the readout tells, and their own noise may grow.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property

import numpy as np

from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.core.frames import is_steep
from tiltcal.diagnosis.data.block_grid import BlockGrid, SampleBlocks, Sampling, mean_times
from tiltcal.diagnosis.data.curve_columns import CurveColumns
from tiltcal.diagnosis.data.observations import Channel, Columns, CurveFactors, Observations
from tiltcal.diagnosis.data.stop_rotations import stated_settings
from tiltcal.effects.base import Effect
from tiltcal.effects.events import active_in
from tiltcal.effects.learned import Learned
from tiltcal.effects.loads import masses_of
from tiltcal.forward.nominal_motion import NominalMotion
from tiltcal.forward.signal_chain import readings
from tiltcal.laboratory.handheld import sensor_matrix
from tiltcal.laboratory.laboratory import restored
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.replay import Replay, replay
from tiltcal.recordings.span_means import AVERAGED
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.trajectory import Jet
from tiltcal.statistics.cosine_transform import quick_length
from tiltcal.statistics.dwell_noise import white_at_standstill
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
        spread = np.sqrt(own + variance / white_at_standstill(channel.values, channel.stop) ** 2)
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


def _unusable(sensor: Sensor, values: Array) -> Mask:
    """Which readings of a channel no linear model holds for, (n,): those of an inclinometer near
    the pole of its arcsine.
    """
    return is_steep(values) if sensor.kind == "inclinometer" else np.zeros(len(values), dtype=bool)


QUICK = 0.1  # periods within a block, at most, that its middle may stand for


class TableObservations(Observations):
    """Recordings on a table whose angles were read.

    ``averaged`` has means over blocks of samples, of readings and predictions alike. A long record
    needs no more to show its physics, and its noise stays white, flicker and walk.
    """

    def __init__(
        self, scenario: Scenario, recordings: Sequence[Recording], known: Sequence[Effect]
    ) -> None:
        self.block = 1
        self._rows: list[Index] = []
        self._blocks: list[SampleBlocks] = []
        self.scenario, self.recordings, self.known = scenario, tuple(recordings), tuple(known)
        reference = scenario.climate.reference_degC
        self.courses: list[Replay] = []
        for recording in recordings:
            course = restored(
                replay(recording, scenario, reference), active_in(known, recording.fingerprint)
            )
            self.courses.append(course)
            # T0 stays that of the first recording
            reference = course.reference if reference is None else reference
        self.stops = [course.stop for course in self.courses]
        self.channels = tuple(self._channels())
        self._watches: dict[bytes, list[NominalMotion]] = {}
        self._around: tuple[tuple[Effect, ...], bytes] | None = None
        self._bent: list[Array] = []
        self._whole: TableObservations | None = None
        self.channels = self._with_spread()
        self.channels = tuple(with_growth(self.channels, self.predict(self.known), self.courses))

    def averaged(self, block: int) -> "TableObservations":
        """The same with so many samples averaged into one."""
        if block == 1:
            return self
        other = copy(self)
        other.block, other._rows, other._blocks, other._watches = block, [], [], {}
        other._around, other._bent, other._whole = None, [], self
        for name in ("_grids", "_samplings", "_curves", "_recent"):
            other.__dict__.pop(name, None)
        other.channels = tuple(other._channels())
        means = [blocks.means for blocks in other._blocks]
        other.channels = tuple(with_growth_of(self.channels, other._with_spread(), means))
        return other

    def _channels(self) -> list[Channel]:
        found = []
        for number, (recording, course) in enumerate(
            zip(self.recordings, self.courses, strict=True)
        ):
            for sensor in self.scenario.sensor:
                if not recording.has(sensor):
                    continue
                samples = recording.sensor(sensor)
                known = course.known[samples.rows]
                for k, axis in enumerate(sensor.axes):
                    value = samples.values[:, k]
                    there = np.flatnonzero(known & ~np.isnan(value) & ~_unusable(sensor, value))
                    there = there[: quick_length(len(there))]
                    if len(there) <= 8:
                        continue
                    blocks = SampleBlocks.of(samples.rows[there], self.block, len(recording.time))
                    there = there[: blocks.samples]
                    rows = samples.rows[there]
                    self._rows.append(rows)
                    self._blocks.append(blocks)
                    middle = rows[blocks.starts + blocks.counts // 2]
                    values = blocks.means(samples.values[there, k])
                    when = mean_times(recording.time[rows], blocks.starts)
                    stop = course.stop[middle]
                    found.append(Channel(number, sensor.name, axis, k, middle, when, values, stop))
        return found

    def _with_spread(self) -> tuple[Channel, ...]:
        """The channels, with how uncertain the readout's rates make their rows."""
        watches = self.watches(self.known)
        counts = [blocks.counts for blocks in self._blocks]
        about = self.channels, self.courses, watches, self._samplings
        return tuple(with_spread(*about, counts, self.cut))

    def predict(self, effects: Sequence[Effect]) -> list[Array]:
        """What each channel should have read. SI, (n,) each.

        Of blocks: the prediction at their middles, and how far the mean over a block was from that
        at first, of the motion's bend within it; what is quick beside a block is predicted at every
        sample.
        """
        if self._whole is None:
            return self._everywhere(effects)
        if any(self.quick(e) and not e.is_identity for e in effects):
            return self._means(self._whole.predict(effects))
        if not self._bent:
            self.bend_at(effects)
        return [m + b for m, b in zip(self._middles(effects), self._bent, strict=True)]

    def bend_at(self, effects: Sequence[Effect]) -> bool:
        """Take the bend within blocks from a model with these effects: a scale factor of some per
        mille turns it with the rest.
        """
        if self._whole is not None:
            whole = self._means(self._whole.predict(effects))
            self._bent = [w - m for w, m in zip(whole, self._middles(effects), strict=True)]
            self._recent.clear()
        return self.block > 1

    def quick(self, effect: Effect) -> bool:
        """Whether an effect may change within a block."""
        if effect.sharp or "lines" in effect.values:
            return self.block > 1
        period = (
            getattr(effect, "period", 0.0)
            if getattr(effect, "coordinate", "") in ("since_move", "time")
            else 0.0
        )
        frequency = effect.values.get("frequency", 1 / period if period else 0.0)
        return self.block > 1 and frequency * self.block * self._step > QUICK

    @cached_property
    def _step(self) -> float:
        """Between samples, s."""
        return max(float(np.median(np.diff(r.time))) for r in self.recordings)

    def _means(self, columns: Sequence[Array]) -> list[Array]:
        """Means of blocks of every channel's samples."""
        return [b.means(column) for b, column in zip(self._blocks, columns, strict=True)]

    def _middles(self, effects: Sequence[Effect]) -> list[Array]:
        """What each channel should have read at the middles of the blocks."""
        found = []
        for number, (recording, course) in enumerate(
            zip(self.recordings, self.courses, strict=True)
        ):
            mine = [c for c in self.channels if c.recording == number]
            time = self._grids[number].time
            values = readings(
                self.scenario,
                course,
                dict.fromkeys(sorted({c.sensor for c in mine}), time),
                active_in(effects, recording.fingerprint),
            )
            found += [
                self._samplings[i].of(values[c.sensor][:, c.column])
                for i, c in enumerate(self.channels)
                if c.recording == number
            ]
        return found

    @cached_property
    def _grids(self) -> list[BlockGrid]:
        """Where a model is asked for the blocks of each recording."""
        return [
            BlockGrid.by_motion(r.time, self.block, course.angles, course.stop)
            if AVERAGED in r.metadata and self.block > 1
            else BlockGrid.middles(r.time, self.block)
            for r, course in zip(self.recordings, self.courses, strict=True)
        ]

    @cached_property
    def _samplings(self) -> list[Sampling]:
        """Of each channel: from the instants of its recording to its samples."""
        found = []
        for i, c in enumerate(self.channels):
            grid = self._grids[c.recording]
            rows = self.blocks(i)
            first, last = int(rows[0]), int(rows[-1])
            together = last - first == len(rows) - 1 and bool((np.diff(rows) == 1).all())
            found.append(Sampling(grid, slice(first, last + 1) if together else rows))
        return found

    def at_samples(self, number: int, values: Array) -> Array:
        """Values at the samples of a channel, (k, ...) -> (n, ...): what is given at the instants
        of ``watches``.
        """
        return self._samplings[number].of(values)

    @cached_property
    def _curves(self) -> CurveColumns:
        """How the channels change with curves."""
        return CurveColumns(self.channels, self._samplings)

    def _everywhere(self, effects: Sequence[Effect]) -> list[Array]:
        found = []
        for number, (recording, course) in enumerate(
            zip(self.recordings, self.courses, strict=True)
        ):
            names = {c.sensor for c in self.channels if c.recording == number}
            met = active_in(effects, recording.fingerprint)
            values = readings(
                self.scenario, course, dict.fromkeys(sorted(names), recording.time), met
            )
            found += [
                values[c.sensor][rows, c.column]
                for c, rows in zip(self.channels, self._rows, strict=True)
                if c.recording == number
            ]
        return found

    def changes(self, effect: Effect, around: Sequence[Effect]) -> Columns:
        """How readings change with a small effect: by the closed form at the nominal table, through
        the fitted sensor matrix.
        """
        found: Columns = {}
        if self._whole is not None and self.quick(effect):
            whole = self._whole.changes(effect, around)
            return {i: self._blocks[i].means(column) for i, column in whole.items()}
        for number, watch in enumerate(self.watches(around)):
            changes: dict[str, Array] = {}
            for met in active_in([effect], self.recordings[number].fingerprint):
                changes = watch.changes(met, around)
            for i, c in enumerate(self.channels):
                if c.recording == number and c.sensor in changes:
                    column = self._samplings[i].of(changes[c.sensor][:, c.column])
                    if np.any(column):
                        found[i] = column
        return found

    def columns(
        self, effect: Effect, names: Sequence[str], around: Sequence[Effect]
    ) -> dict[int, tuple[list[int], Array]]:
        """Change of each channel by each size alone; those of a curve all at once. By channel:
        numbers of the sizes, and the changes, SI, (sizes, n).
        """
        if not isinstance(effect, Learned) or effect.seen_in is not None:
            return super().columns(effect, names, around)
        if self._whole is not None and self.quick(effect):
            whole = self._whole.columns(effect, names, around)
            return {i: (k, self._blocks[i].means(each)) for i, (k, each) in whole.items()}
        return self._curves.columns(effect, names, self.watches(around))

    def factors(
        self, effect: Effect, names: Sequence[str], around: Sequence[Effect]
    ) -> dict[int, CurveFactors] | None:
        """Of a product of two angles, which has many coefficients and acts at many places."""
        if not isinstance(effect, Learned) or not effect.beside or self.quick(effect):
            return None
        if list(names) != [f"c{k}" for k in range(effect.count)]:
            return None
        return self._curves.factors(effect, self.watches(around))

    def settings(self, around: Sequence[Effect]) -> list[list[Columns]]:
        """See ``Observations``."""
        return stated_settings(self, around)

    def watches(self, around: Sequence[Effect]) -> list[NominalMotion]:
        """What each recording's sensors sense at the nominal table, through the sensor matrix of
        these effects.
        """
        key = self.depends_on(around)
        if key not in self._watches:
            matrices = self._matrices(around)
            known = next(iter(self._watches.values()), None) or [
                NominalMotion.of(self.scenario, course, grid.time)
                for grid, course in zip(self._grids, self.courses, strict=True)
            ]
            self._watches = {key: [watch.through(matrices) for watch in known]}
        return self._watches[key]

    def depends_on(self, around: Sequence[Effect]) -> bytes:
        """The sensor matrices of these effects, and what the links carry by them."""
        # asked for each column of a fitted model
        if self._around is None or self._around[0] != tuple(around):
            matrices = b"".join(m.tobytes() for m in self._matrices(around).values())
            masses = masses_of(around, self.scenario.rig)
            self._around = tuple(around), matrices + (repr(masses).encode() if masses else b"")
        return self._around[1]

    def _matrices(self, around: Sequence[Effect]) -> dict[str, Array]:
        calibration = [e for e in around if e.role == "calibration"]
        return {
            s.name: sensor_matrix(s, calibration)
            for s in self.scenario.sensor
            if s.kind not in ("fog", "encoder")
        }
