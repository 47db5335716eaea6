"""Units of parameters in D-SI, the form that digital certificates use: SI without prefixes."""

import re
from dataclasses import dataclass

from tiltcal.core.units import G0, PARAMETER_UNITS

_TEMPERATURE = re.compile(r"^(?P<unit>.+)_degC(?P<power>\d*)$")
_DIMENSIONS: dict[str, dict[str, int]] = {
    "ratio": {},
    "time": {"second": 1},
    "length": {"metre": 1},
    "frequency": {"hertz": 1},
    "angle": {"radian": 1},
    "rate": {"radian": 1, "second": -1},
    "acceleration": {"metre": 1, "second": -2},
    "temperature": {"degreecelsius": 1},
    # coefficients of powers of the specific force: their unit g is divided out
    "g/g2": {"metre": -1, "second": 2},
    "g/g3": {"metre": -2, "second": 4},
    "angle/g": {"radian": 1, "metre": -1, "second": 2},
    "rate/g": {"radian": 1, "metre": -1, "second": 1},
    "rate/g2": {"radian": 1, "metre": -2, "second": 3},
}
_PER_G = {"g/g2": G0, "g/g3": G0**2, "angle/g": G0, "rate/g": G0, "rate/g2": G0**2}


@dataclass(frozen=True)
class SiUnit:
    r"""A unit of ours in SI.

    Args:
        factor: SI value of one of it.
        text: D-SI, such as ``\metre\second\tothe{-2}``.
    """

    factor: float
    text: str


def si_unit(unit: str) -> SiUnit | None:
    """The D-SI form of a parameter's unit, such as ``m_s2``, ``1``, ``ug_g2`` or ``m_s2_degC2``.

    None where it has none, or is not known.
    """
    name = {"1": "unitless"}.get(unit, unit)
    known = PARAMETER_UNITS.get(name)
    if known is not None and known.quantity in _DIMENSIONS:
        factor = known.factor / _PER_G.get(known.quantity, 1.0)
        return SiUnit(factor, _text(_DIMENSIONS[known.quantity]))
    match = _TEMPERATURE.match(unit)
    if match is None:
        return None
    per = si_unit(match["unit"])
    if per is None:
        return None
    power = int(match["power"] or 1)
    kelvin = f"\\kelvin\\tothe{{-{power}}}"
    return SiUnit(per.factor, kelvin if per.text == "\\one" else per.text + kelvin)


def _text(powers: dict[str, int]) -> str:
    parts = [f"\\{u}" if p == 1 else f"\\{u}\\tothe{{{p}}}" for u, p in powers.items()]
    return "".join(parts) or "\\one"
