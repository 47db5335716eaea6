"""The redundant readings of a recording turned by hand, each with what predicts it.

A FOG against the gyro triad; at rest the length of the accelerometer's reading and the gyro's
reading against the force; in a long rest how each accelerometer axis wanders; after a turn
gravity's direction against the one that the gyro carried there.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.diagnosis.data.handheld_recording import HandheldRecording, MotionState
from tiltcal.diagnosis.data.observations import Channel
from tiltcal.diagnosis.data.sensor_perturbation import SensorPerturbation
from tiltcal.forward.gravity_transport import GravityTransport, Windows
from tiltcal.laboratory.handheld import (
    at_rest,
    dwell_means,
    earlier,
    forward,
    rate_known,
    sense_of,
    whole,
)
from tiltcal.laboratory.smoothing import bridged
from tiltcal.setup.sensor import Sensor
from tiltcal.statistics.dwell_noise import robust_white

LONG = 60.0  # s: a rest that long tells drifts from noise
LEAST_REST, LEAST_ROWS = 16, 64  # rows at rest, of a length and of anything else
Predict = Callable[[MotionState], Array]
Respond = Callable[[SensorPerturbation], Array | None]


@dataclass(frozen=True)
class Part:
    """A channel of a recording turned by hand.

    Args:
        channel: what was read.
        predict: what should have been read in a state of motion, (n,).
        respond: change by each size of a perturbation, (p, n); None where it is of another sensor.
    """

    channel: Channel
    predict: Predict
    respond: Respond


def parts_of(of: HandheldRecording) -> Iterator[Part]:
    """Every channel of a recording with what predicts it."""
    for fog in of.scenario.sensors("fog"):
        if of.recording.has(fog) and of.gyros:
            yield _fog(of, fog, of.gyros[0])
    for triad in of.accelerometers:
        yield from _norm(of, triad)
        yield from _long_rests(of, triad)
        for gyro in of.gyros:
            yield from _still_gyro(of, gyro)
            yield from _turns(of, gyro)


def _channel(
    of: HandheldRecording, sensor: Sensor, axis: str, column: int, rows: Index, values: Array
) -> Channel:
    time, stop = of.recording.time[rows], of.stop[rows]
    return Channel(of.number, sensor.name, axis, column, rows, time, values, stop)


def _fog(of: HandheldRecording, fog: Sensor, gyro: Sensor) -> Part:
    """A FOG against the gyro triad.

    Effects act on the smoothed rate: one that averages would otherwise gain by averaging noise.
    What the smoothing took off is predicted as it was read: the difference of two white noises is
    white.
    """
    recording = of.recording
    samples = recording.sensor(fog)
    there = rate_known(recording, gyro)[samples.rows] & ~np.isnan(samples.values[:, 0])
    rows = samples.rows[there]
    noise = bridged(gyro, recording) - of.readings[gyro.name]
    rough = whole(recording, gyro, noise)[rows] @ fog.input_vector

    def predict(state: MotionState) -> Array:
        force = np.where(np.isnan(state.force), 0.0, state.force)
        rate = earlier(state.rate, recording.time, state.effects, fog, gyro)
        sense = sense_of(fog, of.scenario, recording, force, rate)
        return forward(fog, state.effects, sense)[rows, 0] + rough

    def respond(push: SensorPerturbation) -> Array | None:
        change = push.fog(fog)
        return None if change is None else change[rows].T

    return Part(_channel(of, fog, "a", 0, rows, samples.values[there, 0]), predict, respond)


def _norm(of: HandheldRecording, triad: Sensor) -> Iterator[Part]:
    """The length of the accelerometer's reading at rest."""
    samples = of.recording.sensor(triad)
    there = of.calm[samples.rows] & ~np.isnan(samples.values).any(axis=1)
    rows, read = samples.rows[there], samples.values[there]
    if len(rows) < LEAST_REST:
        return
    length = np.linalg.norm(read, axis=1)

    def predict(state: MotionState) -> Array:
        every = at_rest(triad, of.scenario, of.recording, state.effects, state.force, of.stop)
        # it differs from the reading along it only
        return np.asarray((every[rows] * read).sum(axis=1) / length)

    def respond(push: SensorPerturbation) -> Array | None:
        if push.sensor != triad:
            return None
        return np.asarray(np.einsum("nip,ni->pn", push.resting[rows], read / length[:, None]))

    channel = replace(_channel(of, triad, "norm", 0, rows, length), derived=True)
    yield Part(channel, predict, respond)


