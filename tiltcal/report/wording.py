"""Mountings and times of a recording in words."""

import re
from datetime import UTC, datetime

FACTOR = re.compile(r"R([xyz])\(([^)]*)\)")
CALENDAR = (datetime(1990, 1, 1, tzinfo=UTC), datetime(2100, 1, 1, tzinfo=UTC))
"""Stamps between these, as seconds since 1970, are times of the calendar."""


def duration(seconds: float) -> str:
    """``754.6`` -> ``12 min 34.6 s``; seconds: s."""
    minutes, rest = divmod(round(seconds, 1), 60)
    hours, minutes = divmod(int(minutes), 60)
    parts = [f"{hours} h"] * bool(hours) + [f"{minutes} min"] * bool(hours or minutes)
    return " ".join([*parts, f"{rest:.1f} s"])


def moment(stamp: float) -> str | None:
    """A stamp as a time of the calendar; None where it is none. stamp: s."""
    first, last = (edge.timestamp() for edge in CALENDAR)
    if not first <= stamp <= last:
        return None
    return f"{datetime.fromtimestamp(stamp, UTC):%Y-%m-%d %H:%M:%S} UTC"


def period(start: float, end: float) -> str:
    """When a measurement was made, and how long it took. start, end: s."""
    began = moment(start)
    return f"{f'from {began}, ' if began else ''}{duration(end - start)}"


def mounting(text: str, start: float) -> str:
    """``identity; 350 s: Rz(180)`` in words; times count from ``start``, s."""
    found = []
    for part in text.split(";"):
        when, colon, turns = part.rpartition(":")
        factors = FACTOR.findall(turns)
        words = " and ".join(f"turned by {angle.strip()}° about {axis}" for axis, angle in factors)
        words = words or "axes along those of the table"
        if colon:
            after = float(when.strip().removesuffix("s")) - start
            words = f"from {duration(after)} on {words}"
        found.append(words)
    return "; ".join(found)
