"""One recording turned by hand: its rests, and what its own sensors say of its motion.

Rests of a recording turned by hand: which rows are at rest, and a long log with its rests
averaged.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np

from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.diagnosis.data.sensor_perturbation import HandheldMotion
from tiltcal.effects.base import Effect
from tiltcal.forward.gravity_transport import EDGE, GravityTransport, Windows, turns_between
from tiltcal.laboratory.handheld import inverted, sensor_matrix, whole
from tiltcal.laboratory.scenario import Scenario
from tiltcal.laboratory.smoothing import bridged, independent_readings, quiet_readings, stops_of
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.static_poses import group_directions
from tiltcal.setup.sensor import Sensor
from tiltcal.statistics.cosine_transform import cosines
from tiltcal.statistics.dwell_noise import MAD_TO_SIGMA
from tiltcal.statistics.least_squares import column_space
from tiltcal.statistics.noise_spectrum import NoiseFit

REST = "rest"  # extra column of an averaged log
KEPT_AT_REST = 6000  # rows: a longer log is averaged in its rests
DISTURBANCE_SIGMA = 7.0  # sigma off the rest's median: somebody touched it
POSES_EACH = 0.5  # polynomials of the direction, at most, of each direction that was taken
SHORT = 20.0  # s, of a rest
LEAST_FREE = 6.0  # rests beyond the terms that may tell them apart
BRIEF = 0.1  # share of a rest: what lasts longer is no nudge, but something to explain


def rests_of(stop: Index) -> Iterator[Index]:
    """Rows of each rest. stop: number of the rest at each row, -1 between them, (n,)."""
    for k in range(int(stop.max(initial=-1)) + 1):
        rows = np.flatnonzero(stop == k)
        if len(rows):
            yield rows


def inner(time: Array, stop: Index) -> Mask:
    """Rows of rests without their edges, where the hand has not settled or begins to move, (n,).
    time: s.
    """
    found = np.zeros(len(time), bool)
    for rows in rests_of(stop):
        edge = min(EDGE, (time[rows[-1]] - time[rows[0]]) / 4)
        found[rows] = (time[rows] >= time[rows[0]] + edge) & (time[rows] <= time[rows[-1]] - edge)
    return found


def undisturbed(rows: Mask, stop: Index, time: Array, values: Array) -> Mask:
    """Those rows without disturbances: values, (n, k), briefly far from the median of their rest. A
    short rest is left out with them. time: s.
    """
    found = rows.copy()
    for rest in rests_of(np.where(rows, stop, -1)):
        off = np.abs(values[rest] - np.nanmedian(values[rest], axis=0))
        spread = MAD_TO_SIGMA * np.nanmedian(off, axis=0)
        far = (
            np.nan_to_num(off > DISTURBANCE_SIGMA * spread).any(axis=1)
            if (spread > 0).all()
            else np.zeros(len(rest), bool)
        )
        touched = np.convolve(far, np.ones(3), "same") > 0
        if touched.mean() < BRIEF:
            short = bool(touched.any()) and time[rest[-1]] - time[rest[0]] < SHORT
            found[rest if short else rest[touched]] = False
    return found


def direction_polynomials(force: Array, stop: Index) -> list[Array]:
    """Polynomials of the mean direction of the force in each rest, as many as the directions taken
    allow, (n,) each.
    """
    starts = np.flatnonzero(np.diff(stop, prepend=-1))
    counts = np.diff(starts, append=len(force))
    up = np.add.reduceat(force, starts, axis=0) / counts[:, None]
    up /= np.linalg.norm(up, axis=1)[:, None]
    allowed = POSES_EACH * (int(group_directions(up).max()) + 1)
    degree = max((d for d in range(4) if (d + 1) ** 2 <= allowed), default=0)
    which = np.repeat(np.arange(len(starts)), counts)
    powers = [p for p in product(range(degree + 1), repeat=3) if 0 < sum(p) <= degree and p[2] < 2]
    return [np.prod(up ** np.array(p), axis=1)[which] for p in powers]


def rest_steps(stop: Index) -> Array:
    """The operators of the step of the mean from each rest to the next, on cosine coefficients, (m
    - 1, n). stop: number of the rest at each row, (n,); each operator is (m - 1, n).
    """
    rows = list(rests_of(stop))
    operators = np.zeros((len(rows), len(stop)))
    for k, rest in enumerate(rows):
        operators[k, rest] = 1 / len(rest)
    return cosines(np.diff(operators, axis=0))


def no_less(fit: NoiseFit, steps: Array, residual: Array, mean: Array) -> NoiseFit:
    """A noise with as much flicker as the difference between rests requires, should that be more
    than the spectrum says.

    A wandering bias appears with another sign and share in each pose. From rest to rest that is no
    flicker of a channel's rows, and their spectrum, with few coefficients that slow, hardly shows
    it.

    Args:
        fit: white, flicker and walk as the spectrum of all rows has them.
        steps: operators of the step from each rest to the next on cosine coefficients, (m, n).
        residual: SI, (n,).
        mean: cosine coefficients of what may be in it at any size, (n, p).
    """
    model, n = fit.model, len(residual)
    Q = column_space(steps @ mean)
    free = 1 - (Q * Q).sum(axis=1)
    if free.sum() < LEAST_FREE:
        return fit
    apart = steps @ cosines(residual)
    apart = apart - Q @ (Q.T @ apart)
    power = steps**2
    expected = float(free @ (power @ model.spectrum(n)))
    missing = float(apart @ apart) - expected
    if missing <= 0:
        return fit
    return replace(fit, model=model.with_excess(free @ power, missing))


def known_stops(recording: Recording) -> Index:
    """Number of the rest of each row, -1 while moving, (n,): as found, or as kept when a log was
    averaged.
    """
    kept = recording.extra.get(REST)
    return stops_of(recording) if kept is None else np.asarray(kept, dtype=np.intp)


def condensed(recording: Recording) -> Recording:
    """A long log with its rests averaged over short blocks, and their numbers beside them; what is
    between them is left alone.
    """
    stop = known_stops(recording)
    resting = int((stop >= 0).sum())
    block = -(-resting // KEPT_AT_REST)
    if block < 2 or REST in recording.extra:
        return recording
    group = np.arange(len(recording))
    edge = int(EDGE / np.median(np.diff(recording.time)))
    for rows in rests_of(stop):
        middle = rows[edge : len(rows) - edge]  # the edges are needed sample by sample
        group[middle] = (
            middle[0] + (np.arange(len(middle)) // block) * block if len(middle) else middle
        )
    _, which, count = np.unique(group, return_inverse=True, return_counts=True)
    columns = {n: _averaged(recording.column(n), which, len(count)) for n in recording.column_names}
    time = np.bincount(which, recording.time) / count
    first = np.concatenate([[0], np.flatnonzero(np.diff(which)) + 1])
    rests = np.array([str(k) for k in stop[first]])
    return Recording.from_columns(
        time,
        columns,
        extra={REST: rests},
        metadata=recording.metadata,
        source=recording.source,
        origin=recording.fingerprint,
    )


def _averaged(values: Array, which: Index, n: int) -> Array:
    """Mean of what was sampled in each group, (n,); NaN where nothing was."""
    there = ~np.isnan(values)
    count = np.bincount(which[there], minlength=n)
    total = np.bincount(which[there], values[there], n)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


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
        calibration = [e for e in effects if e.role == "calibration"]
        matrices = {s.name: sensor_matrix(s, calibration) for s in triads}
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
