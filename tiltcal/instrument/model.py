"""An instrument as effects of the catalogue with values and one covariance.

A scenario injects effects, a diagnosis amends them and a calibration estimates them: all three give
an ``InstrumentModel``. It predicts what a sensor reads, how that depends on each parameter, and
which input a reading stands for.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.effects.base import Effect, SignalEffect, TermEffect
from tiltcal.effects.curve_coordinates import INPUTS, OF_SENSOR
from tiltcal.effects.learned import Learned
from tiltcal.effects.sense import Sense
from tiltcal.instrument.temperature import TemperatureTerms
from tiltcal.setup.sensor import Sensor

STEP = 1e-5  # of the unit of input: its square and rounding over it are alike, 1e-10
ROUNDS = 40  # of an inversion: each reduces the error by the size of the terms beyond the linear
CONVERGED = 1e-13  # of the size of an input: the rounding of a few sums


@dataclass(frozen=True)
class ModelParameter:
    """A parameter of a model.

    Args:
        name: as CAL.json has it, such as ``accel.K2_x``.
        effect: number of its effect in the model.
        key: its name in that effect, such as ``k2_x``.
    """

    name: str
    effect: int
    key: str


@dataclass(frozen=True)
class InstrumentModel:
    """What an instrument is.

    Args:
        sensors: whose signals the effects act on.
        gravity: m/s2.
        effects: with their values, SI.
        parameters: those with an uncertainty, in the order of the covariance.
        covariance: SI, (p, p).
        reference_degC: temperature at which terms over temperature vanish.
    """

    sensors: tuple[Sensor, ...]
    gravity: float
    effects: tuple[Effect, ...]
    parameters: tuple[ModelParameter, ...]
    covariance: Array
    reference_degC: float | None = None

    def signal(self, sensor: Sensor) -> list[SignalEffect]:
        """The effects on the reading of a sensor in the order in which they act."""
        own = [e for e in self.effects if isinstance(e, SignalEffect) and e.sensor == sensor.name]
        return sorted((e for e in own if not e.random), key=lambda e: e.order)

    @cached_property
    def geometry(self) -> tuple[Effect, ...]:
        """The effects that turn or move the instrument."""
        return tuple(e for e in self.effects if not isinstance(e, SignalEffect))

    def temperature_terms(self, sensor: Sensor) -> TemperatureTerms | None:
        """What a sensor's terms over temperature follow: ``TemperatureTerms`` of no size where only
        other terms depend on the temperature; None where none does.
        """
        for effect in self.signal(sensor):
            if isinstance(effect, TemperatureTerms):
                return effect
        force = self.unit_input(sensor) * np.full((1, 3), 0.5)
        cold = Sense.at_rest(sensor, self.gravity, force)
        cold = replace(cold, rate=force, input_vector=np.full(3, 0.5))
        warm = replace(cold, temperature=np.ones(1))
        # a table gives NaN beyond its angles
        same = np.array_equal(self._alone(sensor, cold), self._alone(sensor, warm), equal_nan=True)
        return None if same else TemperatureTerms({}, sensor.name)

    def predict(self, sensor: Sensor, sense: Sense) -> Array:
        """What a sensor reads, in the sensing form (force or rate), SI, (n, k).

        Args:
            sensor: which.
            sense: what it senses, (n,) rows.

        Raises:
            TiltcalError: an effect follows a table's axis that the rows do not know.
        """
        reading = sense.true_input()
        for effect in self.signal(sensor):
            try:
                reading = effect.apply(reading, sense, None)
            except KeyError as error:
                raise TiltcalError(
                    effect.address,
                    found=f"that it follows the table's axis {error}, which is not known here",
                    need="readings with that axis, or terms of the sensor alone",
                    do="leave the effect out",
                ) from error
        return reading

    def _alone(self, sensor: Sensor, sense: Sense) -> Array:
        """``predict`` without the effects that follow how a table moves, SI, (n, k)."""
        reading = sense.true_input()
        for effect in self.signal(sensor):
            if not isinstance(effect, Learned) or effect.coordinate in (*INPUTS, *OF_SENSOR):
                reading = effect.apply(reading, sense, None)
        return reading

    def sensitivity(self, sensor: Sensor, sense: Sense) -> Array:
        """Change of the reading per unit of each parameter of its signal, SI, (p, n, k); zero for
        the parameters of other sensors and of the geometry.

        Args:
            sensor: which.
            sense: what it senses, (n,) rows.
        """
        found = np.zeros((len(self.parameters), len(sense.time), len(sensor.axes)))
        for j, parameter in enumerate(self.parameters):
            effect = self.effects[parameter.effect]
            if isinstance(effect, TermEffect) and effect.sensor == sensor.name:
                channel, column = effect.term(parameter.key, sense)
                if channel >= 0:
                    found[j, :, channel] = column
        return found

    @cached_property
    def _linear(self) -> dict[str, tuple[Array, Array]]:
        return {sensor.name: self._expansion(sensor) for sensor in self.sensors}

    def linear(self, sensor: Sensor) -> tuple[Array, Array]:
        """Bias, SI, (k,), and sensitivity to the input along each body axis, (k, 3), by the bias,
        scale-factor and cross-axis terms; of a FOG along its own axis, (1, 1).
        """
        return self._linear[sensor.name]

    def _expansion(self, sensor: Sensor) -> tuple[Array, Array]:
        width = 1 if sensor.kind == "fog" else 3
        inputs = np.concatenate([np.zeros((1, width)), np.eye(width)])
        sense = self._sense_of(sensor, inputs, None)
        ideal = sense.true_input()
        bias, M = np.zeros(len(sensor.axes)), np.asarray((ideal[1:] - ideal[0]).T)
        for effect in self.signal(sensor):
            if effect.calibration_term and isinstance(effect, TermEffect):
                for name, value in effect.sizes.items():
                    channel, column = effect.term(name, sense)
                    bias[channel] += value * column[0]
                    M[channel] += value * (column[1:] - column[0])
        return bias, M

    def follows_force(self, sensor: Sensor) -> Array | None:
        """Reading of a rate sensor per unit of force along each body axis, rad/s per m/s2, (k, 3);
        None where it does not depend on the force.
        """
        if sensor.is_accelerometer:
            return None
        force = np.concatenate([np.zeros((1, 3)), np.eye(3)])
        read = self._alone(sensor, Sense.at_rest(sensor, self.gravity, force))
        slope = np.asarray((read[1:] - read[0]).T)
        return slope if slope.any() else None

    def equation(self, sensor: Sensor) -> str:
        """What the sensor reads, by the terms of its model."""
        letter = "f" if sensor.is_accelerometer else "w"
        usual = {
            "bias": "bias_i",
            "scale": f"scale_i {letter}_i",
            "cross_axis": f"sum_j cross_ij {letter}_j",
        }
        parts = []
        for effect in self.signal(sensor):
            stated = effect.equation.removeprefix("reading_i += ")
            parts.append(usual.get(effect.calibration_term, stated))
        return " + ".join([f"{sensor.name}_i = {letter}_i", *parts])

    def unit_input(self, sensor: Sensor) -> float:
        """Size of an ordinary input: g, m/s2, or 1 rad/s."""
        return self.gravity if sensor.is_accelerometer else 1.0

    def invert(self, sensor: Sensor, reading: Array, given: Sense | None = None) -> Array:
        """The input that a reading stands for, along each channel, SI, (n, k).

        Newton's iteration with the sensitivity of ``linear`` in place of the slope. With two
        channels of an accelerometer the third component follows from |f| = g, pointing up.

        Args:
            sensor: which.
            reading: in the sensing form, SI, (n, k).
            given: what is known of the rows in addition: time, temperature, and with a gyro the
                force; the rate across the axis of a FOG.
        """
        bias, M = self.linear(sensor)
        columns = [0] if sensor.kind == "fog" else list(sensor.axis_indices)
        inverse = np.asarray(np.linalg.inv(M[:, columns]))
        unbiased = reading - bias
        found = product(inverse, unbiased)
        if len(columns) == M.shape[1] and all(e.calibration_term for e in self.signal(sensor)):
            return found
        limit = CONVERGED * self.unit_input(sensor)
        active = np.ones(len(found), bool)
        for _ in range(ROUNDS):
            inputs = self._complete(sensor, found)
            after = product(inverse, unbiased - self._beyond(sensor, inputs, given, columns))
            change = np.abs(after - found)
            # each reading by itself: the same whatever others are corrected with it
            found[active] = after[active]
            active &= (change >= limit).any(axis=1)
            if not active.any():
                break
        return found

    def slopes(self, sensor: Sensor, inputs: Array, given: Sense | None = None) -> Array:
        """Change of the readings with the inputs, by central differences, (n, k, k).

        Args:
            sensor: which.
            inputs: along each channel, SI, (n, k).
            given: as of ``invert``.
        """
        step = STEP * self.unit_input(sensor)
        found = []
        for direction in np.eye(inputs.shape[1]):
            up, down = (
                self.predict(
                    sensor,
                    self._sense_of(
                        sensor, self._complete(sensor, inputs + way * step * direction), given
                    ),
                )
                for way in (1, -1)
            )
            found.append((up - down) / (2 * step))
        return np.moveaxis(np.array(found), 0, -1)

    def _beyond(
        self, sensor: Sensor, inputs: Array, given: Sense | None, columns: Sequence[int]
    ) -> Array:
        """What a sensor reads beyond its bias and what follows linearly from the input along its
        channels, SI, (n, k).

        Args:
            sensor: which.
            inputs: along all body axes, (n, 3).
            given: see ``invert``.
            columns: axes of the channels.
        """
        bias, M = self.linear(sensor)
        effects = self.signal(sensor)
        sense = self._sense_of(sensor, inputs, given)
        if not all(isinstance(effect, TermEffect) for effect in effects):
            linear = product(M[:, list(columns)], inputs[:, list(columns)])
            return self.predict(sensor, sense) - bias - linear
        found = np.zeros((len(inputs), len(sensor.axes)))
        for missing in sorted(set(range(M.shape[1])) - set(columns)):
            if M[:, missing].any():
                found += np.outer(inputs[:, missing], M[:, missing])
        for effect in effects:
            if not effect.calibration_term:
                found = effect.apply(found, sense, None)
        return found

    def _complete(self, sensor: Sensor, found: Array) -> Array:
        """Inputs along all body axes from those along the channels, (n, 3)."""
        if sensor.kind == "fog":
            return found
        full = np.zeros((len(found), 3))
        full[:, list(sensor.axis_indices)] = found
        if sensor.is_accelerometer and found.shape[1] == 2:
            (missing,) = set(range(3)) - set(sensor.axis_indices)
            g = self.gravity
            full[:, missing] = np.sqrt(np.maximum(g * g - (found * found).sum(axis=1), 0.0))
        return full

    def _sense_of(self, sensor: Sensor, inputs: Array, given: Sense | None) -> Sense:
        """What a sensor senses with these inputs, (n, 3), of a FOG (n, 1)."""
        if given is None:
            given = Sense.at_rest(sensor, self.gravity, np.zeros((len(inputs), 3)))
        if sensor.is_accelerometer:
            return replace(given, force=inputs)
        if sensor.kind == "fog":
            along = sensor.input_vector
            across = given.rate - np.outer(given.rate @ along, along)
            return replace(given, rate=across + inputs * along, input_vector=along)
        return replace(given, rate=inputs)


def product(A: Array, v: Array) -> Array:
    """A v for each row of v, (n, k) -> (n, m): summed in one order, so that a row's result does not
    depend on how many others there are, as it may in a product of matrices.
    """
    found = np.empty((len(v), len(A)))
    for i, row in enumerate(A):
        total = row[0] * v[:, 0]
        for j in range(1, len(row)):
            total += row[j] * v[:, j]
        found[:, i] = total
    return found
