"""Units against what is known: gravity at standstill, the circle, temperatures that electronics
survive.
"""

from collections.abc import Iterator

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import COLUMN_UNITS, DEG, G0, split_unit
from tiltcal.data_quality.check import Check, Finding, in_rows, in_words
from tiltcal.data_quality.log import AT_REST, REST, Channel, Log

# half way to the nearest wrong factor, 1/2 and 2 of another full-scale range
USUAL = (2**-0.5, 2**0.5)
NEAR = np.log(1.3)  # of a unit's factor: sensors are within 30 % of their nominal gain
CLOSE = np.log(1.1)  # of a power of two
RANGES = (2.0, 0.5, 4.0, 0.25, 8.0, 0.125)  # ratios of full-scale ranges of one sensor
EVEN = 0.05  # relative scatter of the norm over the rests, of a triad that senses gravity
NONE = 0.05  # g: a norm below it is no gravity
KELVIN = (200.0, 450.0)  # degC: a temperature of electronics in K lies there
HOTTEST = 175.0  # degC, the highest rating of silicon: beyond it a thermometer reads degF or K
TURN = 360.0 * DEG


def unit_doubt(ratio: float, unit: str, what: str) -> str | None:
    """What is wrong with a unit by the ratio of readings to what acts; None where nothing is.

    Args:
        ratio: of the readings to what acts.
        unit: of the column, or the raw one.
        what: whose readings, for the sentence.
    """
    if USUAL[0] < ratio < USUAL[1]:
        return None
    found = f"the gain of {what} is {ratio:.4g}: "
    stated = COLUMN_UNITS[unit]
    if stated.quantity == "raw":
        if (power := _power_of_two(ratio)) is not None:
            return found + _other_range(power, stated.quantity)
        return found + "the stated input conversion of the sensor is another"
    for name, other in COLUMN_UNITS.items():
        same = other.quantity == stated.quantity and name != unit
        if same and abs(np.log(ratio * other.factor / stated.factor)) < NEAR:
            return found + f"the columns say {unit}, the readings look like {name}"
    if (power := _power_of_two(ratio)) is not None:
        return found + _other_range(power, stated.quantity)
    standard = {"acceleration": "g", "angle": "deg"}.get(stated.quantity, "deg_s")
    per = ratio * COLUMN_UNITS[standard].factor / stated.factor
    if per < 1:
        return found + f"no unit of {stated.quantity} is so far from {unit}"
    return found + (
        f"the columns say {unit}, the readings look like counts (LSB), {per:.5g} per {standard}"
    )


def _power_of_two(ratio: float) -> float | None:
    near = min(RANGES, key=lambda r: abs(np.log(ratio / r)))
    return near if abs(np.log(ratio / near)) < CLOSE else None


def _other_range(power: float, quantity: str) -> str:
    times = f"{power:g}" if power > 1 else f"1/{1 / power:g}"
    words = f"{times} of what acts, as with another full-scale range than the stated one"
    return words + (", or stamps of another rate" if quantity == "rate" else "")


class Gravity(Check):
    """A triad of accelerometers whose norm at standstill is not gravity."""

    name = "gravity"
    test = "unit"
    looks_at = "three columns of acceleration, where they are quiet"
    finds = "a norm at standstill off by a factor of 1.5, the same in all positions"

    def _find(self, log: Log) -> Iterator[Finding]:
        for name, channels in log.sensors.items():
            if len(channels) != 3 or any(c.quantity != "acceleration" for c in channels):
                continue
            units = {str(split_unit(c.name)[1]) for c in channels}
            norms = _norms_at_rest(channels)
            if len(units) > 1 or not len(norms):
                continue
            (unit,) = units
            norm = float(np.median(norms)) * COLUMN_UNITS[unit].factor / G0
            columns = tuple(c.name for c in channels)
            if norm < NONE:
                words = (
                    f"{in_words(columns)}: the norm at standstill is {norm:.2g} g: gravity was"
                    " taken off, these are no readings of an accelerometer"
                )
            elif float(np.std(norms)) > EVEN * float(np.median(norms)):
                continue
            elif (doubt := unit_doubt(norm, unit, name)) is not None:
                words = f"{in_words(columns)}: {doubt}"
            else:
                continue
            yield self.finding(columns, channels[0].rows, words, size={"gain": norm})


def _norms_at_rest(channels: list[Channel]) -> Array:
    """Norms of the means of the quietest blocks, (m,), in the unit of the columns."""
    if len({len(c.sample) for c in channels}) > 1:
        return np.zeros(0)
    values = np.column_stack([c.sample for c in channels])
    blocks = values[: len(values) // REST * REST].reshape(-1, REST, 3)
    if not len(blocks):
        return np.zeros(0)
    spread = blocks.std(axis=1).sum(axis=1)
    quiet = blocks[spread <= np.quantile(spread, AT_REST)]
    return np.asarray(np.linalg.norm(quiet.mean(axis=1), axis=1))


class Circle(Check):
    """An inclination of more than a turn."""

    name = "inclination"
    test = "unit"
    looks_at = "angles that a sensor reads"
    finds = "a fifth of the readings beyond 360 deg"

    def _find(self, log: Log) -> Iterator[Finding]:
        for c in log.readings:
            if c.quantity != "angle" or len(c.read) == 0:
                continue
            unit = str(split_unit(c.name)[1])
            beyond = np.abs(c.read) * COLUMN_UNITS[unit].factor > TURN
            if beyond.mean() > AT_REST:  # one wild reading is no unit
                rows = c.rows[beyond]
                words = (
                    f"{c.name}: readings up to {np.abs(c.read).max():.5g} {unit} are no"
                    f" inclination, {in_rows(rows)}"
                )
                yield self.finding((c.name,), rows, words)


class Thermometer(Check):
    """A temperature in K or degF under the name of degC."""

    name = "temperature"
    test = "unit"
    looks_at = "temperature"
    finds = "a median beyond 175 degC"

    def _find(self, log: Log) -> Iterator[Finding]:
        c = log.channels.get("temperature_degC")
        if c is None or not len(c.read):
            return
        middle = float(np.median(c.read))
        if middle > HOTTEST:
            unit = "K" if KELVIN[0] < middle < KELVIN[1] else "degF or raw"
            words = f"{c.name}: {middle:.4g} degC at the median: the readings look like {unit}"
            yield self.finding((c.name,), c.rows, words)
