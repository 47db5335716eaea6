"""The chain of errors of one sensor, step by step, in the order of ``forward.signal_chain``, with
what the sensor was exposed to in the last steps and between them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from math import prod

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import tilt_of_force
from tiltcal.effects.base import DelayEffect, Effect, SignalEffect
from tiltcal.effects.sense import Sense
from tiltcal.effects.stepwise import Rows, StepEffect, Stepping
from tiltcal.forward.signal_chain import CONVERSION, stream
from tiltcal.laboratory.scenario import Scenario
from tiltcal.setup.sensor import Sensor

NODES = 4  # steps through which what is between them is interpolated: a cubic
WHOLE = 1e-6  # of a step: a delay so near to a whole number of steps is one


class History:
    """The inputs of the last steps of many environments.

    Args:
        longest: delay that is asked for, steps.
        rows: environments.
        width: numbers of an input.
    """

    def __init__(self, longest: float, rows: int, width: int) -> None:
        self.length = int(np.ceil(longest)) + NODES
        # the newest first, in a window that moves down; twice as long, so that it is whole
        self.inputs = np.zeros((2 * self.length, rows, width))
        self.at = 0
        self._asked: dict[float, Array] = {}

    def add(self, values: Array, begun: Index) -> None:
        """The inputs of a step, (rows, width); environments that have ``begun`` were always there:
        they stood still before.
        """
        self.at = (self.at or self.length) - 1
        self.inputs[self.at] = self.inputs[self.at + self.length] = values
        if len(begun):
            self.inputs[:, begun] = values[begun]
        self._asked.clear()

    def before(self, steps: float, rows: Rows) -> Array:
        """The inputs some steps ago, not before the first, (n, width)."""
        if steps not in self._asked:  # sensors that are alike late ask for the same
            self._asked[steps] = self._ago(steps)
        return self._asked[steps][rows]

    def _ago(self, steps: float) -> Array:
        """The inputs of all environments some steps ago, (rows, width)."""
        whole = round(steps)
        if abs(steps - whole) < WHOLE:
            return np.asarray(self.inputs[self.at + whole])
        first, weights = nodes_about(steps)
        nodes = self.inputs[self.at + first : self.at + first + NODES]
        return np.asarray((weights @ nodes.reshape(NODES, -1)).reshape(nodes.shape[1:]))


@cache
def nodes_about(steps: float) -> tuple[int, Array]:
    """The first of the steps ago through which a cubic gives what was between them, and the weights
    of all, (NODES,).
    """
    first = max(int(np.floor(steps)) - 1, 0)  # the step after it, where there is one, counts
    nodes = range(first, first + NODES)
    weights = (prod((steps - m) / (n - m) for m in nodes if m != n) for n in nodes)
    return first, np.array([*weights])


INPUT = 9  # numbers of an input: force, rate, angular acceleration


@dataclass(frozen=True)
class Surroundings:
    """What every sensor of an instrument shares.

    Args:
        scenario: site and climate.
        step_s: between samples of the motion, s.
    """

    scenario: Scenario
    step_s: float

    def warmth(self, elapsed: Array) -> Array:
        """Temperature minus T0, K, (n,). elapsed: s, (n,)."""
        if self._steady is not None:
            return _same(self._steady, len(elapsed))
        return self.scenario.climate.at(elapsed) - self._reference

    @cached_property
    def _steady(self) -> float | None:
        """Temperature minus T0 where it never changes, K."""
        climate = self.scenario.climate
        still = not (climate.ramp_degC_h or climate.swing_degC or climate.change_degC)
        return float(climate.at(np.zeros(1))[0] - self._reference) if still else None

    @cached_property
    def _reference(self) -> float:
        """T0, degC: where it is not stated the mean over the scenario's own sequence, if any."""
        start, end = self.scenario.schedule.times if self.scenario.sequence else (0.0, 0.0)
        return self.scenario.climate.reference(end - start)


@cache
def _same(value: float, n: int) -> Array:
    """A number for each row, (n,)."""
    found = np.full(n, value)
    found.flags.writeable = False
    return found


@cache
def _nowhere(n: int) -> Array:
    """Directions that are not known, (n, 3)."""
    found = np.full((n, 3), np.nan)
    found.flags.writeable = False
    return found


