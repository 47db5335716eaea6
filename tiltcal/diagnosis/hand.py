"""Recordings turned by hand, without any angle readout: only what is redundant in them has a model.

A FOG against the gyro triad; at rest the length of the accelerometer's reading, the gyro's reading against the force, and,
in a long rest, how each accelerometer axis wanders; gravity's direction after a turn, carried there by the gyro.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.byhand import (
    at_rest,
    bridged,
    dwell_means,
    earlier,
    forward,
    inverted,
    quiet_readings,
    rate_known,
    sense_of,
    stops_of,
    whole,
)
from tiltcal.diagnosis.observations import Channel, Columns, Observations
from tiltcal.effects.base import Effect
from tiltcal.effects.events import as_met
from tiltcal.frames import Array
from tiltcal.motion import Index
from tiltcal.recording import Recording
from tiltcal.scenario import Scenario
from tiltcal.setup import Sensor

LONG = 60.0  # s: a rest that long tells drifts from noise
WILD = 1e3  # rad/s: beyond it a trial of sizes is absurd, and its rotation would not be a number
EDGE = 0.5  # s at the edge of a rest over which gravity's direction is averaged
Predictor = Callable[["_State"], Array]


@dataclass(frozen=True)
class _State:
    """What a recording's own sensors say of its motion, under some effects: force m/s2 and rate rad/s in the body, (n, 3)."""

    effects: Sequence[Effect]
    force: Array
    rate: Array


