"""Goals: the standard uncertainty that each parameter is to reach."""

import re
from collections.abc import Mapping, Sequence

from tiltcal.core.errors import TiltcalError, nearest
from tiltcal.core.units import PARAMETER_UNITS

_NUMBER = re.compile(r"\s*([-+0-9.eE]+?)\s*(?:([a-zA-Z][a-zA-Z0-9_]*))?\s*")
_SI = {"1": "unitless"}


def goals_of(
    asked: Mapping[str, str | float], units: Mapping[str, str], subject: str = "goal"
) -> dict[str, float]:
    """Goal of each parameter that is named, in the unit of the calibration.

    Args:
        asked: by kind (``bias``, ``accel.bias``) or name (``bias_x``, ``accel.bias_x``): number
            and unit, such as ``50ug``; a bare number is in the unit of CAL.json.
        units: of each parameter, by name, as in CAL.json.
        subject: of messages.

    Raises:
        TiltcalError: a name is no parameter, or a value is no positive number with a unit that
            fits.
    """
    named = {key: [name for name in units if key in _keys(name)] for key in asked}
    for key in (key for key, names in named.items() if not names):
        known = sorted({k for name in units for k in _keys(name)})
        raise TiltcalError(
            f"{subject} {key}",
            found="no such parameter",
            need=f"a kind such as {', '.join(sorted({_kind(n) for n in units}))}",
            do=nearest(key, known),
        )
    found: dict[str, float] = {}
    for key in sorted(named, key=lambda key: -len(named[key])):  # one parameter beats its kind
        found |= {n: _in_unit(asked[key], units[n], f"{subject} {key}") for n in named[key]}
    return found


def parse_goals(texts: Sequence[str]) -> dict[str, str]:
    """``("accel.bias=50ug", ...)`` as a mapping.

    Raises:
        TiltcalError: one is not of the form KIND=VALUE.
    """
    found = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not (key and equals and value):
            raise TiltcalError(
                f"--goal {text}",
                found="no KIND=SIGMA",
                need="for example accel.bias=50ug",
                do="correct it",
            )
        found[key.strip()] = value.strip()
    return found


def _kind(name: str) -> str:
    """``accel.bias_x`` -> ``accel.bias``."""
    return name.rpartition("_")[0]


def _keys(name: str) -> set[str]:
    """What may stand for a parameter: itself or its kind, with its sensor or without."""
    return {key for full in (name, _kind(name)) for key in (full, full.partition(".")[2])}


def _in_unit(value: str | float, unit: str, subject: str) -> float:
    own = PARAMETER_UNITS.get(_SI.get(unit, unit))
    matched = _NUMBER.fullmatch(str(value))
    try:
        number = float(matched[1]) if matched else float("nan")
    except ValueError:
        number = float("nan")
    if matched is None or not 0 < number < float("inf"):
        raise TiltcalError(
            subject,
            found=f"'{value}'",
            need="a positive number and its unit, such as 50ug",
            do="correct it",
        )
    if not matched[2] or own is None:
        return number
    stated = PARAMETER_UNITS.get(matched[2])
    same = {own.quantity} | ({"angle"} if own.quantity == "ratio" else set())
    if stated is None or stated.quantity not in same:
        fitting = [n for n, u in PARAMETER_UNITS.items() if n and u.quantity in same]
        raise TiltcalError(
            subject,
            found=f"unit {matched[2]}",
            need=f"one of {', '.join(fitting)}",
            do=nearest(matched[2], fitting),
        )
    return number * stated.factor / own.factor
