"""The temperature in integers: its low-pass, its memory, and the error of both."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tiltcal.calibration.firmware.fixed_functions import RATE_PLACES
from tiltcal.calibration.firmware.fixed_point import integers
from tiltcal.calibration.result import Calibration
from tiltcal.core.errors import TiltcalError
from tiltcal.instrument.temperature import SHORTEST, TemperatureTerms

READ_PLACES = 16  # of a temperature that is read, degC
STATE_PLACES = 40  # of temperatures that are remembered, degC
HYSTERESIS_PLACES = 60  # of the state of a hysteresis, -1 ... 1
SHORTEST_STEP_S = 1e-3  # between temperatures, for which the error is stated
WIDEST = 256.0  # degC, of the range
NARROWEST = 0.1  # degC, of a hysteresis
CHANGE_PLACES = 60  # of the exponent by which a hysteresis turns over, per degC
SPAN = 30.0  # degC about T0, where no range was calibrated
WHOLE = 2**64


@dataclass(frozen=True)
class FixedTemperature:
    """Constants and errors.

    Args:
        numbers: for the template.
        lowest, highest: to which it is held, degC.
        level: largest error of the level, degC; memory: of the memory, in its unit.
        most: largest size of the memory.
        memory_places: of the memory.
    """

    numbers: dict[str, Any]
    lowest: float
    highest: float
    level: float
    memory: float
    most: float
    memory_places: int


def temperature_range(calibration: Calibration) -> tuple[float, float]:
    """To which the temperature is held, whole degC: that of the calibration, or ``SPAN`` about
    T0.
    """
    T0 = calibration.value("temperature.T0")
    low = calibration.value("temperature.lowest", T0 - SPAN)
    high = calibration.value("temperature.highest", T0 + SPAN)
    return float(np.floor(low)), float(np.ceil(high))


def fixed_temperature(terms: TemperatureTerms, low: float, high: float) -> FixedTemperature:
    """The temperature of a calibration in integers.

    Args:
        terms: that follow it.
        low, high: of the calibration, degC.

    Raises:
        TiltcalError: its range is too wide, or its hysteresis too narrow.
    """
    memory, span = terms.memory, high - low
    if span > WIDEST or (memory.kind == "hysteresis" and memory.size < NARROWEST):
        raise TiltcalError(
            "fixed point, temperature",
            found=f"a range of {span:g} degC, {memory.words()}",
            need=f"{WIDEST:g} degC at most, a hysteresis of {NARROWEST:g} degC or more",
            do="calibrate over a smaller range, or export with --no-integers",
        )
    smoothing, level = _constant(terms.value("smoothing"), span)
    numbers: dict[str, Any] = {
        "low": f"{low:.1f}",
        "high": f"{high:.1f}",
        "lowest": integers(np.array(low), READ_PLACES)[0],
        "highest": integers(np.array(high), READ_PLACES)[0],
        "smoothing": smoothing,
        "read_places": READ_PLACES,
        "state_places": STATE_PLACES,
    }
    wrong, most, places = 0.0, 0.0, STATE_PLACES
    if memory.kind == "lag":
        numbers["size"], of_lag = _constant(memory.size, span)
        wrong, most = 2 * level + of_lag, span
    elif memory.kind == "hysteresis":
        per_degree = 1 / (memory.size * np.log(2))
        rate = round(per_degree * 2**CHANGE_PLACES)
        largest = round(64 / per_degree * 2**STATE_PLACES * (1 - 1e-9))
        numbers["size"] = {"rate": rate, "limit": largest}
        # a level that is wrong by e is late in turning over by e, at both ends of its way
        wrong, most, places = 8 * level / memory.size + 1e-7, 1.0, HYSTERESIS_PLACES
    numbers["memory_places"] = places
    return FixedTemperature(numbers, low, high, level, wrong, most, places)


def _constant(seconds: float, span: float) -> tuple[dict[str, int], float]:
    """A time constant as decay per microsecond, and the error of what follows with it, degC."""
    per_us = 1 / (max(seconds, SHORTEST) * 1e6 * np.log(2))
    rate = round(per_us * 2.0**RATE_PLACES)
    least = 2.0**-STATE_PLACES
    if rate >= WHOLE:
        return {"rate": 0, "limit": 1}, least  # one microsecond is all
    gain = -np.expm1(-SHORTEST_STEP_S / max(seconds, SHORTEST))
    relative = 0.5 / max(rate, 1) + 1e-11  # of the gain: by the rate, and by the polynomial
    return {"rate": rate, "limit": (WHOLE - 1) // max(rate, 1)}, relative * span + least / gain
