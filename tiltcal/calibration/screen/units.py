"""Whether a sensor's gain says that its column is in another unit."""

import numpy as np

from tiltcal.calibration.validity import Test, threshold_test
from tiltcal.core.arrays import Array
from tiltcal.core.units import COLUMN_UNITS, G0
from tiltcal.setup.sensor import Sensor

USUAL = (0.8, 1.25)  # gains beyond it raise the question
NEAR = np.log(1.3)  # of a unit's factor: sensors are within 30 % of their nominal gain
FOREIGN = np.log(G0) / 2  # half way between m_s2 and g, the two units that are nearest


def unit_test(sensor: Sensor, gains: Array, unit: str) -> Test:
    """Is the column in the unit that its name states? Fails where the gain is far from one.

    Args:
        sensor: which.
        gains: reading over what acts, of each channel, (k,).
        unit: of the column.
    """
    ratio = float(np.exp(np.mean(np.log(np.maximum(np.abs(gains), 1e-300)))))
    foreign = abs(np.log(ratio)) > FOREIGN
    words = f"the gain of {sensor.name} is {ratio:.4g}"
    if foreign:
        words += f": check the unit; {_guess(ratio, unit)}"
    elif not USUAL[0] < ratio < USUAL[1]:
        words += f": is {unit} the unit?"
    return threshold_test("unit", ratio, not foreign, words)


def _guess(ratio: float, unit: str) -> str:
    """The unit that would make the gain one, or counts."""
    stated = COLUMN_UNITS[unit]
    if stated.quantity == "raw":
        return "the stated input conversion of the sensor is another"
    for name, other in COLUMN_UNITS.items():
        same = other.quantity == stated.quantity
        if same and abs(np.log(ratio * other.factor / stated.factor)) < NEAR:
            return f"the columns say {unit}, the readings look like {name}"
    standard = "g" if stated.quantity == "acceleration" else "deg_s"
    per = ratio * COLUMN_UNITS[standard].factor / stated.factor
    return f"the columns say {unit}, the readings look like counts (LSB), {per:.5g} per {standard}"
