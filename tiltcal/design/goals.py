"""Goals of a sequence, and the least table time in which a design reaches them.

A standard uncertainty falls with the root of the time while the poses stay the same, so that each
trial is made where the last two, on logarithmic scales, put the goal; every third halves what is
left.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from tiltcal.core.errors import TiltcalError, nearest_of
from tiltcal.core.units import PARAMETER_UNITS
from tiltcal.design.model import Model
from tiltcal.design.plan import Forecast

TILT = "tilt"  # rms error per axis over the working range
EXPANDED = "U"  # twice that: coverage of 95 % (GUM, 6.2)
COVERAGE = 2.0
NEAR = 1.03  # a time that is no longer than this times a known too short one is the least: a
# sigma differs by half of that
TRIALS = 12  # designs at most: the four halvings alone narrow a range to a sixteenth
LISTED = 8  # kinds of parameters in a message
_NUMBER = re.compile(r"\s*([-+0-9.eE]+?)\s*(?:([a-zA-Z][a-zA-Z0-9_]*))?\s*")
_SI = {"1": "unitless"}
Found = TypeVar("Found")


@dataclass(frozen=True)
class Goal:
    """The largest standard uncertainty of a parameter, or the largest error of the tilt.

    Args:
        name: of the parameter; ``tilt`` or ``U``.
        limit: in the unit.
        unit: of the parameter; arcsec.
    """

    name: str
    limit: float
    unit: str

    def reached(self, forecast: Forecast, names: Sequence[str]) -> float:
        """What a sequence is expected to reach, in the unit. names: of its parameters, (p,)."""
        if self.name == TILT:
            return forecast.tilt_arcsec
        if self.name == EXPANDED:
            return COVERAGE * forecast.tilt_arcsec
        return float(forecast.sigma[names.index(self.name)])


def goals_of(texts: Sequence[str], model: Model) -> tuple[Goal, ...]:
    """Goals as they are written, for parameters of interest, the tilt and its expanded uncertainty:
    ``accel.bias=30ug``, ``accel.bias_x=30``, ``tilt=5arcsec``, ``U=0.01deg``.

    Args:
        texts: NAME=VALUE with or without a unit; without, it is that of the parameter, arcsec.
        model: with the parameters.

    Raises:
        TiltcalError: a text does not read, or no parameter of interest has that name.
    """
    named = list(zip(model.names, model.units, model.interest, strict=True))
    asked = parse_goals(texts)
    every = {key: [wanted for n, _, wanted in named if key in _keys(n)] for key in asked}
    for key in (key for key, wanted in every.items() if wanted and not any(wanted)):
        raise TiltcalError(
            f"goal {key}",
            found="a nuisance, which the design is not for",
            need="a parameter of interest",
            do="name its term in --terms",
        )
    units = {TILT: "arcsec", EXPANDED: "arcsec"} | {n: unit for n, unit, wanted in named if wanted}
    limits = limits_of(asked, units)
    return tuple(Goal(name, limits[name], units[name]) for name in units if name in limits)


def limits_of(
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
        kinds = list(dict.fromkeys(_kind(n) or n for n in units))
        more = f" ... ({len(kinds) - LISTED} more)" if len(kinds) > LISTED else ""
        near = nearest_of(key, known)
        raise TiltcalError(
            f"{subject} {key}",
            found="no such parameter",
            need="one that is determined" if near else f"{', '.join(kinds[:LISTED])}{more}",
            do=f"did you mean '{near}'?" if near else "correct it",
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
    every = (k for full in (name, _kind(name)) for k in (full, full.partition(".")[2]))
    return {key for key in every if key}


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
            do=f"state it in {unit}",
        )
    return number * stated.factor / own.factor


def least_time(
    budget: float, shortest: float, found_in: Callable[[float], tuple[float, Found]]
) -> Found:
    """What is found in the least time that reaches all goals; in all of the budget, where not even
    that does.

    Args:
        budget: longest time, s.
        shortest: a time in which nothing can be reached, s.
        found_in: of a time, the largest ratio of an uncertainty to its goal, and what was found; it
            raises TiltcalError where the time is too short for anything.

    Raises:
        TiltcalError: the budget is too short for anything.
    """
    ratio, best = found_in(budget)
    low, high = (np.log(shortest), np.inf), (np.log(budget), np.log(ratio))
    for trial in range(TRIALS):
        if high[1] > 0 or high[0] - low[0] <= np.log(NEAR):
            break
        time = (low[0] + high[0]) / 2 if trial % 3 == 2 else _next_trial(low, high)
        seconds = float(f"{np.exp(time):.4g}")  # as a plan states it
        time = float(np.log(seconds))
        try:
            ratio, found = found_in(seconds)
        except TiltcalError:
            ratio, found = np.inf, best
        if ratio <= 1:
            high, best = (time, np.log(ratio)), found
        else:
            low = time, np.log(ratio)
    return best


def _next_trial(low: tuple[float, float], high: tuple[float, float]) -> float:
    """Logarithm of the next time: where the ratio is expected to be one, and a little later, so
    that the goal is reached there; well inside.

    Args:
        low, high: logarithms of a too short and a sufficient time, and of their ratios.
    """
    edge = min(0.1 * (high[0] - low[0]), np.log(NEAR) / 2)
    if low[1] < np.inf:
        rate, first = (low[1] - high[1]) / (high[0] - low[0]), low[0] + edge
    else:  # nothing is known but the root of the time
        rate, first = 0.5, (low[0] + high[0]) / 2
    wanted = high[0] + high[1] / rate + np.log(NEAR) / 2
    return float(np.clip(wanted, first, high[0] - edge))
