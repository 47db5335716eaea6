"""Hand-held recordings: the attitude comes from the recording's own sensors, so only redundant
readings are predicted.
"""

from collections.abc import Sequence

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.core.errors import TiltcalError
from tiltcal.effects.base import DelayEffect, Effect, SignalEffect
from tiltcal.effects.sense import Sense
from tiltcal.laboratory.smoothing import bridged, quiet_readings, stops_of
from tiltcal.recordings.recording import Recording
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup

ITERATIONS = 6
CONVERGED = 1e-10  # of the largest reading


def predicted_readings(
    setup: Setup, motion: Recording, effects: Sequence[Effect]
) -> dict[str, Array]:
    """What each sensor should read by the others, SI, (n, k) at the recording's rows; NaN where
    nothing predicts it.

    FOGs from the gyro triad's rate, interpolated to their stamps, and what its smoothing took off
    as it was read; an accelerometer triad at standstill from |f| = g along its own corrected
    direction. Gyro triads predict themselves.

    Raises:
        TiltcalError: there is no gyro triad and no accelerometer triad.
    """
    gyros, triads = triads_of(setup, motion, "gyro"), triads_of(setup, motion, "accelerometer")
    if not gyros and not triads:
        raise TiltcalError(
            motion.source,
            found="no gyro triad and no accelerometer triad",
            need="one of them to take the attitude from",
            do="predict a recording of a table instead",
        )
    force = force_felt(setup, motion, effects)
    found: dict[str, Array] = {}
    rate = noise = np.zeros((len(motion), 3))
    if gyros:
        quiet = quiet_readings(gyros[0], motion)
        rate = whole(motion, gyros[0], inverted(gyros[0], setup, motion, effects, force, quiet))
        noise = whole(motion, gyros[0], bridged(gyros[0], motion) - quiet)
        found[gyros[0].name] = motion_values(motion, gyros[0])
    for fog in setup.sensors("fog"):
        felt = earlier(rate, motion.time, effects, fog, gyros[0]) if gyros else rate
        sense = sense_of(fog, setup, motion, np.where(np.isnan(force), 0.0, force), felt)
        found[fog.name] = forward(fog, effects, sense) + (noise @ fog.input_vector)[:, None]
    if triads:
        found[triads[0].name] = at_rest(triads[0], setup, motion, effects, force)
    return found


def triads_of(setup: Setup, motion: Recording, kind: str) -> list[Sensor]:
    """The triads of one kind that a recording has."""
    return [s for s in setup.sensors(kind) if motion.has(s) and len(s.axes) == 3]


def force_felt(setup: Setup, motion: Recording, effects: Sequence[Effect]) -> Array:
    """Specific force by the accelerometer triad, m/s2, (n, 3); NaN without one."""
    for triad in triads_of(setup, motion, "accelerometer"):
        return whole(motion, triad, inverted(triad, setup, motion, effects))
    return np.full((len(motion), 3), np.nan)


def earlier(
    rate: Array, time: Array, effects: Sequence[Effect], fog: Sensor, gyro: Sensor
) -> Array:
    """The body's rate when a FOG's reading was taken, (n, 3), from the rate of a gyro triad,
    with the delay of each.
    """
    delays = [
        e
        for e in effects
        if isinstance(e, DelayEffect) and e.sensor in (fog.name, gyro.name) and not e.is_identity
    ]
    if not delays:
        return rate
    from scipy.interpolate import CubicSpline

    elapsed = time - time[0]
    found = np.empty_like(rate)
    for k, axis in enumerate(gyro.axis_indices):
        shift = np.zeros_like(time)
        for effect in delays:
            shift += (
                effect.delay(elapsed, 0, None)
                if effect.sensor == fog.name
                else -effect.delay(elapsed, k, None)
            )
        found[:, axis] = CubicSpline(time, rate[:, axis])(np.clip(time - shift, time[0], time[-1]))
    return found


def motion_values(motion: Recording, sensor: Sensor) -> Array:
    """A sensor's own readings at full length, SI, (n, k)."""
    samples = motion.sensor(sensor)
    full = np.full((len(motion), len(sensor.axes)), np.nan)
    full[samples.rows] = samples.values
    return full


def whole(motion: Recording, sensor: Sensor, values: Array) -> Array:
    """Values at the sensor's rows, interpolated to all rows, (n, 3)."""
    time = motion.sensor(sensor).time
    return np.column_stack(
        [np.interp(motion.time, time, values[:, i]) for i in range(values.shape[1])]
    )


def inverted(
    sensor: Sensor,
    setup: Setup,
    motion: Recording,
    effects: Sequence[Effect],
    force: Array | None = None,
    read: Array | None = None,
) -> Array:
    """The true input of a triad from its readings, (m, 3): by steps through its matrix, so that
    only what the chain bends is left to the next.
    """
    samples = motion.sensor(sensor)
    y = quiet_readings(sensor, motion) if read is None else read
    true = y.copy()
    back = np.linalg.pinv(sensor_matrix(sensor, effects)).T
    f = (
        np.zeros_like(true)
        if force is None
        else np.where(np.isnan(force), 0.0, force)[samples.rows]
    )
    for _ in range(ITERATIONS):
        inputs = (true, np.zeros_like(true)) if sensor.kind == "accelerometer" else (f, true)
        sense = sense_of(sensor, setup, motion, *inputs, rows=samples.rows)
        step = (y - forward(sensor, effects, sense)) @ back
        true = true + step
        if np.abs(step).max(initial=0.0) < CONVERGED * np.abs(y).max(initial=0.0):
            break
    return true


