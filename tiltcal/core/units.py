"""Constants and units. SI and radians inside; the unit is part of the name at the border."""

import re
from dataclasses import dataclass
from math import pi

G0 = 9.80665  # m/s2, the unit g (CGPM 1901), not the local gravity
DEG = pi / 180
ARCSEC = pi / 648000
MM = 1e-3
DEG_H = DEG / 3600
EARTH_RATE = 7.292115e-5  # rad/s, WGS 84


@dataclass(frozen=True)
class Unit:
    """A unit as written in a name: its size in SI and what it measures."""

    factor: float
    quantity: str


def _table(quantity: str, **factors: float) -> dict[str, Unit]:
    return {name: Unit(factor, quantity) for name, factor in factors.items()}


COLUMN_UNITS: dict[str, Unit] = {
    **_table("time", s=1.0, ms=1e-3, us=1e-6, ns=1e-9),
    **_table("angle", rad=1.0, deg=DEG, arcsec=ARCSEC),
    **_table("acceleration", m_s2=1.0, g=G0, mg=1e-3 * G0, ug=1e-6 * G0),
    **_table("rate", rad_s=1.0, deg_s=DEG, deg_h=DEG_H),
    **_table("temperature", degC=1.0),
    **_table("length", m=1.0, mm=1e-3, um=1e-6),
    **_table("raw", V=1.0, mV=1e-3, mA=1e-3, LSB=1.0),
}
"""Units a column of a recording may end in (docs/interfaces.md, "Recordings")."""


def _parameter_units() -> dict[str, Unit]:
    units = dict(COLUMN_UNITS)
    units |= _table("ratio", unitless=1.0, ppm=1e-6, percent=1e-2)
    units |= _table("frequency", hz=1.0)
    units |= _table("mass", kg=1.0)
    units |= _table("first moment of mass", kg_mm=1e-3, kg_m=1.0)
    units |= {"": Unit(1.0, "count")} | _table("count", sigma=1.0)
    units |= _table("SI of the channel", si=1.0)
    for per, quantity in (("g2", "g/g2"), ("g3", "g/g3")):  # coefficients of powers of f in g
        units |= _table(quantity, **{f"ug_{per}": 1e-6, f"mg_{per}": 1e-3, f"g_{per}": 1.0})
    for name, unit in list(units.items()):
        if unit.quantity in {"angle", "acceleration", "rate", "ratio"}:
            units[f"{name}_degC"] = Unit(unit.factor, f"{unit.quantity}/degC")
    units |= _table("acceleration s/degC", ug_s_degC=1e-6 * G0, mg_s_degC=1e-3 * G0)
    units |= _table("rate s/degC", deg_h_s_degC=DEG_H, deg_s_s_degC=DEG)
    units |= _table("angle/g", arcsec_g=ARCSEC, deg_g=DEG, rad_g=1.0)
    units |= _table("rate/g", deg_h_g=DEG_H, deg_s_g=DEG, rad_s_g=1.0)
    units |= _table("rate/g2", deg_h_g2=DEG_H, deg_s_g2=DEG)
    units |= _table("angle/rad", arcsec_rad=ARCSEC)
    units |= _table("angle/moment", arcsec_N_m=ARCSEC)
    units |= _table("ratio/(rad/s)2", ppm_rad2_s2=1e-6)
    units |= _table("acceleration/(rad/s2)", ug_s2_rad=1e-6 * G0)
    # Allan coefficients: N such that sigma = N sqrt(sample rate) (two-sided density N^2), K per
    # square root of time
    units |= _table("acceleration/rtHz", ug_rthz=1e-6 * G0, mg_rthz=1e-3 * G0, m_s2_rthz=1.0)
    units |= _table("acceleration/rts", ug_rts=1e-6 * G0, m_s2_rts=1.0)
    units |= _table("angle/rts", deg_rth=DEG / 60, rad_rts=1.0, arcsec_rts=ARCSEC)
    units |= _table("angle/rtHz", arcsec_rthz=ARCSEC)
    units |= _table("time2", ms2=1e-6)
    units |= _table("rate/rts", deg_h_rth=DEG_H / 60, rad_s_rts=1.0)
    return units


PARAMETER_UNITS = _parameter_units()
"""Units a parameter of an effect may end in: those of columns and the compound ones."""


_READABLE = {"acceleration": "ug", "angle": "arcsec", "rate": "deg_h", "ratio": "ppm"}
_FINE = {"mg", "ug", "arcsec", "deg_h"}
_SI = {"1": "unitless"}


def readable_unit(unit: str, column: str | None = None) -> tuple[float, str]:
    """The unit in which a small quantity is shown, and the factor into it: the unit of the user's
    column where that is fine enough, else ug, arcsec, deg/h, ppm.

    Args:
        unit: of the value, such as m_s2, rad_s, 1 or m_s2_degC2; others are shown as they are.
        column: unit of the column that the value belongs to.
    """
    stem, per, power = unit.partition("_degC")
    base = PARAMETER_UNITS.get(_SI.get(stem, stem))
    if base is None or base.quantity not in _READABLE:
        return 1.0, unit
    own = COLUMN_UNITS.get(column or "")
    fine = own is not None and column in _FINE and own.quantity == base.quantity
    shown = column if fine and column else _READABLE[base.quantity]
    return base.factor / PARAMETER_UNITS[shown].factor, shown + per + power


UNIT_SIGNS = {
    "ug": "µg",
    "deg": "°",
    "deg_h": "°/h",
    "deg_s": "°/s",
    "degC": "°C",
    "m_s2": "m/s²",
    "unitless": "1",
    "ug_rthz": "µg/√Hz",
    "ug_rts": "µg/√s",
    "m_s2_rthz": "m/s²/√Hz",
    "m_s2_rts": "m/s²/√s",
    "rad_s": "rad/s",
    "deg_s2": "°/s²",
    "degC_s": "°C/s",
    "deg_rth": "°/√h",
    "deg_h_rth": "°/h/√h",
}


RAISED = str.maketrans("23", "²³")


def unit_sign(unit: str) -> str:
    """A unit as printed in a report: ``m_s2_degC1`` -> ``m/s²/°C``, ``ug_g3`` -> ``µg/g³``."""
    stem, per, power = unit.partition("_degC")
    text = UNIT_SIGNS.get(stem, "")
    if not text:
        first, *others = stem.split("_") if stem in PARAMETER_UNITS else [stem]
        text = "/".join([UNIT_SIGNS.get(first, first), *others]).translate(RAISED)
    if not per:
        return text
    return f"{text}/°C" + (power.translate(RAISED) if power not in {"", "1"} else "")


def signs_in(text: str) -> str:
    """A text with its units as printed: ``3 ug/g2`` -> ``3 µg/g²``."""
    pattern = r"\bug(?:/g[23]?)?\b|\bm/s2\b|\bdeg(?:/[hs])?\b"
    return re.sub(pattern, lambda found: unit_sign(found[0].replace("/", "_")), text)


def split_unit(name: str, units: dict[str, Unit] = COLUMN_UNITS) -> tuple[str, str | None]:
    """``accel_x_m_s2`` -> (``accel_x``, ``m_s2``): the unit is read from the right, longest match
    first.
    """
    matches = [unit for unit in units if name.endswith("_" + unit)]
    if not matches:
        return name, None
    unit = max(matches, key=len)
    return name[: -len(unit) - 1], unit
