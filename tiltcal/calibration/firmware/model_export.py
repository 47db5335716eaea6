"""Any list of terms that act row by row, in floating point, for the template."""

from dataclasses import replace
from typing import Any

import numpy as np

from tiltcal.calibration.correction import temperature_terms
from tiltcal.calibration.firmware.linear_export import row_of
from tiltcal.calibration.firmware.log_units import log_unit, triad_with
from tiltcal.calibration.firmware.traced import Program, Traced, TracedRows, traced_sense
from tiltcal.calibration.result import Calibration
from tiltcal.core.errors import TiltcalError
from tiltcal.effects.base import TermEffect
from tiltcal.effects.sense import Sense
from tiltcal.instrument.model import ROUNDS, InstrumentModel
from tiltcal.instrument.temperature import SHORTEST
from tiltcal.recordings.recording import Recording
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup


def model_numbers(
    calibration: Calibration, setup: Setup, name: str, log: Recording | None = None
) -> dict[str, Any]:
    """What the template of models needs.

    Args:
        calibration: with terms that act row by row.
        setup: it was made with.
        name: what every C name begins with.
        log: whose units are used; those that were calibrated if not given.

    Raises:
        TiltcalError: an effect that remembers, or a sensor without the force that it follows.
    """
    sensors = [setup.named(n) for n in calibration.sensors()]
    terms = temperature_terms(calibration, setup)
    found: dict[str, Any] = {"thermal": terms is not None, "rounds": ROUNDS}
    if terms is not None:
        found |= {
            "kind": terms.memory.kind,
            "memory": terms.memory.words(),
            "size": repr(max(terms.memory.size, SHORTEST)),
            "smoothing": repr(max(terms.value("smoothing"), SHORTEST)),
        }
    return found | {"sensors": [_sensor(calibration, s, setup, name, log) for s in sensors]}


def _sensor(
    calibration: Calibration, sensor: Sensor, setup: Setup, name: str, log: Recording | None
) -> dict[str, Any]:
    """Numbers and statements of one sensor."""
    model = calibration.of_sensor(sensor, setup.site.gravity)
    _require_row_wise(model, sensor)
    unit = log_unit(sensor, log)
    bias, M = model.linear(sensor)
    at = [0] if sensor.kind == "fog" else list(sensor.axis_indices)
    missing = sorted({0, 1, 2} - set(at))
    third = missing[0] if sensor.is_accelerometer and len(at) == 2 else None
    force = _force(model, sensor, setup, log)
    program = Program(f"{name}_real", f"{name.upper()}_FN")
    results = _predicted(model, sensor, program, force is not None)
    angle = sensor.kind == "inclinometer"
    return {
        "name": sensor.name,
        "k": len(at),
        "unit": unit.written,
        "corrected_unit": unit.corrected,
        "equation": model.equation(sensor),
        "zero": row_of(unit.zero),
        "factor": repr(float(unit.factor)),
        "per_corrected": repr(float(1 / unit.corrected_factor)),
        "bias": row_of(bias),
        "inverse": [row_of(row) for row in np.linalg.inv(M[:, at])],
        "at": at,
        "third": third,
        "angle": angle,
        "g": repr(float(model.gravity)),
        "size": repr(float(model.unit_input(sensor))),
        "force": force,
        "statements": program.needed(results),
        "results": results,
    }


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


def _force(
    model: InstrumentModel, sensor: Sensor, setup: Setup, log: Recording | None
) -> dict[str, Any] | None:
    """The accelerometer triad whose force a rate sensor follows.

    Raises:
        TiltcalError: there is none.
    """
    if model.follows_force(sensor) is None:
        return None
    triad = triad_with(sensor, setup)
    unit = log_unit(triad, log)
    return {
        "name": triad.name,
        "unit": unit.written,
        "zero": row_of(unit.zero),
        "factor": repr(float(unit.factor)),
    }


def _predicted(
    model: InstrumentModel, sensor: Sensor, program: Program, with_force: bool
) -> list[str]:
    """The reading of each channel as C, of inputs ``x``, ``force`` and the state ``s``."""
    inputs = TracedRows([Traced(program, f"x[{i}]") for i in range(3)])
    force = TracedRows([Traced(program, f"force[{i}]") for i in range(3)]) if with_force else None
    warm, memory = None, None
    if model.temperature_terms(sensor) is not None:
        reference = program.constant(model.reference_degC or 0.0)
        warm = program.number(f"s->level - {reference}")
        memory = Traced(program, "s->memory")
    like = Sense.at_rest(sensor, model.gravity, np.zeros((1, 3)))
    if sensor.kind == "fog":
        along = sensor.input_vector
        inputs = TracedRows([Traced(program, "x[0]") * float(a) for a in along])
        like = replace(like, input_vector=along)
    sense = traced_sense(like, inputs, force, warm, memory)
    results: list[Any] = [sense.true_input()[:, i] for i in range(len(sensor.axes))]
    for effect in model.signal(sensor):
        if isinstance(effect, TermEffect):
            for term, value in effect.sizes.items():
                channel, column = _column(effect, term, sense)
                if channel >= 0 and value:
                    results[channel] = results[channel] + value * column
    return [result.name for result in results]


def _column(effect: TermEffect, term: str, sense: Sense) -> tuple[int, Any]:
    """The traced column of a term, named where it has none."""
    try:
        return effect.term(term, sense)
    except TiltcalError as error:
        raise TiltcalError(
            f"firmware, {effect.address}", found=error.found, need=error.need, do=error.do
        ) from error
