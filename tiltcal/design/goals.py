"""Goals of a sequence, and the least table time in which a design reaches them.

A standard uncertainty falls with the root of the time while the poses stay the same, so that each
trial is made where the last two, on logarithmic scales, put the goal; every third halves what is
left.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from tiltcal.core.errors import TiltcalError, nearest
from tiltcal.core.units import PARAMETER_UNITS
from tiltcal.design.model import Model
from tiltcal.design.plan import Forecast

TILT = "tilt"  # rms error per axis over the working range
EXPANDED = "U"  # twice that: coverage of 95 % (GUM, 6.2)
COVERAGE = 2.0
NEAR = 1.03  # a time that is no longer than this times a known too short one is the least: a
# sigma differs by half of that
TRIALS = 12
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
    """Goals as they are written: ``accel.bias=30ug`` for all parameters whose name begins so,
    ``accel.bias_x=30``, ``tilt=5arcsec``, ``U=0.01deg``.

    Args:
        texts: NAME=VALUE with or without a unit; without, it is that of the parameter, arcsec.
        model: with the parameters.

    Raises:
        TiltcalError: a text does not read, or no parameter of interest has that name.
    """
    return tuple(goal for text in texts for goal in _goals(text, model))


def _goals(text: str, model: Model) -> list[Goal]:
    name, _, rest = text.partition("=")
    value, unit = _value(text, rest)
    wanted = [n for n, inside in zip(model.names, model.interest, strict=True) if inside]
    named = {TILT: "arcsec", EXPANDED: "arcsec"} | dict(zip(model.names, model.units, strict=True))
    found = [n for n in (TILT, EXPANDED, *wanted) if n == name or n.startswith(f"{name}_")]
    if not found:
        raise TiltcalError(
            f"goal {text}",
            found=f"no parameter of interest {name}",
            need=f"the name of a parameter, {TILT} or {EXPANDED}",
            do=nearest(name, [TILT, EXPANDED, *wanted]),
        )
    return [Goal(n, _converted(text, value, unit, named[n]), named[n]) for n in found]


def _value(text: str, rest: str) -> tuple[float, str]:
    """Number and unit, as they are written."""
    read = re.fullmatch(r"\s*([0-9.]+(?:[eE][-+]?[0-9]+)?)\s*([A-Za-z]\w*)?\s*", rest)
    try:
        value = float(read[1]) if read else 0.0
    except ValueError:
        value = 0.0
    if read is None or not 0 < value < np.inf:
        raise TiltcalError(
            f"goal {text}",
            found="no NAME=VALUE with a value above zero",
            need=f"a goal such as accel.bias=30ug or {TILT}=5arcsec",
            do="correct it",
        )
    return value, read[2] or ""


def _converted(text: str, value: float, given: str, unit: str) -> float:
    """A value in the unit of its parameter."""
    if given in ("", unit):
        return value
    theirs, ours = PARAMETER_UNITS.get(given), PARAMETER_UNITS.get(unit)
    if theirs is None or ours is None or theirs.quantity != ours.quantity:
        raise TiltcalError(
            f"goal {text}",
            found=f"unit {given}",
            need=f"{unit}, or another unit of the same quantity",
            do="convert it",
        )
    return value * theirs.factor / ours.factor


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
        try:
            ratio, found = found_in(float(np.exp(time)))
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
