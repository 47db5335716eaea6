"""Outliers of a sensor turned by hand: readings that stand alone off the course of the motion,
where a FOG and the gyro triad disagree.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.statistics.dwell_noise import ARITHMETIC
from tiltcal.statistics.penalised_spline import LinearReadings, SmoothCourse

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
        readings: of one channel; course: None while none is known.
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
