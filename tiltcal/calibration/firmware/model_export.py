"""Any list of terms that act row by row: what the instrument adds to its input, traced."""

import re
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from tiltcal.calibration.correction import temperature_terms
from tiltcal.calibration.firmware.float_code import float_code
from tiltcal.calibration.firmware.log_units import LogUnit, log_unit, triad_with
from tiltcal.calibration.firmware.traced import Program, TracedRows, traced_sense
from tiltcal.calibration.result import Calibration
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.effects.base import TermEffect
from tiltcal.effects.sense import Sense
from tiltcal.instrument.model import ROUNDS, InstrumentModel
from tiltcal.instrument.temperature import SHORTEST, TemperatureTerms
from tiltcal.recordings.recording import Recording
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup


@dataclass(frozen=True)
class SensorModel:
    """What one sensor reads: ``bias + M x + beyond(x)``, of its input x along its channels, SI.

    Args:
        sensor, unit: whose.
        model: with its effects.
        force: the triad whose force it follows, with the unit of its log; None: none.
        follows_temperature: whether the header follows a temperature.
    """

    sensor: Sensor
    unit: LogUnit
    model: InstrumentModel
    force: tuple[Sensor, LogUnit] | None
    follows_temperature: bool

    @property
    def axes(self) -> list[int]:
        """Index of the input of each channel."""
        return [0] if self.sensor.kind == "fog" else list(self.sensor.axis_indices)

    @property
    def is_angle(self) -> bool:
        """Whether readings are elevations, whose sines are forces in g."""
        return self.sensor.kind == "inclinometer"

    @property
    def bias(self) -> Array:
        """SI, (k,)."""
        return self.model.linear(self.sensor)[0]

    @cached_property
    def inverse(self) -> Array:
        """Of the sensitivity to the channels' own inputs, (k, k)."""
        M = self.model.linear(self.sensor)[1]
        return np.asarray(np.linalg.inv(M[:, self.axes]), dtype=float)

    @cached_property
    def beyond(self) -> tuple[Program, list[int]]:
        """What each channel reads beyond its bias and its own channels, SI, as nodes of a
        computation from the input ``x``, the reading ``force`` and the state ``s`` of the
        temperature.
        """
        program, sensor = Program(), self.sensor
        x: list[Any] = [program.constant(0.0)] * 3
        for i in self.axes:
            x[i] = program.input(f"x[{i}]")
        if sensor.is_accelerometer and len(self.axes) == 2:
            (missing,) = {0, 1, 2} - set(self.axes)
            x[missing] = program.upright([x[i] for i in self.axes], self.model.gravity)
        sense = self._sense(program, x)
        M = self.model.linear(sensor)[1]
        results = [program.constant(0.0)] * len(self.axes)
        for missing in sorted(set(range(M.shape[1])) - set(self.axes)):
            results = [
                r + float(m) * x[missing] for r, m in zip(results, M[:, missing], strict=True)
            ]
        for effect in self.model.signal(sensor):
            if isinstance(effect, TermEffect) and not effect.calibration_term:
                for term, value in effect.sizes.items():
                    channel, column = _column(effect, term, sense)
                    if channel >= 0 and value:
                        results[channel] = results[channel] + value * column
        return program, [result.index for result in results]

    def _sense(self, program: Program, x: list[Any]) -> Any:
        """What the sensor senses, traced."""
        force = None
        if self.force is not None:
            unit = self.force[1]
            read = [program.input(f"force[{i}]") - float(unit.zero[i]) for i in range(3)]
            force = TracedRows([r * unit.factor for r in read])
        warm, memory = None, None
        terms = self.model.temperature_terms(self.sensor)
        if terms is not None:
            warm = program.input("s->level") - (self.model.reference_degC or 0.0)
            memory = program.input("s->memory") if terms.memory.size else None
        like = Sense.at_rest(self.sensor, self.model.gravity, np.zeros((1, 3)))
        if self.sensor.kind == "fog":
            like = replace(like, input_vector=self.sensor.input_vector)
            x = [x[0] * float(a) for a in self.sensor.input_vector]
        return traced_sense(like, TracedRows(x), force, warm, memory)

    @cached_property
    def operations(self) -> set[str]:
        """What computes ``beyond``."""
        program, results = self.beyond
        return {program.nodes[n].operation for n in program.needed(results)}

    @property
    def is_steep(self) -> bool:
        """Whether the reading of a steep axis has no bound of its error: by an arcsine, a placing
        angle or the axis that the instrument lacks.
        """
        return self.is_angle or bool(self.operations & {"upright", "arctan2"})

    @property
    def is_linear(self) -> bool:
        """Whether nothing lies beyond the bias and the channels' own inputs."""
        program, results = self.beyond
        return all(program.nodes[r] == program.constant(0.0).node for r in results)


