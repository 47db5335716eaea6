"""Sensors among the columns of a foreign file, with their units: triads of accelerometers and
gyros, inclinometers, FOGs, temperatures, and labels.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.recordings.proposal.channels import Channel
from tiltcal.recordings.proposal.gravity import (
    NORMS,
    UnitGuess,
    norm_at_rest,
    sphere_through,
    unit_by_norm,
)
from tiltcal.recordings.proposal.rests import Windows, apart, is_measured, moves, windows_of
from tiltcal.recordings.proposal.turning import Turning, follow, unit_of_gyro

_FOREIGN = ("deg", "rad", "arcsec", "degC", "kelvin", "degF", "s", "ms", "us", "ns", "other")
"""Units that no triad of accelerometers or gyros has."""
_FREE = 0.05  # of gravity: a smaller norm at rest is none
_NAMED = ("accel", "gyro", "magnetometer", "free")
_EVEN = 0.12  # relative spread of the norm of gravity over the standstills
# of standstill means that depend on the attitude; that are all alike
_ATTITUDE, _ALIKE = 0.25, 0.05


@dataclass(frozen=True, eq=False)
class Triad:
    """Three columns of one sensor.

    Args:
        kind: accel, gyro or magnetometer; empty where it cannot be known.
        channels: in the order of its axes.
        reason: why it is that sensor.
        axes_known: whether their names state the axes.
    """

    kind: str
    channels: tuple[Channel, ...]
    reason: str
    axes_known: bool
    windows: Windows | None

    @property
    def values(self) -> Array:
        """(n, 3)."""
        return np.column_stack([c.values for c in self.channels])

    @property
    def stated(self) -> str:
        """The unit that the file states for all three; empty where it does not."""
        units = {c.unit for c in self.channels}
        return units.pop() if len(units) == 1 else ""

    @property
    def whole(self) -> bool:
        """Whether all readings are whole numbers."""
        return all(c.whole for c in self.channels)


@dataclass(frozen=True)
class Sensor:
    """A triad with its name here and its unit."""

    name: str
    triad: Triad
    unit: UnitGuess


def find_triads(channels: Sequence[Channel], rate: float | None) -> list[Triad]:
    """The triads among the channels of one table that are no time.

    Args:
        channels: of the file.
        rate: of samples, Hz; None where it is not known.
    """
    named = _named(channels, rate)
    taken = {id(c) for t in named for c in t.channels}
    remaining = [c for c in channels if id(c) not in taken and c.numeric and c.meaning.role == ""]
    remaining = [c for c in remaining if c.unit not in _FOREIGN]
    by_axis = _axes_only(remaining, rate)
    taken |= {id(c) for t in by_axis for c in t.channels}
    unnamed = _unnamed([c for c in remaining if id(c) not in taken], rate)
    return _borne_out(named, _only_one_gravity(by_axis + unnamed), rate)


def _borne_out(named: Sequence[Triad], seen: Sequence[Triad], rate: float | None) -> list[Triad]:
    """All triads; of those without an informative name the kind is kept where their numbers bear it
    out: gravity in a unit or on a sphere, and rates that gravity follows.
    """
    accel = [t for t in (*named, *seen) if t.kind == "accel"]
    kept = []
    for t in seen:
        beside = [a for a in accel if len(a.values) == len(t.values)]
        if t.kind == "accel":
            good = unit_by_norm(t.windows, "", t.whole).unit not in ("", "LSB")
            good = good or (t.whole and _like_gravity(t))
        elif t.kind == "gyro" and (beside or not t.whole):
            turnings = [_turning(a, t, rate) for a in beside]
            # without enough motion counts are what their standstills say
            still = t.whole and not any(turn is not None and turn.enough for turn in turnings)
            good = still or any(turn is not None and turn.fits for turn in turnings)
        else:
            good = True
        kept.append(t if good else replace(t, kind=""))
    return [*named, *kept]


def _like_gravity(triad: Triad) -> bool:
    """Whether the standstill means of counts lie on a sphere, or keep their norm."""
    if triad.windows is None:
        return False
    even = norm_at_rest(triad.windows)[1] < _EVEN and moves(triad.windows)
    return even or sphere_through(triad.windows.at_rest) is not None


def _axes_only(channels: Sequence[Channel], rate: float | None) -> list[Triad]:
    """Columns whose names state their axes and nothing else, by their behaviour."""
    groups: dict[str, dict[str, Channel]] = {}
    for c in channels:
        if c.meaning.axis:
            groups.setdefault(c.meaning.group, {}).setdefault(c.meaning.axis, c)
    found = []
    for axes in groups.values():
        if len(axes) == 3:
            three = tuple(axes[a] for a in "xyz")
            windows = _together(three, rate)
            kind, reason = _kind(windows) if windows is not None else ("", "")
            if kind:
                found.append(
                    Triad(kind, three, reason.replace("neighbours", "axes"), True, windows)
                )
    return found


def _named(channels: Sequence[Channel], rate: float | None) -> list[Triad]:
    groups: dict[tuple[str, str], dict[str, Channel]] = {}
    for c in channels:
        if c.numeric and c.meaning.axis and c.meaning.role in _NAMED:
            groups.setdefault((c.meaning.role, c.meaning.group), {}).setdefault(c.meaning.axis, c)
    found = []
    for (role, _), axes in groups.items():
        if len(axes) == 3:
            three = tuple(axes[a] for a in "xyz")
            values = np.column_stack([c.values for c in three])
            triad = Triad(role, three, "its name", True, windows_of(values, rate))
            found += [triad] if role != "free" else _with_gravity(triad)
    return found


def _with_gravity(triad: Triad) -> list[Triad]:
    """An accelerometer, if columns that are named free of gravity hold it."""
    seen = unit_by_norm(triad.windows, triad.stated, triad.whole)
    if seen.unit not in NORMS or not is_measured(triad.values):
        return []
    return [replace(triad, kind="accel", reason="its norm at rest is gravity, whatever its name")]


def _together(three: Sequence[Channel], rate: float | None) -> Windows | None:
    """The windows of three columns that were sampled in the same rows, and measured."""
    values = np.column_stack([c.values for c in three])
    known = np.isfinite(values)
    together = bool(np.all(known.all(axis=1) == known.any(axis=1)))
    return windows_of(values, rate) if together and is_measured(values) else None


def _unnamed(channels: Sequence[Channel], rate: float | None) -> list[Triad]:
    """Neighbouring columns that behave as the axes of one sensor."""
    found: list[Triad] = []
    k = 0
    while k + 3 <= len(channels):
        three = tuple(channels[k : k + 3])
        windows = _together(three, rate)
        kind, reason = _kind(windows) if windows is not None else ("", "")
        if kind:
            found.append(Triad(kind, three, reason, False, windows))
            k += 3
        else:
            k += 1
    return found


def _kind(windows: Windows) -> tuple[str, str]:
    """accel or gyro, by the means at standstill."""
    norm, spread = norm_at_rest(windows)
    share = apart(windows)
    by_norm = unit_by_norm(windows, "", False).unit
    if by_norm and spread < _EVEN and norm > 20 * windows.noise:
        return "accel", f"three neighbours whose norm at rest is even, {norm:.4g}"
    if not moves(windows):
        return "", ""
    if share > _ATTITUDE:
        return (
            "accel",
            "three neighbours whose standstill means depend on the attitude, as gravity does",
        )
    if share < _ALIKE:
        return "gyro", "three neighbours that read the same at every standstill, and differ between"
    return "", ""


def _only_one_gravity(found: list[Triad]) -> list[Triad]:
    """A second triad with an even norm may be a magnetometer: those that read 9.8 are not, and of
    others none is known.
    """
    gravity = [t for t in found if t.kind == "accel"]
    if len(gravity) < 2:
        return found
    sure = [t for t in gravity if unit_by_norm(t.windows, "", t.whole).unit == "m_s2"]
    return [replace(t, kind="") if t in gravity and t not in sure else t for t in found]


def _without_free(triads: Sequence[Triad]) -> list[Triad]:
    """Without accelerations free of gravity, where another triad includes it."""
    triads = [t for t in triads if t.kind != "accel" or not _is_free(t)]
    accel = [t for t in triads if t.kind == "accel"]
    holding = [t for t in accel if t.stated or unit_by_norm(t.windows, "", t.whole).unit]
    return [t for t in triads if t.kind != "accel" or t in holding or not holding]


def _is_free(triad: Triad) -> bool:
    """Whether the norm at rest of an accelerometer in a unit is far below gravity."""
    if triad.windows is None or triad.whole:
        return False
    gravity = NORMS.get(triad.stated, min(NORMS.values()))
    return norm_at_rest(triad.windows)[0] < _FREE * gravity


def with_units(triads: Sequence[Triad], rates: Mapping[str, float | None]) -> list[Sensor]:
    """Accelerometers and gyros with names and units.

    Args:
        triads: of all tables.
        rates: table -> samples a second.
    """
    found: list[Sensor] = []
    count: dict[str, int] = {}
    for triad in _without_free(triads):
        if triad.kind not in ("accel", "gyro"):
            continue
        count[triad.kind] = count.get(triad.kind, 0) + 1
        number = count[triad.kind]
        name = triad.kind + (str(number) if number > 1 else "")
        rate = rates.get(triad.channels[0].table)
        if triad.kind == "accel":
            unit = unit_by_norm(triad.windows, triad.stated, triad.whole)
        else:
            accelerometer = _accelerometer_of(triad, triads, number)
            turning = None if accelerometer is None else _turning(accelerometer, triad, rate)
            unit = unit_of_gyro(turning, rate, _largest(triad), triad.stated, triad.whole)
        found.append(Sensor(name, triad, unit))
    return found


def _accelerometer_of(gyro: Triad, triads: Sequence[Triad], number: int) -> Triad | None:
    """The accelerometer of the same table as a gyro whose readings have one norm at rest."""
    there = [t for t in triads if t.kind == "accel" and len(t.values) == len(gyro.values)]
    even = [t for t in there if t.windows is not None and norm_at_rest(t.windows)[1] < _EVEN]
    return even[min(number, len(even)) - 1] if even else None


def _turning(accelerometer: Triad, gyro: Triad, rate: float | None) -> Turning | None:
    return follow(accelerometer.values, gyro.values, rate)


def _largest(triad: Triad) -> float:
    values = triad.values
    middle = np.nanmedian(values, axis=0)
    return float(np.nanmax(np.abs(values - middle)))


Guess = tuple[Channel, str, str, float, float]
"""Column, name here, reason, scale, offset."""
_CELSIUS = (-80.0, 180.0)  # degC that an instrument may have
_UNITS = {"incl": ("deg", "rad", "arcsec"), "fog": ("deg_h", "deg_s", "rad_s")}
_KELVIN = 273.15
_FEW = 60  # distinct texts of a column of labels


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
    reason = f"its name; {low:.4g} to {high:.4g}"
    to = "temperature_degC"
    if channel.unit == "kelvin" or (not channel.unit and low > 200 and high < 400):
        return (channel, to, f"{reason} is in kelvin", 1.0, -_KELVIN), ""
    if channel.unit == "degF":
        return (channel, to, f"{reason} degF", 5 / 9, -32 * 5 / 9), ""
    if _CELSIUS[0] < low and high < _CELSIUS[1]:
        sure = channel.unit == "degC"
        doubt = "" if sure else f"{channel.name}: that it is in degC, which its values allow"
        return (channel, to, f"{reason}{', the file states degC' if sure else ''}", 1.0, 0.0), doubt
    return None, f"{channel.name}: the unit; {low:.4g} to {high:.4g} is no temperature in degC"


def find_labels(channels: Sequence[Channel]) -> list[Guess]:
    """The column of the operator's labels, if there is one."""
    for c in channels:
        if c.raw.dtype == object and c.meaning.role == "label":
            labels = {t for t in c.raw if t is not None}
            if 0 < len(labels) <= _FEW:
                return [(c, "label", f"its name; {len(labels)} different labels", 1.0, 0.0)]
    return []
