"""Readings of a hand-turned sensor that stand alone, as outliers do: off the course of the motion,
while a FOG and the gyro triad differ.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.statistics.dwell_noise import ARITHMETIC
from tiltcal.statistics.penalised_spline import LinearReadings, SmoothCourse

AROUND = 3  # samples on either side, among which an outlier stands alone


def differences(fog: LinearReadings, triad: Sequence[LinearReadings]) -> LinearReadings:
    """What a FOG reads otherwise than the triad: whatever the motion, nothing but noise."""
    off, variance = fog.value.copy(), 1 / np.maximum(fog.weight, ARITHMETIC)
    for of, share in zip(triad, fog.direction.T, strict=True):
        off -= share * np.interp(fog.time, of.time, of.value)
        weight = np.interp(fog.time, of.time, of.weight)
        variance = variance + share**2 / np.maximum(weight, ARITHMETIC)
    return replace(fog, value=off, direction=np.zeros_like(fog.direction), weight=1 / variance)


def alone(readings: LinearReadings, course: SmoothCourse | None = None) -> tuple[Array, Mask]:
    """When readings were taken, s, and which stand alone off a course, or off nothing, farther than
    half a reading in all is by chance (Chauvenet). (m,) each.

    Each is compared with the median of its neighbours: what a wrong model adds is smooth.
    """
    from scipy.ndimage import median_filter
    from scipy.special import erfcinv

    off, n = readings.value, len(readings.time)
    if course is not None:
        off = off - (readings.direction * course.at(readings.time)).sum(axis=1)
    off = off - median_filter(off, 2 * AROUND + 1, mode="nearest")
    limit = np.sqrt(2) * float(erfcinv(1 / (2 * n)))
    return readings.time, np.abs(off) * np.sqrt(readings.weight) > limit


def without_outliers(
    readings: LinearReadings,
    course: SmoothCourse | None,
    apart: Sequence[tuple[Array, Mask]],
) -> LinearReadings:
    """Readings without those that stand alone off a course, while a FOG and the triad differ: where
    a hand lets go at once, the course is off, and they agree.

    Args:
        readings: of one channel; course: None while none is known.
        apart: when each FOG was read, s, and whether it stands alone off the triad, (m,) each.
    """
    if course is None or len(readings.time) < 2 * AROUND + 1:
        return readings
    time, far = alone(readings, course)
    for others, differs in apart:
        far &= np.interp(time, others, differs) > 0
    return replace(readings, weight=np.where(far, 0.0, readings.weight))