class SensorChain:
    """One sensor on many environments.

    Args:
        sensor: of the scenario.
        around: what it shares with the others.
        effects: that act on it.
        rows: environments.
        seed: of the first environment, the next ones have the next numbers; None: without random
            effects and quantisation.

    Raises:
        TiltcalError: an effect cannot act step by step.
    """

    def __init__(
        self,
        sensor: Sensor,
        around: Surroundings,
        effects: Sequence[Effect],
        rows: int,
        seed: int | None,
    ) -> None:
        require_stepwise(sensor, around.step_s)
        self.sensor, self.around, self.rows = sensor, around, rows
        self.every = round(1 / (sensor.rate_hz * around.step_s))
        mine = [e for e in effects if e.sensor == sensor.name or _everywhere(e)]
        signal = sorted((e for e in mine if isinstance(e, SignalEffect)), key=lambda e: e.order)
        used = [e for e in signal if seed is not None or not e.random]
        first = [e for e in used if not e.random and e.order < CONVERSION]
        self.after = [self._stepped(e, seed) for e in used if e not in first]
        delays = _delays(sensor, [e for e in mine if isinstance(e, DelayEffect)])
        self.before = {
            delay: (
                np.flatnonzero(np.array(delays) == delay),
                [self._stepped(e, seed) for e in first],
            )
            for delay in dict.fromkeys(delays)
        }
        self.deterministic = [e for e in signal if not e.random]
        self.readings = np.full((rows, len(sensor.axes)), np.nan)
        self._fixed = (
            sensor.axis_indices,
            sensor.kind,
            sensor.input_vector if sensor.kind == "fog" else np.zeros(3),
            around.scenario.site.gravity,
            sensor.rate_hz,
            sensor.full_scale,
        )

    def sense(self, inputs: Array, elapsed: Array) -> Sense:
        """What the sensor senses, one environment a row. inputs: (n, 9); elapsed: s, (n,)."""
        force, rate, angular = inputs[:, :3], inputs[:, 3:6], inputs[:, 6:]
        nowhere, warmth = _nowhere(len(elapsed)), self.around.warmth(elapsed)
        return Sense(elapsed, elapsed, force, rate, nowhere, nowhere, angular, warmth, *self._fixed)

    @property
    def longest_s(self) -> float:
        """Longest delay of a channel, s."""
        return max(self.before)

    def _stepped(self, effect: SignalEffect, seed: int | None) -> StepEffect:
        streams = (
            []
            if seed is None or not effect.random
            else [stream(seed + k, effect.id, self.sensor.name) for k in range(self.rows)]
        )
        stepped = effect.stepwise(Stepping(self.sensor, self.rows, streams))
        if stepped is None:
            raise _refused(effect, "an effect that needs later samples or the whole recording")
        stepped.restart(slice(None))
        return stepped

    def require_inputs(self, given: Array) -> None:
        """Refuse inputs that leave out what the sensor or one of its effects needs.

        Args:
            given: one for each number of an input that there is, NaN where there is none, (9,).

        Raises:
            TiltcalError: naming the sensor or the effect.
        """
        known, whole = (
            self.sense(numbers[None], np.zeros(1)) for numbers in (given, np.ones(INPUT))
        )
        subject, lacking = f"sensor {self.sensor.name}", bool(np.isnan(known.true_input()).any())
        for effect in self.deterministic:
            if not lacking:
                some, full = (effect.apply(whole.true_input(), s, None) for s in (known, whole))
                lacking = bool((np.isnan(some) & ~np.isnan(full)).any())
                subject = f"effect {effect.address}"
        if lacking:
            names = ("force", "rate", "angular acceleration")
            missing = [n for n, number in zip(names, given[::3], strict=True) if np.isnan(number)]
            raise TiltcalError(
                subject,
                found=f"no {', no '.join(missing)}",
                need="all of the motion that it senses",
                do="give it, or leave this out of the scenario",
            )

    def restart(self, rows: Rows) -> None:
        """These environments begin a new recording."""
        parts = [part for _, stepped in self.before.values() for part in stepped]
        for part in [*parts, *self.after]:
            part.restart(rows)
        self.readings = self.readings.copy()
        self.readings[rows] = np.nan

    def read(self, history: History, elapsed: Array, rows: Rows) -> Array:
        """The readings of these environments, (n, k), SI. elapsed: s, of these, (n,)."""
        step = self.around.step_s
        columns = np.empty((len(elapsed), len(self.sensor.axes)))
        for delay, (channels, parts) in self.before.items():
            inputs = history.before(delay / step, rows)
            sense = self.sense(inputs, elapsed - delay)
            reading = sense.true_input()
            for part in parts:
                reading = part(reading, sense, rows)
            if len(self.before) == 1:
                columns = reading
            else:
                columns[:, channels] = reading[:, channels]
        if self.sensor.kind == "inclinometer":
            columns = tilt_of_force(columns, self.around.scenario.site.gravity)
        for part in self.after:
            columns = part(columns, sense, rows)
        return columns


def require_stepwise(sensor: Sensor, step_s: float) -> None:
    """Refuse a sensor that cannot be sampled at the steps of a simulation.

    Raises:
        TiltcalError: it reads no force or rate, has a converter, or its samples fall between the
            steps.
    """
    subject = f"sensor {sensor.name}"
    if sensor.of is not None:
        raise TiltcalError(
            subject,
            found="an encoder, which reads what a drive leaves of its command",
            need="sensors of force and rate",
            do="leave it out; `tiltcal simulate` records it",
        )
    if sensor.converter is not None:
        raise TiltcalError(
            subject,
            found="a converter, which filters the signal between the steps",
            need="a sensor without one",
            do="leave [sensor.converter] out, and state a bandwidth and quantisation as effects",
        )
    ratio = 1 / (sensor.rate_hz * step_s)
    if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-6 * ratio:
        raise TiltcalError(
            subject,
            found=f"rate_hz = {sensor.rate_hz:g} with a step of {step_s:g} s",
            need=f"{1 / step_s:.6g} Hz divided by a whole number",
            do="change rate_hz, or the time step of the simulation",
        )


def _everywhere(effect: Effect) -> bool:
    return effect.sensor is None and isinstance(effect, DelayEffect)


def _delays(sensor: Sensor, effects: Sequence[DelayEffect]) -> list[float]:
    """The delay of each channel, s."""
    totals = []
    for channel in range(len(sensor.axes)):
        parts = [effect.constant(channel) for effect in effects]
        for effect, part in zip(effects, parts, strict=True):
            if part is None:
                raise _refused(effect, "a delay that varies, and may need later samples")
        total = float(sum(part for part in parts if part is not None))
        if total < 0:
            raise _refused(effects[0], f"a delay of {total:g} s, which needs later samples")
        totals.append(total)
    return totals


def _refused(effect: Effect, found: str) -> TiltcalError:
    return TiltcalError(
        f"effect {effect.address}",
        found=found,
        need="effects that act step by step",
        do="leave it out of this scenario: `tiltcal simulate` has it in a recording",
    )
