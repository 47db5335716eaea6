"""What a small error of one sensor does to all redundant readings of a recording turned by hand.

One pass for all sizes of an effect: what it adds to the reading at the motion that the calibrated
sensors say. Force and rate in the body then change by minus that through the inverse sensor matrix,
and every channel responds linearly.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.effects.base import Effect, SignalEffect, TermEffect
from tiltcal.effects.learned import LearnedReading
from tiltcal.effects.sense import Sense
from tiltcal.forward.gravity_transport import GravityTransport
from tiltcal.forward.nominal_motion import effect_down, one_sided
from tiltcal.laboratory.handheld import dwell_means, earlier, forward, sense_of
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.recording import Recording
from tiltcal.setup.sensor import Sensor

if TYPE_CHECKING:
    from scipy.sparse import csr_array


class SensorPerturbation:
    """What each size of an effect adds to a sensor's reading, SI, and what follows from it.

    Args:
        hand: the motion; sensor: whose.
        felt: along the motion, at all rows, (n, k, p).
        still: at the mean force of each rest and no rate, at the rows ``at``, (m, k, p).
        at: the rows of ``still``.
    """

    def __init__(
        self, hand: "HandheldMotion", sensor: Sensor, felt: Array, still: Array, at: Index
    ) -> None:
        self.hand, self.sensor, self.felt, self.still, self.at = hand, sensor, felt, still, at

    @cached_property
    def motion(self) -> Array:
        """Change of the force or rate that a triad says, (n, 3, p)."""
        inverse = np.linalg.pinv(self.hand.matrices[self.sensor.name])
        return np.asarray(-inverse @ self.felt)

    def resting(self, rows: Index) -> Array:
        """Change of an accelerometer's predicted reading on rows of rests, (m,) -> (m, 3, p): its
        own, and that of up told by it.
        """
        hand = self.hand
        mean = hand.mean[rows][:, :, None]
        length = np.linalg.norm(mean, axis=1, keepdims=True)
        up = mean / np.where(length > 0, length, 1.0)
        moved = self._moved[hand.stop[rows]] / np.where(length > 0, length, 1.0)
        lateral = hand.scenario.site.gravity * (
            moved - up * (up * moved).sum(axis=1, keepdims=True)
        )
        return np.asarray(self.still[rows] + hand.matrices[self.sensor.name] @ lateral)

    @cached_property
    def _moved(self) -> Array:
        """Mean change of the force in each rest, (rests, 3, p)."""
        return self.hand.rest_means(self.motion)

    @cached_property
    def turns(self) -> Array:
        """Change of the closures of turns, (m, 3, p)."""
        assert self.hand.carried is not None
        to_force, to_rate = self.hand.carried.slopes
        return self.hand.carried.answer(
            to_force if self.sensor.is_accelerometer else to_rate, self.motion
        )

    def fog(self, fog: Sensor) -> Array | None:
        """Change of a FOG's prediction, (n, p): by its own errors, or by those of the triad that
        says the rate.
        """
        if self.sensor.name == fog.name:
            return self.felt[:, 0]
        if self.sensor.kind != "gyro" or self.sensor.name not in self.hand.matrices:
            return None
        effects, time = self.hand.effects, self.hand.recording.time
        late = [
            earlier(part, time, effects, fog, self.sensor)
            for part in np.moveaxis(self.motion, 2, 0)
        ]
        scale = 1 + sum(
            e.value("scale_a") for e in effects if e.sensor == fog.name and "scale_a" in e.values
        )
        return scale * np.stack([part @ fog.input_vector for part in late], axis=1)


class HandheldMotion:
    """A recording's motion as its calibrated sensors say it, and how everything redundant answers
    to a push.

    Args:
        scenario: site and sensors.
        recording: turned by hand; stop: number of the rest of each row, -1 while moving, (n,).
        effects: calibration and what is known.
        force, rate: in the body frame, (n, 3).
        matrices: reading per unit of force or rate of each triad by name, (3, 3).
        carried: directions around turns, where there are enough of them.

    Attributes:
        mean: mean force of the rest of each row, 0 while moving, (n, 3).
    """

    def __init__(
        self,
        scenario: Scenario,
        recording: Recording,
        stop: Index,
        effects: Sequence[Effect],
        force: Array,
        rate: Array,
        matrices: Mapping[str, Array],
        carried: GravityTransport | None = None,
    ) -> None:
        self.scenario, self.recording, self.stop, self.effects = scenario, recording, stop, effects
        self.force, self.rate, self.matrices, self.carried = force, rate, matrices, carried
        resting = (stop >= 0) & ~np.isnan(force).any(axis=1)
        count = np.bincount(stop[resting], minlength=int(stop.max(initial=-1)) + 1)
        self._rested, self._count = np.flatnonzero(resting), count
        self.mean = dwell_means(force, stop)
        self._senses: dict[str, tuple[Sense, Sense, Index, Index]] = {}
        self._starts: dict[tuple[str, int], tuple[Array, Array]] = {}
        self._between: dict[str, csr_array] = {}

    def push(self, effect: SignalEffect, names: Sequence[str]) -> SensorPerturbation:
        """What these sizes of an effect, each alone at its value, add to its sensor's reading."""
        sensor = self.scenario.named(str(effect.sensor))
        felt, still, rows, at = self._sensed(sensor)
        starts = self._start(sensor, effect.order)
        sides = [
            _added(effect, names, sense, start)
            for sense, start in zip((felt, still), starts, strict=True)
        ]
        return SensorPerturbation(
            self, sensor, self._everywhere(sensor, sides[0], rows), sides[1], at
        )

    def _everywhere(self, sensor: Sensor, values: Array, rows: Index) -> Array:
        """Values at a sensor's rows interpolated to all, (n, k, p)."""
        if len(rows) == len(self.recording):
            return values
        if sensor.name not in self._between:
            self._between[sensor.name] = between(self.recording.time, rows)
        flat = self._between[sensor.name] @ values.reshape(len(rows), -1)
        return np.asarray(flat).reshape(-1, *values.shape[1:])

    def _sensed(self, sensor: Sensor) -> tuple[Sense, Sense, Index, Index]:
        """What a sensor senses along the motion and in the rests, and the rows of both."""
        if sensor.name not in self._senses:
            rows = self.recording.sensor(sensor).rows
            force, rate = np.where(np.isnan(self.force), 0.0, self.force), self.rate
            # a lever arm by hand is nobody's
            rate = np.zeros_like(rate) if sensor.kind == "accelerometer" else rate
            length = np.linalg.norm(self.mean, axis=1)[:, None]
            g = self.scenario.site.gravity
            full = np.where(length > 0, self.mean * g / np.where(length > 0, length, 1.0), force)
            at = (
                np.arange(len(self.recording))
                if sensor.kind == "accelerometer"
                else rows[self.stop[rows] >= 0]
            )
            mean = full if sensor.kind == "accelerometer" else self.mean
            if sensor.kind == "fog" and (gyro := self._gyro()) is not None:
                rate = earlier(rate, self.recording.time, self.effects, sensor, gyro)
            felt = sense_of(
                sensor, self.scenario, self.recording, force[rows], rate[rows], rows=rows
            )
            still = sense_of(
                sensor, self.scenario, self.recording, mean[at], np.zeros((len(at), 3)), rows=at
            )
            self._senses[sensor.name] = felt, still, rows, at
        return self._senses[sensor.name]

    def _start(self, sensor: Sensor, order: int) -> tuple[Array, Array]:
        """Readings before an effect of this order acts, along the motion and at rest."""
        key = sensor.name, order
        if key not in self._starts:
            earlier_ones = [
                e for e in self.effects if isinstance(e, SignalEffect) and e.order < order
            ]
            felt, still, *_ = self._sensed(sensor)
            self._starts[key] = (
                forward(sensor, earlier_ones, felt),
                forward(sensor, earlier_ones, still),
            )
        return self._starts[key]

    def _gyro(self) -> Sensor | None:
        """The triad that gives the rate; None where a FOG has none beside it."""
        gyros = self.scenario.sensors("gyro")
        return next((s for s in gyros if s.name in self.matrices), None)

    def rest_means(self, values: Array) -> Array:
        """Means over each rest, (n, k, p) -> (rests, k, p); 0 where no force is known."""
        found = np.zeros((len(self._count), *values.shape[1:]))
        if len(order := self._rested):
            numbers = self.stop[order]
            begins = np.flatnonzero(np.diff(numbers, prepend=-1))
            own = numbers[begins]
            total = np.add.reduceat(values[order], begins, axis=0)
            found[own] = total / self._count[own, None, None]
        return found


