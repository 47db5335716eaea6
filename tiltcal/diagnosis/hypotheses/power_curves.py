"""Curves with one number: powers of an input, products of two, coefficients that vary."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

from tiltcal.diagnosis.hypotheses.curve_forms import curve_over, even_knots
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.effects import CATALOGUE
from tiltcal.effects.learned import LearnedReading
from tiltcal.effects.spans import CoordinateRanges
from tiltcal.setup.sensor import Sensor

# of a force or a rate; whether odd
POWERS = (
    (0.5, False),
    (0.5, True),
    (1.0, False),
    (2.0, False),
    (2.0, True),
    (3.0, True),
)
VARYING = ("temperature", "time", "speed")
"""What a coefficient may be in proportion to. Not the rate of warming: where a temperature swings
evenly, that is the same as a temperature that is felt late, which has laws of its own.
"""


def varying_coefficients(
    sensor: Sensor, across: Sequence[str], span: CoordinateRanges, where: Mapping[str, Any]
) -> Iterator[Hypothesis]:
    """Powers of the own input and of others whose coefficient is in proportion to what varies: a
    temperature, the time, the speed. Not those that the catalogue or a scale factor over the same
    coordinate holds.

    Args:
        sensor: whose reading; where: its channel.
        across: the other inputs; span: what the recordings span.
    """
    for times in (t for t in VARYING if even_knots(t, span, 2)):
        linear, forms = list(across), []
        if times == "temperature":
            forms += [("input", power, odd) for power, odd in POWERS if power > 1 or not odd]
            forms += [(c, 2.0, False) for c in across]
            if sensor.is_accelerometer:  # a misalignment
                linear = [c for c in across if not c.startswith("force")]
        forms += [(c, 1.0, True) for c in linear]
        for coordinate, power, odd in forms:
            yield curve_over(
                LearnedReading,
                coordinate,
                1,
                power=power,
                odd=odd,
                times=times,
                **where,
            )


def products(
    sensor: Sensor, across: Sequence[str], where: Mapping[str, Any]
) -> Iterator[Hypothesis]:
    """Products of two inputs, but for those of the catalogue; what stands for others by name.

    Args:
        sensor: whose reading; where: its channel.
        across: the inputs beside its own.
    """
    for one, other in combinations(("input", *across), 2):
        own = "force" if sensor.is_accelerometer else "rate"
        kinds = {(own if c == "input" else c).split("_")[0] for c in (one, other)}
        if kinds == {"force"} and sensor.is_accelerometer:
            continue
        laws = [c for c in CATALOGUE.values() if {c.products_of} == kinds and c.senses(sensor.kind)]
        curve = curve_over(LearnedReading, one, 1, power=1.0, odd=True, times=other, **where)
        yield replace(curve, alias=laws[0].id if laws else None)


def powers(coordinate: str, where: Mapping[str, Any]) -> Iterator[Hypothesis]:
    """Laws with one number: a root, a modulus, a square, a cube."""
    for power, odd in POWERS:
        if not (odd and coordinate == "transverse"):
            yield curve_over(LearnedReading, coordinate, 1, power=power, odd=odd, **where)
