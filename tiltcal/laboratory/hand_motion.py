"""The motion of a hand-held body: gyro triad and FOGs smoothed together.

Each reading, put through the inverse of its sensor's model, is a reading of the body's rate: one
component of the gyro triad, or the component along a FOG's axis. Its weight is one over its
variance. At standstill the rate is constant; while moving its smoothness is estimated
(``tiltcal.statistics.splines``).

Outliers are readings that stand alone off the course of the motion, where a FOG and the gyro triad
disagree.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.core.quantisation import lsb_width
from tiltcal.effects.base import DelayEffect, Effect
from tiltcal.forward.gravity_transport import EDGE
from tiltcal.laboratory.handheld import (
    force_felt,
    forward,
    inverted,
    predicted_readings,
    sense_of,
    triads_of,
)
from tiltcal.laboratory.smoothing import bridged, stops_of
from tiltcal.recordings.recording import Recording
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.statistics.dwell_noise import ARITHMETIC, MAD_TO_SIGMA
from tiltcal.statistics.noise_spectrum import CHI2_MEDIAN
from tiltcal.statistics.splines import (
    LinearReadings,
    SmoothCourse,
    SplineBasis,
    most_probable_course,
)

AROUND = 3  # samples on either side, among which an outlier stands alone


def apart(fog: LinearReadings, triad: Sequence[LinearReadings]) -> tuple[Array, Mask]:
    """When a FOG was read, s, (m,), and where it and the triad read otherwise, by an outlier of one
    of them, (m,): the motion cancels in their difference.
    """
    off, variance = fog.value.copy(), 1 / np.maximum(fog.weight, ARITHMETIC)
    for of, share in zip(triad, fog.direction.T, strict=True):
        off -= share * np.interp(fog.time, of.time, of.value)
        weight = np.interp(fog.time, of.time, of.weight)
        variance = variance + share**2 / np.maximum(weight, ARITHMETIC)
    return fog.time, _alone(off, 1 / variance)


def without_outliers(
    readings: LinearReadings,
    course: SmoothCourse | None,
    disagreeing: Sequence[tuple[Array, Mask]],
) -> LinearReadings:
    """Readings without those that stand alone off a course, where a FOG and the triad disagree:
    where a hand stops at once the course is off, and they agree. Without a FOG all are kept.

    Args:
        readings: of one channel.
        course: None while none is known.
        disagreeing: of each FOG, see ``apart``, (m,) each.
    """
    if course is None or not disagreeing or len(readings.time) < 2 * AROUND + 1:
        return readings
    off = readings.value - (readings.direction * course.at(readings.time)).sum(axis=1)
    far = _alone(off, readings.weight)
    for time, differs in disagreeing:
        far &= np.interp(readings.time, time, differs) > 0
    return replace(readings, weight=np.where(far, 0.0, readings.weight))


def _alone(off: Array, weight: Array) -> Mask:
    """Which values stand alone, farther off the median of their neighbours than half a value in all
    is by chance (Chauvenet), (m,): what a wrong model adds is smooth. weight: one over the
    variance, (m,).
    """
    from scipy.ndimage import median_filter
    from scipy.special import erfcinv

    off = off - median_filter(off, 2 * AROUND + 1, mode="nearest")
    limit = np.sqrt(2) * float(erfcinv(1 / (2 * len(off))))
    return np.asarray(np.abs(off) * np.sqrt(weight) > limit)


PASSES = 3  # the first with all readings, as smooth everywhere; then about the one before
# s between knots, where samples are not farther apart: a hand trembles at 12 Hz and no faster
FASTEST = 0.02
# of the noise of their difference, rms: a larger one is more than smoothing both could save
AGREEING = 2.0
SECANT = 10.0  # sigma: the step over which the slope of a sensor's curve is taken
ENOUGH = 50  # differences from which noise is estimated


def smoothed_readings(
    setup: Setup, motion: Recording, effects: Sequence[Effect]
) -> dict[str, Array]:
    """What each sensor should have read without its noise, SI, (n, k) at the recording's rows; NaN
    where nothing predicts it.

    Gyro triad and FOGs from the rate estimated from all of them, their own readings included; an
    accelerometer triad as by ``predicted_readings``.

    Raises:
        TiltcalError: there is no gyro triad and no accelerometer triad.
    """
    found = predicted_readings(setup, motion, effects)
    gyros = triads_of(setup, motion, "gyro")
    if not gyros or not len(motion.sensor(gyros[0]).rows):
        return found
    fogs = tuple(f for f in setup.sensors("fog") if motion.has(f) and len(motion.sensor(f).rows))
    force = force_felt(setup, motion, effects)
    hand = HandMotion(setup, motion, effects, gyros[0], fogs, force)
    found |= {fog.name: hand.fog_reading(fog) for fog in setup.sensors("fog")}
    return found | {gyros[0].name: hand.gyro_reading()}


@dataclass(frozen=True)
class HandMotion:
    """The motion of a recording as estimated from its readings under a model.

    Args:
        setup, motion, effects: the sensors, their readings and their model.
        gyro: a triad.
        fogs: those with readings.
        force: specific force in the body, m/s2, NaN where it is not known, (n, 3).
    """

    setup: Setup
    motion: Recording
    effects: Sequence[Effect]
    gyro: Sensor
    fogs: tuple[Sensor, ...]
    force: Array

    def gyro_reading(self) -> Array:
        """What the triad should have read, rad/s, (n, 3), NaN where it was not sampled."""
        rows = self.motion.sensor(self.gyro).rows
        rate = self._gyro_rate(self.course)
        sense = sense_of(
            self.gyro, self.setup, self.motion, self._known_force[rows], rate, rows=rows
        )
        found = np.full((len(self.motion), 3), np.nan)
        found[rows] = forward(self.gyro, self.effects, sense)
        return found

    def fog_reading(self, fog: Sensor) -> Array:
        """What a FOG should have read, rad/s, (n, 1), whether it was sampled or not."""
        rate = self.course.at(self.motion.time - self._delay(fog, 0))
        return self._forward(fog, rate)

    @cached_property
    def course(self) -> SmoothCourse:
        """The body's rate, rad/s."""
        gyro, found = list(self._gyro_readings()), None
        agreeing = [fog for fog in self.fogs if self._agrees(fog, gyro)]
        growth = max((self._growth(fog) for fog in agreeing), default=1.0)
        for _ in range(PASSES):
            fogs = [self._fog_readings(fog, found) for fog in agreeing]
            triad, others = ([self._in_motion(r, growth) for r in some] for some in (gyro, fogs))
            disagreeing = [apart(r, triad) for r in others]
            kept = [without_outliers(r, found, disagreeing) for r in (*triad, *others)]
            found = most_probable_course(self._basis, kept, found)
        assert found is not None
        return found

    @property
    def _basis(self) -> SplineBasis:
        time, stop = self.motion.time, stops_of(self.motion)
        first = np.flatnonzero(np.diff(stop, prepend=-1) * (stop >= 0))
        last = np.flatnonzero(np.diff(stop, append=-1) * (stop >= 0))
        # the hand has not quite let go, or begins to move
        edge = np.minimum(EDGE, (time[last] - time[first]) / 4)
        begin = np.where(first > 0, time[first] + edge, time[0])
        end = np.where(last < len(time) - 1, time[last] - edge, time[-1])
        standstills = tuple(zip(begin.tolist(), end.tolist(), strict=True))
        stamps = self.motion.sensor(self.gyro).time
        step = max(float(np.median(np.diff(stamps))), FASTEST) if len(stamps) > 1 else FASTEST
        return SplineBasis(float(time[0]), float(time[-1]), step, standstills)

    @cached_property
    def _known_force(self) -> Array:
        return np.where(np.isnan(self.force), 0.0, self.force)

    @cached_property
    def _inverse(self) -> Array:
        """The triad's readings through the inverse of its model, rad/s, (m, 3)."""
        read = bridged(self.gyro, self.motion)
        return inverted(self.gyro, self.setup, self.motion, self.effects, self.force, read)

    def _delay(self, sensor: Sensor, channel: int) -> Array:
        """Delay of a channel's readings, s, (n,)."""
        elapsed = self.motion.time - self.motion.time[0]
        mine = [e for e in self.effects if isinstance(e, DelayEffect) and e.sensor == sensor.name]
        delays = (e.delay(elapsed, channel, None) for e in mine if not e.is_identity)
        return np.asarray(sum(delays, np.zeros_like(elapsed)))

    def _gyro_rate(self, course: SmoothCourse) -> Array:
        """The rate when each axis of the triad was read, (m, 3)."""
        samples = self.motion.sensor(self.gyro)
        delay = [self._delay(self.gyro, k)[samples.rows] for k in range(3)]
        return np.column_stack([course.at(samples.time - delay[k])[:, k] for k in range(3)])

    def _forward(self, fog: Sensor, rate: Array) -> Array:
        sense = sense_of(fog, self.setup, self.motion, self._known_force, rate)
        return forward(fog, self.effects, sense)

    def _gyro_readings(self) -> Iterator[LinearReadings]:
        samples, rate = self.motion.sensor(self.gyro), self._inverse
        noise = np.array([self._noise(self.gyro, k) for k in range(3)])

        def read(by: Array) -> Array:
            force = self._known_force[samples.rows]
            sense = sense_of(self.gyro, self.setup, self.motion, force, rate + by, samples.rows)
            return forward(self.gyro, self.effects, sense)

        slope = _slope(read, SECANT * noise)
        for k in range(3):
            weight = slope[:, k] ** 2 / noise[k] ** 2
            weight[np.isnan(samples.values[:, k])] = 0.0
            direction = np.tile(np.eye(3)[k], (len(rate), 1))
            time = samples.time - self._delay(self.gyro, k)[samples.rows]
            yield LinearReadings(time, direction, rate[:, k], weight)

    def _fog_readings(self, fog: Sensor, course: SmoothCourse | None) -> LinearReadings:
        """The rate along a FOG's axis: that of a course, and by how much it reads otherwise."""
        samples, axis = self.motion.sensor(fog), fog.input_vector
        delay, stamps = self._delay(fog, 0), self.motion.sensor(self.gyro).time
        time = self.motion.time - delay
        if course is None:
            rate = np.column_stack([np.interp(time, stamps, v) for v in self._inverse.T])
        else:
            rate = course.at(time)
        noise, at = self._noise(fog, 0), samples.rows
        step = np.array([SECANT * noise])
        slope = _slope(lambda by: self._forward(fog, rate + by * axis), step)
        value = rate @ axis
        value[at] += samples.values[:, 0] - self._forward(fog, rate)[at, 0]
        direction = np.tile(axis, (len(at), 1))
        return LinearReadings(time[at], direction, value[at], slope[at, 0] ** 2 / noise**2)

    def _agrees(self, fog: Sensor, gyro: Sequence[LinearReadings]) -> bool:
        """Whether a FOG and the triad read the same within their noise, at standstill and while
        moving.

        Where they do not, the model misses more than noise, and of which sensor is unknown.
        """
        readings, axis = self._fog_readings(fog, None), fog.input_vector
        off, variance = readings.value.copy(), np.zeros(len(readings.time))
        informative = readings.weight > 0
        for of, share in zip(gyro, axis, strict=True):
            off -= share * np.interp(readings.time, of.time, of.value)
            best = of.weight.max(initial=ARITHMETIC)
            informative &= np.interp(readings.time, of.time, of.weight) > best / 4
            variance += share**2 / best
        variance += 1 / readings.weight.max(initial=ARITHMETIC)
        moving = stops_of(self.motion)[self.motion.sensor(fog).rows] < 0
        variance[moving] *= self._growth(fog) ** 2
        classes = (informative & moving, informative & ~moving)
        ratios = [float(np.median(off[c] ** 2 / variance[c])) for c in classes if c.any()]
        return bool(ratios) and max(ratios) < AGREEING**2 * CHI2_MEDIAN

    def _growth(self, fog: Sensor) -> float:
        """Noise in motion over noise at standstill, at least one: by the fourth
        differences of what a FOG and the triad differ by, in which the motion cancels.
        """
        samples, stamps = self.motion.sensor(fog), self.motion.sensor(self.gyro).time
        along = np.interp(samples.time, stamps, self._inverse @ fog.input_vector)
        change = np.diff(samples.values[:, 0] - along, 4) ** 2
        moving = stops_of(self.motion)[samples.rows] < 0
        moves = np.convolve(moving, np.ones(5), "valid")
        every = [change[(moves == count) & np.isfinite(change)] for count in (5, 0)]
        if min(len(some) for some in every) < ENOUGH:
            return 1.0
        turning, still = (float(np.median(some)) for some in every)
        return float(np.sqrt(max(turning / max(still, ARITHMETIC**2), 1.0)))

    def _in_motion(self, readings: LinearReadings, growth: float) -> LinearReadings:
        """Readings whose noise in motion is so many times that at standstill."""
        stop = stops_of(self.motion)
        rows = np.clip(np.searchsorted(self.motion.time, readings.time), 0, len(stop) - 1)
        times = np.where(stop[rows] < 0, growth, 1.0)
        return replace(readings, weight=readings.weight / times**2)

    def _noise(self, sensor: Sensor, channel: int) -> float:
        """Standard deviation of a sample, rad/s: from its readings at standstill, where
        there are enough.
        """
        samples = self.motion.sensor(sensor)
        values = samples.values[:, channel]
        known = ~np.isnan(values)
        still = known & (stops_of(self.motion)[samples.rows] >= 0)
        values = values[still if still.sum() > known.sum() / 4 else known]
        if len(values) < 8:
            return 1.0
        # fourth differences; their variance is 70 times that of a sample
        noise = MAD_TO_SIGMA * float(np.median(np.abs(np.diff(values, 4)))) / np.sqrt(70)
        return max(noise, lsb_width(values) / np.sqrt(12), ARITHMETIC)


def _slope(read: Callable[[Array], Array], step: Array) -> Array:
    """Smaller of the slopes of a sensor's curve on either side, within 0 and 1, (m, k).

    Beyond the end of its range it is 0: such a reading holds no information on the rate.
    """
    here, above, below = read(0.0 * step), read(step), read(-step)
    return np.clip(np.minimum(above - here, here - below) / step, 0.0, 1.0)