def between(time: Array, rows: Index) -> "csr_array":
    """What takes values at some rows to all, linearly between them and held beyond, (n, m). time:
    s, (n,); rows: increasing, (m,).
    """
    from scipy.sparse import csr_array

    n = len(time)
    after = np.clip(np.searchsorted(rows, np.arange(n)), 1, max(len(rows) - 1, 1))
    sides = np.stack([after - 1, np.minimum(after, len(rows) - 1)], axis=1)
    left, right = time[rows[sides]].T
    share = np.clip((time - left) / np.maximum(right - left, 1e-300), 0, 1)
    shares = np.stack([1 - share, share], axis=1)
    return csr_array((shares.ravel(), sides.ravel(), 2 * np.arange(n + 1)), (n, len(rows)))


def _added(effect: SignalEffect, names: Sequence[str], sense: Sense, start: Array) -> Array:
    """What each size alone adds to the readings, (n, k, p)."""
    found = np.zeros((*start.shape, len(names)))
    if isinstance(effect, LearnedReading):
        sizes = np.array([effect.values[name] for name in names])
        found[:, effect.channel(sense)] = (
            effect.columns(sense)[:, [int(name[1:]) for name in names]] * sizes
        )
        return found
    for j, name in enumerate(names):
        if isinstance(effect, TermEffect):
            channel, column = effect.term(name, sense)
            if channel >= 0:
                found[:, channel, j] = effect.values[name] * column
            continue
        alone = replace(
            effect, values={n: v for n, v in effect.values.items() if n not in names or n == name}
        )
        up = np.nan_to_num(alone.apply(start.copy(), sense, None) - start)
        if not one_sided(alone):
            up = (
                up - np.nan_to_num(effect_down(alone).apply(start.copy(), sense, None) - start)
            ) / 2
        found[:, :, j] = up
    return found
