"""Recordings turned by hand, without any angle readout: only redundant readings have a model.

The redundant readings of a recording turned by hand, each with what predicts it.

A FOG against the gyro triad; at rest the length of the accelerometer's reading and the gyro's
reading against the force; in a long rest how each accelerometer axis wanders; after a turn
gravity's direction against the one that the gyro carried there.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.diagnosis.data.channels import column_values
from tiltcal.diagnosis.data.handheld_recording import (
    HandheldRecording,
    MotionState,
    condensed,
    direction_polynomials,
    inner,
    no_less,
    rest_steps,
)
from tiltcal.diagnosis.data.observations import Channel, Columns, Observations, Signal
from tiltcal.diagnosis.data.sensor_perturbation import HandheldMotion, SensorPerturbation
from tiltcal.effects.base import DelayEffect, Effect, SignalEffect
from tiltcal.effects.events import active_in
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
from tiltcal.laboratory.scenario import Scenario
from tiltcal.laboratory.smoothing import bridged
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.replay import nearest_rows
from tiltcal.recordings.static_poses import group_directions
from tiltcal.setup.sensor import Sensor
from tiltcal.statistics.dwell_noise import robust_white
from tiltcal.statistics.noise_spectrum import NoiseFit

LONG = 60.0  # s: a rest that long tells drifts from noise
LEAST_REST, LEAST_ROWS = 16, 64  # rows at rest, of a length and of anything else
Predict = Callable[[MotionState], Array]
Respond = Callable[[SensorPerturbation], Array | None]


@dataclass(frozen=True)
class RedundantChannel:
    """A channel of a recording turned by hand.

    Args:
        channel: what was read.
        predict: what should have been read in a state of motion, (n,).
        respond: change by each size of a perturbation, (p, n); None where it is of another sensor.
    """

    channel: Channel
    predict: Predict
    respond: Respond


def parts_of(of: HandheldRecording) -> Iterator[RedundantChannel]:
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


def _fog(of: HandheldRecording, fog: Sensor, gyro: Sensor) -> RedundantChannel:
    """A FOG against the gyro triad.

    Effects act on the smoothed rate: one that averages would otherwise gain by averaging noise.
    What the smoothing took off is predicted as it was read: the difference of two white noises is
    white. How the body turned between two readings of the triad nobody knows: of a FOG that is read
    more often, its readings next to these are compared.
    """
    recording = of.recording
    samples = recording.sensor(fog)
    there = rate_known(recording, gyro)[samples.rows] & ~np.isnan(samples.values[:, 0])
    read, rates = np.flatnonzero(there), recording.sensor(gyro)
    if len(read):
        known = rates.time[~np.isnan(rates.values).any(axis=1)]
        read = read[np.unique(nearest_rows(samples.time[read], known))]
    rows = samples.rows[read]
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

    return RedundantChannel(
        _channel(of, fog, "a", 0, rows, samples.values[read, 0]), predict, respond
    )


def _norm(of: HandheldRecording, triad: Sensor) -> Iterator[RedundantChannel]:
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
        return np.asarray(np.einsum("nip,ni->pn", push.resting(rows), read / length[:, None]))

    channel = replace(_channel(of, triad, "norm", 0, rows, length), derived=True)
    yield RedundantChannel(channel, predict, respond)


def _long_rests(of: HandheldRecording, triad: Sensor) -> Iterator[RedundantChannel]:
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
) -> RedundantChannel:
    """One axis in one long rest."""

    def predict(state: MotionState) -> Array:
        every = at_rest(triad, of.scenario, of.recording, state.effects, state.force, of.stop)
        predicted = every[rows, column]
        return np.asarray(predicted - predicted.mean())

    def respond(push: SensorPerturbation) -> Array | None:
        if push.sensor != triad:
            return None
        change = push.resting(rows)[:, column].T
        return np.asarray(change - change.mean(axis=1, keepdims=True))

    channel = _channel(of, triad, triad.axes[column], column, rows, values - values.mean())
    return RedundantChannel(replace(channel, derived=True), predict, respond)


def _still_gyro(of: HandheldRecording, gyro: Sensor) -> Iterator[RedundantChannel]:
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
        yield RedundantChannel(_channel(of, gyro, axis, column, rows, values), predict, respond)


def _turns(of: HandheldRecording, gyro: Sensor) -> Iterator[RedundantChannel]:
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
    yield RedundantChannel(
        replace(channel, derived=True, white=_least(of, windows)), predict, respond
    )


def _least(of: HandheldRecording, windows: Windows) -> float:
    """Standard deviation, rad, of a turn's closure by the accelerometer's white noise alone."""
    values = bridged(of.accelerometers[0], of.recording)
    noise = float(np.sqrt(np.mean([robust_white(v) ** 2 for v in values.T])))
    both = np.median((windows.before**2).sum(axis=1) + (windows.after**2).sum(axis=1))
    return noise / of.scenario.site.gravity * float(np.sqrt(both))


# of a plausible delay: a whole one is several samples, and would differ from a lag by what it bends
STEP = 0.01


class HandheldObservations(Observations):
    """Recordings turned by hand."""

    def __init__(
        self, scenario: Scenario, recordings: Sequence[Recording], known: Sequence[Effect]
    ) -> None:
        self.scenario, self.known, self._sources = scenario, tuple(known), tuple(recordings)
        self.recordings = tuple(
            recordings if scenario.sensors("fog") else (condensed(r) for r in recordings)
        )
        numbered = enumerate(self.recordings)
        self._recorded = [HandheldRecording(scenario, r, number) for number, r in numbered]
        self.stops = [of.stop for of in self._recorded]
        self._parts = [part for of in self._recorded for part in parts_of(of)]
        self.channels = tuple(part.channel for part in self._parts)
        self._steps: dict[int, Array] = {}
        self._last: tuple[tuple[Effect, ...] | None, list[Array]] = (None, [])
        self._hands: tuple[tuple[Effect, ...] | None, list[HandheldMotion]] = (None, [])

    @property
    def sources(self) -> tuple[Recording, ...]:
        """The recordings as they came, their rests not averaged."""
        return self._sources

    def predict(self, effects: Sequence[Effect]) -> list[Array]:
        """What each channel should have read. SI, (n,) each."""
        states = [of.state(active_in(effects, of.recording.fingerprint)) for of in self._recorded]
        return [part.predict(states[part.channel.recording]) for part in self._parts]

    def changes(self, effect: Effect, around: Sequence[Effect]) -> Columns:
        """How readings change with a small effect.

        Findings are left out of the operating point: in second order they would lend their shape to
        the calibration terms, of which only some combinations can be seen here.
        """
        names = list(effect.sizes)
        found = self.columns(effect, names, around)
        return {
            i: block.sum(axis=0) for i, (_, block) in found.items() if np.any(block.sum(axis=0))
        }

    def columns(
        self, effect: Effect, names: Sequence[str], around: Sequence[Effect]
    ) -> dict[int, tuple[list[int], Array]]:
        """Change of each channel by each size alone, all at once; only delays are differences of
        predictions. By channel: numbers of the sizes, and the changes, SI, (sizes, n).
        """
        other = self.depends_on(around)
        if isinstance(effect, DelayEffect):
            return self._delayed(effect, names, other) if self.scenario.sensors("fog") else {}
        if (
            not isinstance(effect, SignalEffect)
            or effect.sensor is None
            or not names
            or effect.erased_by_shaking
        ):
            return {}
        found: dict[int, tuple[list[int], Array]] = {}
        pushes: list[SensorPerturbation | None] = [
            hand.push(effect, names)
            if hand.recording.has(self.scenario.named(effect.sensor))
            else None
            for hand in self._hands_under(other)
        ]
        told = [k for k, name in enumerate(names) if name not in effect.frame_convention]
        for i, part in enumerate(self._parts):
            push = pushes[part.channel.recording]
            block = None if push is None else part.respond(push)
            if block is None:
                continue
            some = np.intersect1d(np.flatnonzero(block.any(axis=1)), told)
            if len(some):
                found[i] = ([int(k) for k in some], block[some])
        return found

    def depends_on(self, around: Sequence[Effect]) -> tuple[Effect, ...]:
        """All but what was found."""
        return tuple(e for e in around if e.role != "found")

    def saturating(self, number: int) -> list[Array]:
        """Polynomials of the direction of up for readings at rest, as many as the poses allow. (n,)
        each.

        Without them the scatter from pose to pose, which is physics, would be counted as flicker.
        """
        channel = self.channels[number]
        if channel.axis == "turn" or channel.stop.min() < 0:
            return []
        return direction_polynomials(
            self._recorded[channel.recording].force[channel.rows], channel.stop
        )

    def determines(self, parameters: int) -> bool:
        """Whether lengths at rest are of more directions than there are parameters."""
        if any(c.axis != "norm" for c in self.channels):
            return True
        up: list[Array] = []
        for channel in self.channels:
            recording = self.recordings[channel.recording]
            samples = recording.sensor(self.scenario.named(channel.sensor))
            values = samples.values[np.isin(samples.rows, channel.rows)]
            stops = range(channel.stop.max() + 1)
            here = [channel.stop == k for k in stops]
            up += [values[rows].mean(axis=0) for rows in here if rows.any()]
        directions = int(group_directions(np.array(up)).max()) + 1 if up else 0
        return bool(self.channels) and directions > parameters

    def outlier_signals(
        self, effects: Sequence[Effect], stops: Sequence[Index]
    ) -> Iterator[Signal]:
        """The readings of all sensors; of FOGs at rest only, beyond the rests their misfit. stops:
        rows of each, (m,).
        """
        inside = [inner(r.time, s) for r, s in zip(self.sources, stops, strict=True)]
        fogs = {s.name for s in self.scenario.sensors("fog")}
        for c, r in zip(self.channels, self.residuals(effects), strict=True):
            if c.sensor in fogs:
                turned = ~inside[c.recording][c.rows]
                yield Signal(c.recording, c.sensor, c.axis, c.rows[turned], r[turned])
        for number, recording in enumerate(self.sources):
            for sensor in self.scenario.sensor:
                if not recording.has(sensor):
                    continue
                for axis in sensor.axes:
                    rows, _, values = column_values(recording, sensor, axis)
                    # a hand that moves an accelerometer shakes and knocks it; a FOG shows when
                    if sensor.is_accelerometer or sensor.name in fogs or not fogs:
                        still = inside[number][rows]
                        rows, values = rows[still], values[still]
                    yield Signal(number, sensor.name, axis, rows, values)

    def as_unsteady(self, number: int, residual: Array, mean: Array, fit: NoiseFit) -> NoiseFit:
        """The noise of readings at rest, no less than the difference between rests: wandering
        biases turn with the pose. residual, mean: of the channel, SI, (n,).
        """
        channel = self.channels[number]
        if (channel.derived and channel.axis != "norm") or channel.stop.min() < 0:
            return fit
        if number not in self._steps:
            self._steps[number] = rest_steps(channel.stop)
        return no_less(fit, self._steps[number], residual, mean)

    def _delayed(
        self, effect: Effect, names: Sequence[str], other: tuple[Effect, ...]
    ) -> dict[int, tuple[list[int], Array]]:
        if self._last[0] != other:
            self._last = (other, self.predict(other))
        found: dict[int, tuple[list[int], Array]] = {}
        for k, name in enumerate(names):
            alone = replace(
                effect, values={n: v for n, v in effect.values.items() if n not in names}
            )
            alone = replace(alone, values={**alone.values, name: STEP * effect.values[name]})
            for i, (new, old) in enumerate(
                zip(self.predict([*other, alone]), self._last[1], strict=True)
            ):
                if np.any(new != old):
                    numbers, rows = found.get(i, ([], np.zeros((0, len(old)))))
                    found[i] = ([*numbers, k], np.vstack([rows, (new - old) / STEP]))
        return found

    def _hands_under(self, effects: tuple[Effect, ...]) -> list[HandheldMotion]:
        """The motion of each recording as its sensors say it under these effects."""
        if self._hands[0] != effects:
            met = [(of, active_in(effects, of.recording.fingerprint)) for of in self._recorded]
            self._hands = (effects, [of.motion(own) for of, own in met])
        return self._hands[1]
