"""Units as people write them, and the units of recordings."""

import re

_KNOWN = {
    "m_s2": "m/s2 m/s^2 m/s**2 m/s/s ms-2 m.s-2 m*s-2 mps2 m_s2 m/sec2 m/sec^2 meter/s2 m/s²",
    "g": "g gn g0 gee gs",
    "mg": "mg milli-g millig mgn",
    "ug": "ug µg micro-g",
    "rad_s": "rad/s rad/sec rads rad.s-1 rad*s-1 rad_s rad_per_s rps radps",
    "deg_s": "deg/s deg/sec dps °/s degree/s degrees/s deg_s º/s deg.s-1",
    "deg_h": "deg/h °/h deg/hr dph deg_h",
    "rad": "rad radian radians",
    "deg": "deg degree degrees °",
    "arcsec": "arcsec arcsecond arcseconds",
    "degC": "degc °c celsius deg_c ℃ deg.c",
    "kelvin": "k kelvin",
    "degF": "degf °f fahrenheit",
    "s": "s sec second seconds secs 秒",
    "ms": "ms msec millisecond milliseconds 毫秒",
    "us": "us µs usec microsecond microseconds",
    "ns": "ns nsec nanosecond nanoseconds",
    "V": "v volt volts",
    "mV": "mv millivolt",
    "mA": "ma milliampere",
    "LSB": "lsb count counts digit digits raw adc",
    "gal": "gal cm/s2 cm/s^2",
    "other": "ut µt mgauss gauss hpa mbar pa kpa % mt nt t",
}
_BY_SPELLING = {
    spelling: unit for unit, spellings in _KNOWN.items() for spelling in spellings.split()
}
_BRACKETS = re.compile(r"[\[(<{]\s*([^\])>}]*?)\s*[\])>}]")
_TAILS = (
    "rad_per_s",
    "m_s2",
    "rad_s",
    "deg_s",
    "deg_h",
    "mps2",
    "dps",
    "degc",
    "lsb",
    "raw",
    "usec",
    "msec",
    "nsec",
    "sec",
    "deg",
    "rad",
    "mg",
    "ms",
    "us",
    "ns",
    "g",
    "s",
)


def unit_of(text: str) -> str | None:
    """The unit that a text states: one of a recording's, ``kelvin``, ``degF``, ``gal`` or
    ``other``; None where it states none.
    """
    text = text.strip().strip("[](){}<>\"'").strip()
    text = text.replace("μ", "µ").replace("²", "2").replace("·", ".").replace(" ", "")
    if text in ("G", "Mg"):
        return None
    return _BY_SPELLING.get(text.lower())


def stated_unit(name: str) -> str | None:
    """The unit that the name of a column states: in brackets, or as its last part."""
    bracketed = _BRACKETS.findall(name)
    for text in bracketed:
        unit = unit_of(text)
        if unit is not None:
            return unit
    lower = name.lower().rstrip("_")
    for tail in _TAILS:
        if lower.endswith(("_" + tail, " " + tail, "." + tail)):
            return unit_of(tail.replace("_per_", "/").replace("m_s2", "m/s2"))
    return None


def bare_name(name: str) -> str:
    """The name of a column without a unit in brackets."""
    return _BRACKETS.sub(lambda m: m[0] if m[1].isdigit() else "", name).strip()
