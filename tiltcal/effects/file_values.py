"""Values of an effect's parameters as a file states them."""

from collections.abc import Mapping
from typing import Any

from tiltcal.core.errors import TiltcalError, nearest, shown
from tiltcal.core.units import PARAMETER_UNITS, split_unit
from tiltcal.effects.parameter import Parameter

LARGEST = 1e30  # of a size: its powers are still numbers


def check_allowed(parameter: Parameter, number: float, value: Any, subject: str) -> None:
    """Widths, deviations and times are not negative; what divides (it has a default, and counts
    nothing) is not zero; a switch is 0 or 1.

    Raises:
        TiltcalError: the number is not allowed.
    """
    if parameter.positive and number < 0:
        raise TiltcalError(subject, found=f"{value}", need="a value >= 0", do="correct its sign")
    if parameter.switch and number not in (0, 1):
        raise TiltcalError(subject, found=f"{value}", need="0 or 1", do="write 1 where it applies")
    divides = parameter.positive and parameter.default and not parameter.whole
    if divides and number == 0:
        raise TiltcalError(
            subject, found=f"{value}", need="a value > 0", do="leave it out, or give its size"
        )


def file_names(known: Mapping[str, Parameter]) -> list[str]:
    """The keys of parameters in files: names with their units."""
    return [f"{name}{p.suffix}" for name, p in known.items()]


def parameter_of(key: str, known: Mapping[str, Parameter], subject: str) -> tuple[str, float]:
    """Bare name and SI factor of a key such as ``k2_x_ug_g2``; any unit of the same quantity will
    do.

    Raises:
        TiltcalError: no parameter has this name, or the unit is of another quantity.
    """
    for name, parameter in known.items():
        if key == f"{name}{parameter.suffix}":
            return name, parameter.factor
    name, unit = split_unit(key, PARAMETER_UNITS)
    if name in known and unit is not None:
        if PARAMETER_UNITS[unit].quantity == PARAMETER_UNITS[known[name].unit].quantity:
            return name, PARAMETER_UNITS[unit].factor
        raise TiltcalError(
            f"{subject}, key {key}",
            found=f"unit {unit}",
            need=f"a unit like {known[name].unit}",
            do="convert the value",
        )
    raise TiltcalError(
        subject,
        found=f"unknown key '{key}'",
        need="a parameter with its unit",
        do=nearest(key, file_names(known)),
    )


def number_of(value: Any, subject: str) -> float:
    """A number of a file.

    Raises:
        TiltcalError: it is none, or too large.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= LARGEST:
        raise TiltcalError(
            subject,
            found=shown(value),
            need="a number" if isinstance(value, str) else f"a number of at most {LARGEST:g}",
            do="write it without quotes" if isinstance(value, str) else "correct it",
        )
    return float(value)
