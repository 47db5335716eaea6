"""One recording turned by hand: its rests, and what its own sensors say of its motion."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.diagnosis.data.handheld_rests import inner, known_stops, undisturbed
from tiltcal.diagnosis.data.sensor_matrix import sensor_matrix
from tiltcal.diagnosis.data.sensor_perturbation import HandheldMotion
from tiltcal.effects.base import Effect
from tiltcal.forward.gravity_transport import GravityTransport, Windows, turns_between
from tiltcal.laboratory.handheld import inverted, whole
from tiltcal.laboratory.scenario import Scenario
from tiltcal.laboratory.smoothing import bridged, independent_readings, quiet_readings
from tiltcal.recordings.recording import Recording
from tiltcal.setup.sensor import Sensor

FEW = 12  # turns: fewer are no channel


@dataclass(frozen=True)
class MotionState:
    """What a recording's sensors say of its motion under some effects: force m/s2 and rate rad/s
    in the body, (n, 3).
    """

    effects: Sequence[Effect]
    force: Array
    rate: Array


@dataclass(frozen=True)
class HandheldRecording:
    """A recording turned by hand.

    Args:
        scenario: its sensors; recording: its rows; number: among the recordings.
    """

    scenario: Scenario
    recording: Recording
    number: int

    @cached_property
    def stop(self) -> Index:
        """Number of the rest of each row, -1 while moving, (n,)."""
        return known_stops(self.recording)

    @cached_property
    def accelerometers(self) -> list[Sensor]:
        """The accelerometer triad, if there is one."""
        return self._triads("accelerometer")

    @cached_property
    def gyros(self) -> list[Sensor]:
        """The gyro triad, if there is one."""
        return self._triads("gyro")

    def _triads(self, kind: str) -> list[Sensor]:
        sensors = self.scenario.sensors(kind)
        return [s for s in sensors if self.recording.has(s) and len(s.axes) == 3][:1]

    @cached_property
    def readings(self) -> dict[str, Array]:
        """Readings of the triads that the motion is taken from; they depend on no effect. By triad,
        SI, (n, 3).

        What a FOG is compared with sample by sample is without most of its noise. What is
        integrated needs no smoothing, and a hand that trembles at the edge of a rest does turn it.
        """
        smooth, found = bool(self.scenario.sensors("fog")), {}
        for s in (*self.accelerometers, *self.gyros):
            rough = not smooth
            found[s.name] = (
                bridged(s, self.recording)
                if rough
                else quiet_readings(s, self.recording, self.stop)
            )
        return found

    @cached_property
    def force(self) -> Array:
        """What the accelerometer triad read, whole, at all rows, (n, 3)."""
        for triad in self.accelerometers:
            return whole(self.recording, triad, bridged(triad, self.recording))
        return np.zeros((len(self.recording), 3))

    @cached_property
    def calm(self) -> Mask:
        """Rows well inside the rests, while nobody touched it, (n,)."""
        recording = self.recording
        read = [np.linalg.norm(self.force, axis=1, keepdims=True)]
        read += [whole(recording, gyro, bridged(gyro, recording)) for gyro in self.gyros]
        still = inner(recording.time, self.stop)
        return undisturbed(still, self.stop, recording.time, np.hstack(read))

    @cached_property
    def windows(self) -> Windows | None:
        """The windows of the turns, where a gyro triad carries gravity across enough of them."""
        spans = turns_between(self.recording.time, self.stop)
        if not self.accelerometers or not self.gyros or len(spans) < FEW:
            return None
        if np.isnan(self.readings[self.gyros[0].name]).any():
            return None
        return Windows.around(self.recording.time, spans)

    @cached_property
    def independent(self) -> dict[str, Array]:
        """Readings of the triads by which a FOG's errors change, each sample told by the others. By
        triad, SI, (n, 3).
        """
        if not self.scenario.sensors("fog"):
            return self.readings
        triads = (*self.accelerometers, *self.gyros)
        return {s.name: independent_readings(s, self.recording, self.stop) for s in triads}

    def state(self, effects: Sequence[Effect]) -> MotionState:
        """The motion under some effects."""
        return self._state(effects, self.readings)

    def _state(self, effects: Sequence[Effect], readings: Mapping[str, Array]) -> MotionState:
        n = len(self.recording)
        force, rate = np.full((n, 3), np.nan), np.zeros((n, 3))
        for triad in self.accelerometers:
            force = self._inverted(triad, effects, None, readings)
        for gyro in self.gyros:
            rate = self._inverted(gyro, effects, force, readings)
        return MotionState(effects, force, rate)

    def _inverted(
        self,
        triad: Sensor,
        effects: Sequence[Effect],
        force: Array | None,
        readings: Mapping[str, Array],
    ) -> Array:
        read = readings[triad.name]
        inputs = inverted(triad, self.scenario, self.recording, effects, force, read)
        return whole(self.recording, triad, inputs)

    def motion(self, effects: Sequence[Effect]) -> HandheldMotion:
        """The motion under some effects, and what small errors of a sensor do to it."""
        state, windows = self.state(effects), self.windows
        triads = (*self.accelerometers, *self.gyros)
        matrices = {s.name: sensor_matrix(s.name, self.scenario, effects) for s in triads}
        carried = None if windows is None else GravityTransport(windows, state.force, state.rate)
        return HandheldMotion(
            self.scenario,
            self.recording,
            self.stop,
            effects,
            state.force,
            self._state(effects, self.independent).rate,
            matrices,
            carried,
        )
