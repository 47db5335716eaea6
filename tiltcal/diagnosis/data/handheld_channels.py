"""Recordings turned by hand, without any angle readout: only what is redundant in them has a model.

A FOG against the gyro triad; at rest the length of the accelerometer's reading, the gyro's reading
against the force, and,
in a long rest, how each accelerometer axis wanders; gravity's direction after a turn, carried there
by the gyro.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.diagnosis.data.channels import column_values
from tiltcal.diagnosis.data.handheld_rests import (
    condensed,
    direction_polynomials,
    inner,
    known_stops,
    no_less,
    rest_steps,
    undisturbed,
)
from tiltcal.diagnosis.data.observations import Channel, Columns, Observations, Signal
from tiltcal.diagnosis.data.sensor_matrix import sensor_matrix
from tiltcal.diagnosis.data.sensor_perturbation import HandheldMotion, SensorPerturbation
from tiltcal.effects.base import DelayEffect, Effect, SignalEffect
from tiltcal.effects.events import as_met
from tiltcal.forward.gravity_transport import GravityTransport, Windows, turns_between
from tiltcal.laboratory.handheld import (
    at_rest,
    bridged,
    dwell_means,
    earlier,
    forward,
    inverted,
    quiet_readings,
    rate_known,
    sense_of,
    whole,
)
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.static_poses import group_directions
from tiltcal.setup.setup import Sensor
from tiltcal.statistics.noise_spectrum import NoiseFit, robust_white

FEW = 12  # turns: fewer are no channel
# of a plausible delay: a whole one is several samples, and would differ from a lag by what it bends
STEP = 0.01
LONG = 60.0  # s: a rest that long tells drifts from noise
Predictor = Callable[["_State"], Array]
Answer = Callable[[SensorPerturbation], Array | None]
"""Change of a channel by each size of a push, (p, n); None where it does not see that sensor."""
Part = tuple[Channel, Predictor, Answer]


@dataclass(frozen=True)
class _State:
    """What a recording's own sensors say of its motion, under some effects: force m/s2 and rate
    rad/s in the body, (n, 3).
    """

    effects: Sequence[Effect]
    force: Array
    rate: Array


class HandheldObservations(Observations):
    """Recordings turned by hand."""

    def __init__(
        self, scenario: Scenario, recordings: Sequence[Recording], known: Sequence[Effect]
    ) -> None:
        self.scenario, self.known, self._sources = scenario, tuple(known), tuple(recordings)
        self.recordings = tuple(
            recordings if scenario.sensors("fog") else (condensed(r) for r in recordings)
        )
        self.stops = [known_stops(r) for r in self.recordings]
        self._quiet = [self._readings(number) for number in range(len(recordings))]
        self._read = [self._forces(number) for number in range(len(recordings))]
        self._calm = [self._calm_rows(number) for number in range(len(recordings))]
        self._windows = [self._turn_windows(number) for number in range(len(recordings))]
        parts = [part for number in range(len(recordings)) for part in self._parts(number)]
        self.channels = tuple(channel for channel, _, _ in parts)
        self._predictors = tuple(predictor for _, predictor, _ in parts)
        self._answers = tuple(answer for _, _, answer in parts)
        self._steps: dict[int, Array] = {}
        self._last: tuple[tuple[Effect, ...] | None, list[Array]] = (None, [])
        self._hands: tuple[tuple[Effect, ...] | None, list[HandheldMotion]] = (None, [])

    @property
    def sources(self) -> tuple[Recording, ...]:
        """The recordings as they came, their rests not averaged."""
        return self._sources

    def predict(self, effects: Sequence[Effect]) -> list[Array]:
        """What each channel should have read."""
        states = [
            self._state(k, as_met(effects, r.fingerprint)) for k, r in enumerate(self.recordings)
        ]
        return [
            predictor(states[channel.recording])
            for channel, predictor in zip(self.channels, self._predictors, strict=True)
        ]

    def changes(self, effect: Effect, around: Sequence[Effect]) -> Columns:
        """How readings change with a small effect.

        What was found is left out of the others: in second order it would lend its shape to the
            calibration terms, of which
        only some combinations can be seen here.
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
        predictions.
        """
        other = tuple(e for e in around if e.role != "found")
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
        for i, (channel, answer) in enumerate(zip(self.channels, self._answers, strict=True)):
            push = pushes[channel.recording]
            block = None if push is None else answer(push)
            told = [k for k, name in enumerate(names) if name not in effect.frame_convention]
            if block is not None and len(
                some := np.intersect1d(np.flatnonzero(block.any(axis=1)), told)
            ):
                found[i] = ([int(k) for k in some], block[some])
        return found

    def saturating(self, number: int) -> list[Array]:
        """Of what is read at rest, polynomials of the direction of up, as far as there are poses
        for them.

        Else the scatter from pose to pose, which is physics, makes a flicker that hides it.
        """
        channel = self.channels[number]
        if channel.axis == "turn" or channel.stop.min() < 0:
            return []
        return direction_polynomials(self._read[channel.recording][channel.rows], channel.stop)

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
        """The misfit of FOGs, and the readings of all other sensors."""
        for c, r in zip(self.channels, self.residuals(effects), strict=True):
            if self.scenario.named(c.sensor).kind == "fog":
                yield Signal(c.recording, c.sensor, c.axis, c.rows, r)
        predicted = {s.name for s in self.scenario.sensors("fog")}
        for number, recording in enumerate(self.sources):
            for sensor in self.scenario.sensor:
                if not recording.has(sensor) or sensor.name in predicted:
                    continue
                for axis in sensor.axes:
                    rows, _, values = column_values(recording, sensor, axis)
                    # a hand that moves an accelerometer shakes and knocks it; a FOG shows when
                    if sensor.is_accelerometer or not predicted:
                        still = inner(recording.time, stops[number])[rows]
                        rows, values = rows[still], values[still]
                    yield Signal(number, sensor.name, axis, rows, values)

    def as_unsteady(self, number: int, residual: Array, mean: Array, fit: NoiseFit) -> NoiseFit:
        """The noise of what is read at rest, no less than the rests are apart: biases that wander
        turn with the pose.
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
            self._hands = (
                effects,
                [
                    self._hand(k, as_met(effects, r.fingerprint))
                    for k, r in enumerate(self.recordings)
                ],
            )
        return self._hands[1]

    def _hand(self, number: int, effects: Sequence[Effect]) -> HandheldMotion:
        recording, windows, state = (
            self.recordings[number],
            self._windows[number],
            self._state(number, effects),
        )
        triads = [*self._triads(recording, "accelerometer"), *self._triads(recording, "gyro")]
        matrices = {s.name: sensor_matrix(s.name, self.scenario, effects) for s in triads}
        carried = None if windows is None else GravityTransport(windows, state.force, state.rate)
        return HandheldMotion(
            self.scenario,
            recording,
            self.stops[number],
            effects,
            state.force,
            state.rate,
            matrices,
            carried,
        )

    def _turn_windows(self, number: int) -> Windows | None:
        """The windows of the turns of a recording whose gyro triad carries gravity across enough of
        them.
        """
        recording, quiet = self.recordings[number], self._quiet[number]
        gyros = self._triads(recording, "gyro")
        spans = turns_between(recording.time, self.stops[number])
        if (
            not self._triads(recording, "accelerometer")
            or not gyros
            or len(spans) < FEW
            or np.isnan(quiet[gyros[0].name]).any()
        ):
            return None
        return Windows.around(recording.time, spans)

    def _triads(self, recording: Recording, kind: str) -> list[Sensor]:
        return [s for s in self.scenario.sensors(kind) if recording.has(s) and len(s.axes) == 3][:1]

    def _readings(self, number: int) -> dict[str, Array]:
        """Readings of the triads that the motion is taken from; they do not depend on any effect.

        What a FOG is compared with sample by sample is without most of its noise; what is
        integrated needs no smoothing, and
        a hand that trembles at the edge of a rest does turn it.
        """
        recording, fog = self.recordings[number], self.scenario.sensors("fog")
        triads = [*self._triads(recording, "accelerometer"), *self._triads(recording, "gyro")]
        return {
            s.name: quiet_readings(s, recording, self.stops[number])
            if fog
            else bridged(s, recording)
            for s in triads
        }

    def _calm_rows(self, number: int) -> Mask:
        """Rows well inside the rests, while nobody touched it."""
        recording, stop = self.recordings[number], self.stops[number]
        read = [np.linalg.norm(self._read[number], axis=1, keepdims=True)]
        read += [
            whole(recording, gyro, bridged(gyro, recording))
            for gyro in self._triads(recording, "gyro")
        ]
        return undisturbed(inner(recording.time, stop), stop, recording.time, np.hstack(read))

    def _forces(self, number: int) -> Array:
        """What the accelerometer triad read, whole, at all rows, (n, 3)."""
        recording = self.recordings[number]
        for triad in self._triads(recording, "accelerometer"):
            return whole(recording, triad, bridged(triad, recording))
        return np.zeros((len(recording), 3))

    def _state(self, number: int, effects: Sequence[Effect]) -> _State:
        recording, quiet = self.recordings[number], self._quiet[number]
        n = len(recording)
        force, rate = np.full((n, 3), np.nan), np.zeros((n, 3))
        for triad in self._triads(recording, "accelerometer"):
            force = whole(
                recording,
                triad,
                inverted(triad, self.scenario, recording, effects, None, quiet[triad.name]),
            )
        for gyro in self._triads(recording, "gyro"):
            rate = whole(
                recording,
                gyro,
                inverted(gyro, self.scenario, recording, effects, force, quiet[gyro.name]),
            )
        return _State(effects, force, rate)

    def _parts(self, number: int) -> Iterator[Part]:
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

    def _channel(
        self, number: int, sensor: Sensor, axis: str, column: int, rows: Index, values: Array
    ) -> Channel:
        recording = self.recordings[number]
        return Channel(
            number,
            sensor.name,
            axis,
            column,
            rows,
            recording.time[rows],
            values,
            self.stops[number][rows],
        )

    def _fog(self, number: int, fog: Sensor, gyro: Sensor) -> Part:
        """A FOG against the gyro triad.

        Effects act on the smoothed rate, else one that averages would gain by averaging noise; what
        the smoothing took off is
        predicted as it was read: the difference of two white noises is white.
        """
        recording = self.recordings[number]
        samples = recording.sensor(fog)
        there = rate_known(recording, gyro)[samples.rows] & ~np.isnan(samples.values[:, 0])
        rows = samples.rows[there]
        rough = (
            whole(recording, gyro, bridged(gyro, recording) - self._quiet[number][gyro.name])[rows]
            @ fog.input_vector
        )

        def predict(state: _State) -> Array:
            force = np.where(np.isnan(state.force), 0.0, state.force)
            rate = earlier(state.rate, recording.time, state.effects, fog, gyro)
            return (
                forward(fog, state.effects, sense_of(fog, self.scenario, recording, force, rate))[
                    rows, 0
                ]
                + rough
            )

        def answer(push: SensorPerturbation) -> Array | None:
            change = push.fog(fog)
            return None if change is None else change[rows].T

        return self._channel(number, fog, "a", 0, rows, samples.values[there, 0]), predict, answer

    def _norm(self, number: int, triad: Sensor) -> Iterator[Part]:
        recording, stop = self.recordings[number], self.stops[number]
        samples = recording.sensor(triad)
        there = self._calm[number][samples.rows] & ~np.isnan(samples.values).any(axis=1)
        rows, read = samples.rows[there], samples.values[there]
        if len(rows) < 16:
            return
        length = np.linalg.norm(read, axis=1)

        def predict(state: _State) -> Array:
            predicted = at_rest(triad, self.scenario, recording, state.effects, state.force, stop)[
                rows
            ]
            return np.asarray(
                (predicted * read).sum(axis=1) / length
            )  # it differs from the reading along it only

        def answer(push: SensorPerturbation) -> Array | None:
            return (
                np.einsum("nip,ni->pn", push.resting[rows], read / length[:, None])
                if push.sensor == triad
                else None
            )

        yield (
            replace(self._channel(number, triad, "norm", 0, rows, length), derived=True),
            predict,
            answer,
        )

    def _long_rests(self, number: int, triad: Sensor) -> Iterator[Part]:
        """Each axis in rests of a minute and more, without its mean: the attitude is unknown, but
        it stays.
        """
        recording, stop = self.recordings[number], self.stops[number]
        samples = recording.sensor(triad)
        for k in range(int(stop.max(initial=-1)) + 1):
            there = (stop[samples.rows] == k) & ~np.isnan(samples.values).any(axis=1)
            rows = samples.rows[there]
            if len(rows) < 64 or (
                recording.time[rows[-1]] - recording.time[rows[0]] < LONG and there.mean() < 0.9
            ):
                continue
            for column, axis in enumerate(triad.axes):
                values = samples.values[there, column]

                def predict(state: _State, rows: Index = rows, column: int = column) -> Array:
                    predicted = at_rest(
                        triad, self.scenario, recording, state.effects, state.force, stop
                    )[rows, column]
                    return np.asarray(predicted - predicted.mean())

                def answer(
                    push: SensorPerturbation, rows: Index = rows, column: int = column
                ) -> Array | None:
                    if push.sensor != triad:
                        return None
                    change = push.resting[rows, column].T
                    return np.asarray(change - change.mean(axis=1, keepdims=True))

                channel = self._channel(number, triad, axis, column, rows, values - values.mean())
                yield replace(channel, derived=True), predict, answer

    def _still_gyro(self, number: int, gyro: Sensor) -> Iterator[Part]:
        """The gyro at rest: its bias, and what the force does to it. The Earth's rate is part of
        it: the heading is unknown.
        """
        recording, stop = self.recordings[number], self.stops[number]
        samples = recording.sensor(gyro)
        there = self._calm[number][samples.rows] & ~np.isnan(samples.values).any(axis=1)
        rows = samples.rows[there]
        if len(rows) < 64:
            return
        kept: dict[str, tuple[_State, Array]] = {}

        def still(state: _State) -> Array:
            if (
                "last" not in kept or kept["last"][0] is not state
            ):  # three channels ask for the same readings
                force = dwell_means(state.force, stop)
                sense = sense_of(
                    gyro, self.scenario, recording, force[rows], np.zeros((len(rows), 3)), rows=rows
                )
                kept["last"] = (state, forward(gyro, state.effects, sense))
            return kept["last"][1]

        for column, axis in enumerate(gyro.axes):

            def predict(state: _State, column: int = column) -> Array:
                return still(state)[:, column]

            def answer(push: SensorPerturbation, column: int = column) -> Array | None:
                return (
                    push.still[np.searchsorted(push.at, rows), column].T
                    if push.sensor == gyro
                    else None
                )

            yield (
                self._channel(number, gyro, axis, column, rows, samples.values[there, column]),
                predict,
                answer,
            )

    def _turns(self, number: int, gyro: Sensor) -> Iterator[Part]:
        """Gravity's direction after each turn minus the one carried there by the gyro, rad: three
        components a turn, in turn.

        One channel of all three: few turns have to tell their noise beside many terms.
        """
        windows = self._windows[number]
        if windows is None:
            return
        rows = np.repeat(windows.middle, 3)

        def predict(state: _State) -> Array:
            return -GravityTransport(windows, state.force, state.rate).errors.ravel()

        def answer(push: SensorPerturbation) -> Array | None:
            return (
                None
                if push.sensor.kind == "fog"
                else -push.turns.reshape(-1, push.turns.shape[2]).T
            )

        channel = self._channel(number, gyro, "turn", 0, rows, np.zeros(len(rows)))
        triad = self._triads(self.recordings[number], "accelerometer")[0]
        yield (
            replace(channel, derived=True, white=self._least(number, triad, windows)),
            predict,
            answer,
        )

    def _least(self, number: int, triad: Sensor, windows: Windows) -> float:
        """Standard deviation, rad, of a turn's closure by the accelerometer's white noise alone: it
        cannot be less.
        """
        values = bridged(triad, self.recordings[number])
        noise = float(np.sqrt(np.mean([robust_white(v) ** 2 for v in values.T])))
        both = np.median((windows.before**2).sum(axis=1) + (windows.after**2).sum(axis=1))
        return noise / self.scenario.site.gravity * float(np.sqrt(both))