def _long_rests(of: HandheldRecording, triad: Sensor) -> Iterator[Part]:
    """Each axis in rests of a minute and more, without its mean: the attitude is unknown, but it
    stays.
    """
    time, samples = of.recording.time, of.recording.sensor(triad)
    for k in range(int(of.stop.max(initial=-1)) + 1):
        there = (of.stop[samples.rows] == k) & ~np.isnan(samples.values).any(axis=1)
        rows = samples.rows[there]
        if len(rows) < LEAST_ROWS or (time[rows[-1]] - time[rows[0]] < LONG and there.mean() < 0.9):
            continue
        for column in range(len(triad.axes)):
            yield _long_rest(of, triad, column, rows, samples.values[there, column])


def _long_rest(
    of: HandheldRecording, triad: Sensor, column: int, rows: Index, values: Array
) -> Part:
    """One axis in one long rest."""

    def predict(state: MotionState) -> Array:
        every = at_rest(triad, of.scenario, of.recording, state.effects, state.force, of.stop)
        predicted = every[rows, column]
        return np.asarray(predicted - predicted.mean())

    def respond(push: SensorPerturbation) -> Array | None:
        if push.sensor != triad:
            return None
        change = push.resting[rows, column].T
        return np.asarray(change - change.mean(axis=1, keepdims=True))

    channel = _channel(of, triad, triad.axes[column], column, rows, values - values.mean())
    return Part(replace(channel, derived=True), predict, respond)


def _still_gyro(of: HandheldRecording, gyro: Sensor) -> Iterator[Part]:
    """The gyro at rest: its bias, and what the force does to it. Earth's rate is part of the bias:
    the heading is unknown.
    """
    samples = of.recording.sensor(gyro)
    there = of.calm[samples.rows] & ~np.isnan(samples.values).any(axis=1)
    rows = samples.rows[there]
    if len(rows) < LEAST_ROWS:
        return
    kept: dict[str, tuple[MotionState, Array]] = {}

    def still(state: MotionState) -> Array:
        # three channels ask for the same readings
        if "last" not in kept or kept["last"][0] is not state:
            force = dwell_means(state.force, of.stop)[rows]
            zero = np.zeros((len(rows), 3))
            sense = sense_of(gyro, of.scenario, of.recording, force, zero, rows=rows)
            kept["last"] = (state, forward(gyro, state.effects, sense))
        return kept["last"][1]

    for column, axis in enumerate(gyro.axes):

        def predict(state: MotionState, column: int = column) -> Array:
            return still(state)[:, column]

        def respond(push: SensorPerturbation, column: int = column) -> Array | None:
            if push.sensor != gyro:
                return None
            return push.still[np.searchsorted(push.at, rows), column].T

        values = samples.values[there, column]
        yield Part(_channel(of, gyro, axis, column, rows, values), predict, respond)


def _turns(of: HandheldRecording, gyro: Sensor) -> Iterator[Part]:
    """Gravity's direction after each turn minus the one carried there by the gyro, rad: three
    components a turn.

    One channel of all three: few turns have to tell their noise beside many terms.
    """
    windows = of.windows
    if windows is None:
        return
    rows = np.repeat(windows.middle, 3)

    def predict(state: MotionState) -> Array:
        return -GravityTransport(windows, state.force, state.rate).errors.ravel()

    def respond(push: SensorPerturbation) -> Array | None:
        if push.sensor.kind == "fog":
            return None
        return -push.turns.reshape(-1, push.turns.shape[2]).T

    channel = _channel(of, gyro, "turn", 0, rows, np.zeros(len(rows)))
    yield Part(replace(channel, derived=True, white=_least(of, windows)), predict, respond)


def _least(of: HandheldRecording, windows: Windows) -> float:
    """Standard deviation, rad, of a turn's closure by the accelerometer's white noise alone."""
    values = bridged(of.accelerometers[0], of.recording)
    noise = float(np.sqrt(np.mean([robust_white(v) ** 2 for v in values.T])))
    both = np.median((windows.before**2).sum(axis=1) + (windows.after**2).sum(axis=1))
    return noise / of.scenario.site.gravity * float(np.sqrt(both))