def sensor_matrix(sensor: Sensor, effects: Sequence[Effect]) -> Array:
    """Reading per unit of force or rate in the body frame, (k, 3): scale and cross-axis terms of
    these effects.
    """
    matrix = np.eye(3)[list(sensor.axis_indices)]
    for effect in (e for e in effects if e.sensor == sensor.name):
        for parameter, value in effect.values.items():
            word, _, axes = parameter.rpartition("_")
            if word == "scale" and axes in sensor.axes:
                matrix[sensor.axes.index(axes), "xyz".index(axes)] += value
            elif word == "cross":
                matrix[sensor.axes.index(axes[0]), "xyz".index(axes[1])] += value
    return matrix


def sense_of(
    sensor: Sensor,
    setup: Setup,
    motion: Recording,
    force: Array,
    rate: Array,
    rows: "np.ndarray[tuple[int], np.dtype[np.intp]] | None" = None,
) -> Sense:
    """What a hand-held sensor senses. force: m/s2, (n, 3); rate: rad/s, (n, 3); rows: (m,)."""
    time = motion.time if rows is None else motion.time[rows]
    temperature = motion.temperature()
    warm = np.zeros(len(motion)) if temperature is None else temperature - temperature.mean()
    vector = sensor.input_vector if sensor.kind == "fog" else np.zeros(3)
    angular_acceleration = np.zeros_like(rate)
    if sensor.quantity == "rate" and len(time) > 1:
        angular_acceleration = np.gradient(rate, time, axis=0)
    return Sense(
        time,
        time - motion.time[0],
        force,
        rate,
        force / setup.site.gravity,
        np.zeros_like(rate),
        angular_acceleration,
        warm if rows is None else warm[rows],
        sensor.axis_indices,
        sensor.kind,
        vector,
        setup.site.gravity,
        sensor.rate_hz,
        sensor.full_scale,
    )


def forward(sensor: Sensor, effects: Sequence[Effect], sense: Sense) -> Array:
    """The readings of a sensor with its own effects, in their order, SI, (n, k)."""
    reading = sense.true_input()
    mine = [
        e
        for e in effects
        if isinstance(e, SignalEffect) and e.sensor == sensor.name and not e.random
    ]
    for effect in sorted(mine, key=lambda e: e.order):
        if not effect.is_identity:
            reading = effect.apply(reading, sense, None)
    return reading


def at_rest(
    sensor: Sensor,
    setup: Setup,
    motion: Recording,
    effects: Sequence[Effect],
    force: Array,
    stop: Index | None = None,
) -> Array:
    """The triad's reading in its dwells: |f| = g along the dwell's own mean direction; NaN while
    moving. force: m/s2, (n, 3); the reading has the same shape.
    """
    means = dwell_means(force, stops_of(motion) if stop is None else stop)
    length = np.linalg.norm(means, axis=1)
    full = np.where(
        length[:, None] > 0,
        means * setup.site.gravity / np.where(length > 0, length, 1.0)[:, None],
        np.nan,
    )
    known = ~np.isnan(full[:, 0])
    # a lagged input starts in the move before
    felt = np.where(known[:, None], full, np.nan_to_num(force))
    sense = sense_of(sensor, setup, motion, felt, np.zeros_like(full))
    predicted = forward(sensor, effects, sense)
    predicted[~known] = np.nan
    return predicted


def rate_known(motion: Recording, gyro: Sensor) -> "np.ndarray[tuple[int], np.dtype[np.bool_]]":
    """Rows between two whole readings of a gyro triad that follow each other, (n,)."""
    values = motion_values(motion, gyro)
    sampled = ~np.isnan(values).all(axis=1)
    broken = sampled & np.isnan(values).any(axis=1)
    time = motion.sensor(gyro).time
    cadence = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    whole = np.flatnonzero(sampled & ~broken)
    if len(whole) < 2:
        return np.zeros(len(motion), bool)
    k = np.clip(np.searchsorted(whole, np.arange(len(motion))), 1, len(whole) - 1)
    near = motion.time[whole[k]] - motion.time[whole[k - 1]] < 2.5 * cadence
    return np.asarray((near | np.isin(np.arange(len(motion)), whole)) & ~broken)


def dwell_means(values: Array, stop: Index) -> Array:
    """The mean over the dwell of each row, (n, k); 0 while moving, and in a dwell without
    values.
    """
    still = (stop >= 0) & ~np.isnan(values).any(axis=1)
    count = np.bincount(stop[still], minlength=int(stop.max(initial=-1)) + 1)
    found = np.zeros_like(values)
    there = stop >= 0
    for k in range(values.shape[1]):
        means = np.bincount(stop[still], values[still, k], len(count)) / np.maximum(count, 1)
        found[there, k] = means[stop[there]]
    return found
