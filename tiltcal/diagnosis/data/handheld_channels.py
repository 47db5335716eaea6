"""Recordings turned by hand, without any angle readout: only redundant readings have a model."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.diagnosis.data.channels import column_values
from tiltcal.diagnosis.data.handheld_parts import parts_of
from tiltcal.diagnosis.data.handheld_recording import HandheldRecording
from tiltcal.diagnosis.data.handheld_rests import (
    condensed,
    direction_polynomials,
    inner,
    no_less,
    rest_steps,
)
from tiltcal.diagnosis.data.observations import Columns, Observations, Signal
from tiltcal.diagnosis.data.sensor_perturbation import HandheldMotion, SensorPerturbation
from tiltcal.effects.base import DelayEffect, Effect, SignalEffect
from tiltcal.effects.events import as_met
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.static_poses import group_directions
from tiltcal.statistics.noise_spectrum import NoiseFit

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
        states = [of.state(as_met(effects, of.recording.fingerprint)) for of in self._recorded]
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
            met = [(of, as_met(effects, of.recording.fingerprint)) for of in self._recorded]
            self._hands = (effects, [of.motion(own) for of, own in met])
        return self._hands[1]