class HandObservations(Observations):
    """Recordings turned by hand."""

    def __init__(self, scenario: Scenario, recordings: Sequence[Recording], known: Sequence[Effect]) -> None:
        self.scenario, self.known = scenario, tuple(known)
        self.recordings = tuple(recordings if scenario.sensors("fog") else (condensed(r, stops_of(r)) for r in recordings))
        self.stops = [stops_of(r) for r in self.recordings]
        self._quiet = [self._readings(number) for number in range(len(recordings))]
        pairs = [pair for number in range(len(recordings)) for pair in self._parts(number)]
        self.channels = tuple(channel for channel, _ in pairs)
        self._predictors = tuple(predictor for _, predictor in pairs)
        self._last: tuple[tuple[Effect, ...] | None, list[Array]] = (None, [])

    def predict(self, effects: Sequence[Effect]) -> list[Array]:
        """What each channel should have read."""
        states = [self._state(k, as_met(effects, r.fingerprint)) for k, r in enumerate(self.recordings)]
        return [predictor(states[channel.recording]) for channel, predictor in zip(self.channels, self._predictors, strict=True)]

    def changes(self, effect: Effect, around: Sequence[Effect]) -> Columns:
        """How readings change with a small effect: difference of predictions.

        What was found is left out of the others: in second order it would lend its shape to the calibration terms, of which
        only some combinations can be seen here.
        """
        other = tuple(e for e in around if e.address != effect.address and e.role != "found")
        if self._last[0] != other:
            self._last = (other, self.predict(other))
        pairs = zip(self.predict([*other, effect]), self._last[1], strict=True)
        return {i: new - old for i, (new, old) in enumerate(pairs) if np.any(new != old)}

    def _triads(self, recording: Recording, kind: str) -> list[Sensor]:
        return [s for s in self.scenario.sensors(kind) if recording.has(s) and len(s.axes) == 3][:1]

    def _readings(self, number: int) -> dict[str, Array]:
        """Readings of the triads that the motion is taken from; they do not depend on any effect."""
        recording = self.recordings[number]
        triads = [*self._triads(recording, "accelerometer"), *self._triads(recording, "gyro")]
        return {s.name: quiet_readings(s, recording, self.stops[number]) for s in triads}

    def _state(self, number: int, effects: Sequence[Effect]) -> _State:
        recording, quiet = self.recordings[number], self._quiet[number]
        n = len(recording)
        force, rate = np.full((n, 3), np.nan), np.zeros((n, 3))
        for triad in self._triads(recording, "accelerometer"):
            force = whole(recording, triad, inverted(triad, self.scenario, recording, effects, None, quiet[triad.name]))
        for gyro in self._triads(recording, "gyro"):
            rate = whole(recording, gyro, inverted(gyro, self.scenario, recording, effects, force, quiet[gyro.name]))
        return _State(effects, force, rate)

    def _parts(self, number: int) -> Iterator[tuple[Channel, Predictor]]:
        """Every channel of a recording with what predicts it."""
        recording = self.recordings[number]
        gyros, triads = self._triads(recording, "gyro"), self._triads(recording, "accelerometer")
        for fog in self.scenario.sensors("fog"):
            if recording.has(fog) and gyros:
                yield self._fog(number, fog, gyros[0])
        for triad in triads:
            yield from self._norm(number, triad)
            yield from self._long_rests(number, triad)
            for gyro in gyros:
                yield from self._still_gyro(number, gyro)
                yield from self._turns(number, gyro)

    def _channel(self, number: int, sensor: Sensor, axis: str, column: int, rows: Index, values: Array) -> Channel:
        recording = self.recordings[number]
        return Channel(number, sensor.name, axis, column, rows, recording.time[rows], values, self.stops[number][rows])

    def _fog(self, number: int, fog: Sensor, gyro: Sensor) -> tuple[Channel, Predictor]:
        """A FOG against the gyro triad.

        Effects act on the smoothed rate, else one that averages would gain by averaging noise; what the smoothing took off is
        predicted as it was read: the difference of two white noises is white.
        """
        recording = self.recordings[number]
        samples = recording.sensor(fog)
        there = rate_known(recording, gyro)[samples.rows] & ~np.isnan(samples.values[:, 0])
        rows = samples.rows[there]
        rough = whole(recording, gyro, bridged(gyro, recording) - self._quiet[number][gyro.name])[rows] @ fog.input_vector

        def predict(state: _State) -> Array:
            force = np.where(np.isnan(state.force), 0.0, state.force)
            rate = earlier(state.rate, recording.time, state.effects, fog, gyro)
            return forward(fog, state.effects, sense_of(fog, self.scenario, recording, force, rate))[rows, 0] + rough

        return self._channel(number, fog, "a", 0, rows, samples.values[there, 0]), predict

    def _norm(self, number: int, triad: Sensor) -> Iterator[tuple[Channel, Predictor]]:
        recording, stop = self.recordings[number], self.stops[number]
        samples = recording.sensor(triad)
        there = (stop[samples.rows] >= 0) & ~np.isnan(samples.values).any(axis=1)
        rows, read = samples.rows[there], samples.values[there]
        if len(rows) < 16:
            return
        length = np.linalg.norm(read, axis=1)

        def predict(state: _State) -> Array:
            predicted = at_rest(triad, self.scenario, recording, state.effects, state.force, stop)[rows]
            return np.asarray((predicted * read).sum(axis=1) / length)  # it differs from the reading along it only

        yield self._channel(number, triad, "norm", 0, rows, length), predict

    def _long_rests(self, number: int, triad: Sensor) -> Iterator[tuple[Channel, Predictor]]:
        """Each axis in rests of a minute and more, without its mean: the attitude is unknown, but it stays."""
        recording, stop = self.recordings[number], self.stops[number]
        samples = recording.sensor(triad)
        for k in range(int(stop.max(initial=-1)) + 1):
            there = (stop[samples.rows] == k) & ~np.isnan(samples.values).any(axis=1)
            rows = samples.rows[there]
            if len(rows) < 64 or (recording.time[rows[-1]] - recording.time[rows[0]] < LONG and there.mean() < 0.9):
                continue
            for column, axis in enumerate(triad.axes):
                values = samples.values[there, column]

                def predict(state: _State, rows: Index = rows, column: int = column) -> Array:
                    predicted = at_rest(triad, self.scenario, recording, state.effects, state.force, stop)[rows, column]
                    return np.asarray(predicted - predicted.mean())

                yield self._channel(number, triad, axis, column, rows, values - values.mean()), predict

    def _still_gyro(self, number: int, gyro: Sensor) -> Iterator[tuple[Channel, Predictor]]:
        """The gyro at rest: its bias, and what the force does to it. The Earth's rate is part of it: the heading is unknown."""
        recording, stop = self.recordings[number], self.stops[number]
        samples = recording.sensor(gyro)
        there = (stop[samples.rows] >= 0) & ~np.isnan(samples.values).any(axis=1)
        rows = samples.rows[there]
        if len(rows) < 64:
            return
        kept: dict[str, tuple[_State, Array]] = {}

        def still(state: _State) -> Array:
            if "last" not in kept or kept["last"][0] is not state:  # three channels ask for the same readings
                force = dwell_means(state.force, stop)
                sense = sense_of(gyro, self.scenario, recording, force[rows], np.zeros((len(rows), 3)), rows=rows)
                kept["last"] = (state, forward(gyro, state.effects, sense))
            return kept["last"][1]

        for column, axis in enumerate(gyro.axes):

            def predict(state: _State, column: int = column) -> Array:
                return still(state)[:, column]

            yield self._channel(number, gyro, axis, column, rows, samples.values[there, column]), predict

    def _turns(self, number: int, gyro: Sensor) -> Iterator[tuple[Channel, Predictor]]:
        """Gravity's direction after each turn minus the one carried there by the gyro, across it, rad."""
        recording, stop = self.recordings[number], self.stops[number]
        spans = _turns_between(recording.time, stop)
        if len(spans) < 12 or np.isnan(self._quiet[number][gyro.name]).any():
            return
        rows = np.array([(a + b) // 2 for a, b in spans])
        kept: dict[str, tuple[_State, Array]] = {}

        def errors(state: _State) -> Array:
            if "last" not in kept or kept["last"][0] is not state:
                kept["last"] = (state, closures(recording.time, spans, state))
            return kept["last"][1]

        for column, axis in enumerate("xyz"):

            def predict(state: _State, column: int = column) -> Array:
                return -errors(state)[:, column]

            yield self._channel(number, gyro, axis, column, rows, np.zeros(len(rows))), predict


KEPT_AT_REST = 6000  # rows: a longer log is averaged in its rests


def condensed(recording: Recording, stop: Index) -> Recording:
    """A long log with its rests averaged over short blocks; what happens between them is left alone."""
    resting = int((stop >= 0).sum())
    block = -(-resting // KEPT_AT_REST)
    if block < 2:
        return recording
    group = np.arange(len(recording))
    for k in range(int(stop.max()) + 1):
        rows = np.flatnonzero(stop == k)
        edge = int(EDGE / np.median(np.diff(recording.time)))
        inner = rows[edge : len(rows) - edge]  # the edges are needed sample by sample
        group[inner] = inner[0] + (np.arange(len(inner)) // block) * block if len(inner) else inner
    _, which, count = np.unique(group, return_inverse=True, return_counts=True)
    columns = {n: _averaged(recording.column(n), which, len(count)) for n in recording.column_names}
    time = np.bincount(which, recording.time) / count
    return Recording.from_columns(time, columns, metadata=recording.metadata, source=recording.source)


def _averaged(values: Array, which: Index, n: int) -> Array:
    """Mean of what was sampled in each group, (n,); NaN where nothing was."""
    there = ~np.isnan(values)
    count = np.bincount(which[there], minlength=n)
    total = np.bincount(which[there], values[there], n)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _turns_between(time: Array, stop: Index) -> list[tuple[int, int]]:
    """Last row of each dwell and first row of the next, where both are long enough to know gravity's direction."""
    edges = []
    for k in range(int(stop.max(initial=-1))):
        before, after = np.flatnonzero(stop == k), np.flatnonzero(stop == k + 1)
        if len(before) > 8 and len(after) > 8 and time[after[0]] - time[before[-1]] < 20:
            edges.append((int(before[-1]), int(after[0])))
    return edges


def closures(time: Array, spans: Sequence[tuple[int, int]], state: _State) -> Array:
    """Direction of the force after each turn minus that before, both in the frame before it, (m, 3).

    Every sample at the edges of the rests is carried by the gyro: a hand never holds quite still there.
    """
    from scipy.spatial.transform import Rotation

    rate = float(1 / np.median(np.diff(time)))
    reach = max(round(EDGE * rate), 4)
    found = np.zeros((len(spans), 3))
    for k, (first, last) in enumerate(spans):
        start, end = max(first - reach, 0), min(last + reach, len(time) - 1)
        step = np.diff(time[start : end + 1])[:, None]
        w = np.clip(np.nan_to_num((state.rate[start:end] + state.rate[start + 1 : end + 1]) / 2), -WILD, WILD)
        turned = _running(Rotation.from_rotvec(w * step).as_quat())
        f = state.force[start : end + 1] / np.linalg.norm(state.force[start : end + 1], axis=1)[:, None]
        carried = Rotation.from_quat(turned).apply(f)
        before, after = carried[: first - start + 1].mean(axis=0), carried[last - start :].mean(axis=0)
        found[k] = after / np.linalg.norm(after) - before / np.linalg.norm(before)
    return found


def _running(q: Array) -> Array:
    """Running products 1, q1, q1 q2, ... of quaternions (x, y, z, w), (n + 1, 4), by doubling."""
    total = np.vstack([[0.0, 0.0, 0.0, 1.0], q])
    shift = 1
    while shift < len(total):
        total[shift:] = _times(total[:-shift], total[shift:])
        shift *= 2
    return total / np.linalg.norm(total, axis=1)[:, None]


def _times(a: Array, b: Array) -> Array:
    """Products of quaternions, row by row, (n, 4)."""
    v = a[:, 3:] * b[:, :3] + b[:, 3:] * a[:, :3] + np.cross(a[:, :3], b[:, :3])
    return np.column_stack([v, a[:, 3] * b[:, 3] - (a[:, :3] * b[:, :3]).sum(axis=1)])