def sensor_models(
    calibration: Calibration, setup: Setup, log: Recording | None = None
) -> list[SensorModel]:
    """The models of a calibration's sensors.

    Args:
        calibration: with terms that act row by row.
        setup: it was made with.
        log: whose units are used; those that were calibrated if not given.

    Raises:
        TiltcalError: an effect that remembers, a sensor without the force that it follows, no
            sensor, or a name that C does not allow.
    """
    sensors = [setup.named(n) for n in calibration.sensors()]
    _require_sensors(calibration, sensors)
    terms = temperature_terms(calibration, setup)
    found = []
    for sensor in sensors:
        model = calibration.of_sensor(sensor, setup.site.gravity)
        _require_row_wise(model, sensor)
        force = None
        if model.follows_force(sensor) is not None:
            triad = triad_with(sensor, setup)
            force = triad, log_unit(triad, log)
        found.append(SensorModel(sensor, log_unit(sensor, log), model, force, terms is not None))
    return found


def _require_sensors(calibration: Calibration, sensors: list[Sensor]) -> None:
    if not sensors:
        raise TiltcalError(
            f"calibration by {calibration.method}",
            found="no sensor",
            need="terms of a sensor",
            do="calibrate one",
        )
    for sensor in sensors:
        if not re.fullmatch(r"[A-Za-z0-9_]+", sensor.name):
            raise TiltcalError(
                f"sensor '{sensor.name}'",
                found="a name that C does not allow",
                need="letters, digits and _",
                do="rename it in the scenario and calibrate again",
            )


def _require_row_wise(model: InstrumentModel, sensor: Sensor) -> None:
    """Refuse effects that are no sum of terms of one row.

    Raises:
        TiltcalError: naming them.
    """
    other = [
        effect.id
        for effect in model.signal(sensor)
        if not (isinstance(effect, TermEffect) and effect.row_wise)
    ]
    if other:
        raise TiltcalError(
            f"firmware, sensor {sensor.name}",
            found=", ".join(other),
            need="terms that depend on one reading and the temperature",
            do="leave them out, or correct on a computer with `tiltcal correct`",
        )


def _column(effect: TermEffect, term: str, sense: Sense) -> tuple[int, Any]:
    """The traced column of a term, named where it has none."""
    try:
        return effect.term(term, sense)
    except TiltcalError as error:
        raise TiltcalError(
            f"firmware, {effect.address}", found=error.found, need=error.need, do=error.do
        ) from error


def float_numbers(
    models: list[SensorModel], terms: TemperatureTerms | None, name: str
) -> dict[str, Any]:
    """What the floating-point part of the template needs.

    Args:
        models: of the sensors.
        terms: over temperature; None: none.
        name: what every C name begins with.
    """
    found: dict[str, Any] = {"thermal": terms is not None}
    if terms is not None:
        found |= {
            "kind": terms.memory.kind,
            "memory": terms.memory.words(),
            "size": repr(max(terms.memory.size, SHORTEST)),
            "smoothing": repr(max(terms.value("smoothing"), SHORTEST)),
        }
    return found | {"sensors": [_float_sensor(m, name) for m in models]}


def _float_sensor(m: SensorModel, name: str) -> dict[str, Any]:
    statements, results = float_code(*m.beyond, name)
    return {
        "name": m.sensor.name,
        "k": len(m.axes),
        "unit": m.unit.written,
        "corrected_unit": m.unit.corrected,
        "equation": m.model.equation(m.sensor),
        "zero": row_of(m.unit.zero),
        "factor": repr(float(m.unit.factor)),
        "per_corrected": repr(float(1 / m.unit.corrected_factor)),
        "bias": row_of(m.bias),
        "inverse": [row_of(row) for row in m.inverse],
        "at": m.axes,
        "third": m.sensor.is_accelerometer and len(m.axes) == 2,
        "angle": m.is_angle,
        "g": repr(float(m.model.gravity)),
        "size": repr(float(m.model.unit_input(m.sensor))),
        "force": m.force and {"name": m.force[0].name, "unit": m.force[1].written},
        "rounds": 0 if m.is_linear else ROUNDS,
        "statements": statements,
        "results": results,
    }


def row_of(values: Array) -> list[str]:
    """Numbers as C has them. values: (n,)."""
    return [repr(float(v)) for v in values]
