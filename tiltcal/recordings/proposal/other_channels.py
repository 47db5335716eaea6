"""Temperatures, inclinometers, FOGs and labels among the columns of a foreign file."""

from collections.abc import Sequence

import numpy as np

from tiltcal.recordings.proposal.channels import Channel

Guess = tuple[Channel, str, str, float, float]
"""Column, name here, reason, scale, offset."""
_CELSIUS = (-80.0, 180.0)  # degC that an instrument may have
_UNITS = {"incl": ("deg", "rad", "arcsec"), "fog": ("deg_h", "deg_s", "rad_s")}
_KELVIN = 273.15
_FEW = 60  # distinct words of a column of labels


def find_others(channels: Sequence[Channel]) -> tuple[list[Guess], list[str]]:
    """Proposed channels by their names, and what cannot be known of them."""
    found: list[Guess] = []
    doubts: list[str] = []
    warm = [c for c in channels if c.numeric and c.meaning.role == "temperature"]
    if warm:
        guess, doubt = _temperature(warm[0])
        found += [guess] if guess else []
        doubts += [doubt] if doubt else []
    for c in channels:
        if not c.numeric or c.meaning.role not in ("incl", "fog"):
            continue
        axis = c.meaning.axis if c.meaning.role == "incl" else "a"
        right = (
            ("deg", "rad", "arcsec") if c.meaning.role == "incl" else ("deg_h", "deg_s", "rad_s")
        )
        if axis not in ("x", "y", "a") or any(
            f[1].startswith(f"{c.meaning.role}_{axis}") for f in found
        ):
            continue
        unit = c.unit if c.unit in right else "?"
        found.append((c, f"{c.meaning.role}_{axis}_{unit}", "its name", 1.0, 0.0))
        if unit == "?":
            doubts.append(f"{c.meaning.role}: the unit of {c.name}")
    return found, doubts


def _temperature(channel: Channel) -> tuple[Guess | None, str]:
    low, high = float(np.nanmin(channel.values)), float(np.nanmax(channel.values))
    said = f"its name; {low:.4g} to {high:.4g}"
    to = "temperature_degC"
    if channel.unit == "kelvin" or (not channel.unit and low > 200 and high < 400):
        return (channel, to, f"{said} is in kelvin", 1.0, -_KELVIN), ""
    if channel.unit == "degF":
        return (channel, to, f"{said} degF", 5 / 9, -32 * 5 / 9), ""
    if _CELSIUS[0] < low and high < _CELSIUS[1]:
        sure = channel.unit == "degC"
        doubt = "" if sure else f"{channel.name}: that it is in degC, which its values allow"
        return (channel, to, f"{said}{', the file says degC' if sure else ''}", 1.0, 0.0), doubt
    return None, f"{channel.name}: the unit; {low:.4g} to {high:.4g} is no temperature in degC"


def find_labels(channels: Sequence[Channel]) -> list[Guess]:
    """The column of the operator's words, if there is one."""
    for c in channels:
        if c.raw.dtype == object and c.meaning.role == "label":
            words = {t for t in c.raw if t is not None}
            if 0 < len(words) <= _FEW:
                return [(c, "label", f"its name; {len(words)} different words", 1.0, 0.0)]
    return []
