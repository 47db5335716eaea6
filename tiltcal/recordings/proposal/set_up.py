"""Set-up proposed from a recording: table, mounting and sensors, each with a reason."""

from dataclasses import dataclass, field, replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import COLUMN_UNITS, split_unit
from tiltcal.recordings.proposal.channels import meaning_of
from tiltcal.recordings.proposal.gravity import NORMS, sphere_through, unit_by_norm
from tiltcal.recordings.proposal.rests import windows_of
from tiltcal.recordings.proposal.turning import follow, unit_of_gyro
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.rig_fit import (
    CLEARLY_WORSE,
    FITS,
    RigFit,
    read_poses,
    rig_fits,
    simplest,
)
from tiltcal.recordings.table_columns import tables_of
from tiltcal.setup.sensor import RESERVED
from tiltcal.setup.setup import Rig, Setup
from tiltcal.setup.tables import HANDHELD

KINDS = {
    "acceleration": "accelerometer",
    "angle": "inclinometer",
    "rate": "gyro",
    "raw": "accelerometer",
}  # sensor kind by quantity of the unit
BY_NAME = {"gyro": "gyro", "incl": "inclinometer", "accel": "accelerometer"}
"""Kind of a sensor of raw readings by what its name says."""
SHOWN = 3  # other rigs that gravity does not exclude


@dataclass(frozen=True)
class SensorGuess:
    """A sensor that the columns name.

    Args:
        name, kind, axes, unit: of its columns.
        rate_hz: of its samples.
        reason: why it is of that kind.
        zero, per_m_s2: of counts, where gravity at rest shows them: (3,), counts per m/s2.
        doubts: what the numbers contradict or leave open.
    """

    name: str
    kind: str
    axes: tuple[str, ...]
    unit: str
    rate_hz: float
    reason: str
    zero: tuple[float, ...] = ()
    per_m_s2: float = 0.0
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True)
class RigGuess:
    """The table and the mounting.

    Args:
        table, mount: as ``[rig]`` states them.
        reason: why.
        doubts: what the recording leaves open or contradicts.
    """

    table: str
    mount: str
    reason: str
    doubts: tuple[str, ...] = field(default=())


def sensors_of(recording: Recording, gravity: float) -> list[SensorGuess]:
    """The sensors that the columns name, checked by their numbers.

    Args:
        recording: whose sensors are proposed.
        gravity: of the site, m/s2.
    """
    found = [_sensor(recording, n, axes, unit) for n, (axes, unit) in _columns(recording).items()]
    return [_checked(recording, guess, found, gravity) for guess in found]


def _columns(recording: Recording) -> dict[str, tuple[list[str], str]]:
    """Axes and unit of each sensor that the columns name."""
    found: dict[str, tuple[list[str], str]] = {}
    for column in recording.column_names:
        channel, unit = split_unit(column)
        name, _, axis = channel.rpartition("_")
        quantity = COLUMN_UNITS[unit].quantity if unit else ""
        valid = name.isascii() and name.isalnum() and name[0].isalpha() and name not in RESERVED
        axes = ("x", "y") if quantity == "angle" else ("x", "y", "z", "a")
        if valid and quantity in KINDS and axis in axes:
            found.setdefault(name, ([], str(unit)))[0].append(axis)
    return found


def _sensor(recording: Recording, name: str, axes: list[str], unit: str) -> SensorGuess:
    quantity = COLUMN_UNITS[unit].quantity
    kind = "fog" if axes == ["a"] else KINDS[quantity]
    role = meaning_of(f"{name}_{axes[0]}").role
    if quantity == "raw" and role in BY_NAME:
        kind = BY_NAME[role]
    sampled = recording.time[np.isfinite(recording.column(f"{name}_{axes[0]}_{unit}"))]
    steps = np.diff(sampled)
    onward = steps[steps > 0]
    rate = 1 / float(np.median(onward)) if len(onward) else 1.0
    reason = "one axis a" if kind == "fog" else f"its columns are in {unit}"
    if quantity == "raw":
        reason = f"its name; {reason}" if role in BY_NAME else reason
    return SensorGuess(name, kind, tuple(axes), unit, rate, reason)


def _checked(
    recording: Recording, guess: SensorGuess, others: list[SensorGuess], gravity: float
) -> SensorGuess:
    if len(guess.axes) != 3:
        return guess
    if guess.kind == "accelerometer":
        return _accelerometer(recording, guess, gravity)
    triads = [s for s in others if s.kind == "accelerometer" and len(s.axes) == 3]
    return _gyro(recording, guess, triads[0]) if guess.kind == "gyro" and triads else guess


def _values(recording: Recording, guess: SensorGuess) -> Array:
    """Its columns as they stand, (n, k)."""
    return np.column_stack([recording.column(f"{guess.name}_{a}_{guess.unit}") for a in guess.axes])


def _accelerometer(recording: Recording, guess: SensorGuess, gravity: float) -> SensorGuess:
    """The unit by gravity at rest; of counts, their zero and scale."""
    windows = windows_of(_values(recording, guess), guess.rate_hz)
    if guess.unit in NORMS:
        seen = unit_by_norm(windows, guess.unit, False)
        doubts = (seen.doubt,) if seen.doubt else ()
        return replace(
            guess, reason=f"{guess.reason}; {seen.reason or 'gravity contradicts'}", doubts=doubts
        )
    sphere = None if windows is None else sphere_through(windows.at_rest)
    if sphere is None:
        doubt = f"zero and scale of {guess.name}: its dwell means lie on no sphere; fill in `input`"
        return replace(guess, doubts=(doubt,))
    centre, radius = sphere
    reason = f"its standstill means lie on a sphere of {radius:.5g} {guess.unit}, which is gravity"
    zero = tuple(float(x) for x in centre)
    return replace(guess, reason=reason, zero=zero, per_m_s2=radius / gravity)


def _gyro(recording: Recording, guess: SensorGuess, triad: SensorGuess) -> SensorGuess:
    """The unit by how gravity turns in the accelerometer next to it."""
    force, rates = _values(recording, triad), _values(recording, guess)
    turning = follow(force, rates, guess.rate_hz)
    largest = float(np.nanmax(np.abs(rates - np.nanmedian(rates, axis=0))))
    seen = unit_of_gyro(turning, guess.rate_hz, largest, guess.unit, False)
    doubts = (f"{guess.name}: {seen.doubt}",) if seen.doubt else ()
    return replace(
        guess, reason=f"{guess.reason}; {seen.reason or 'gravity contradicts'}", doubts=doubts
    )


def rig_of(recording: Recording, setup: Setup | None) -> RigGuess:
    """The table and the mounting.

    Args:
        recording: whose table is proposed.
        setup: sensors, on any table; None where there is no sensor.
    """
    possible = tables_of(recording)
    stated = recording.metadata.get("mount", "").partition(";")[0].strip()
    mount = stated or "identity"
    if not possible:
        return RigGuess(HANDHELD.name, mount, "the recording reads no table angle")
    poses = read_poses(recording, setup) if setup else None
    names = " or ".join(t.name for t in possible)
    if poses is None:
        doubt = () if len(possible) == 1 else (f"table: the columns fit {names}",)
        return RigGuess(possible[0].name, mount, "its columns have the axes of this table", doubt)
    fits = rig_fits(*poses)
    return _by_gravity([f for f in fits if f.misfit < FITS], fits[0], mount, bool(stated))


def _by_gravity(fits: list[RigFit], best: RigFit, mount: str, stated: bool) -> RigGuess:
    if not fits:
        off = f"{best.misfit:.2g} rad"
        doubt = f"table and mount: gravity follows no table with these axes (best {off})"
        return RigGuess(best.table.name, mount, "its columns have the axes of this table", (doubt,))
    alike = [
        f for f in fits if f.misfit < max(CLEARLY_WORSE * fits[0].misfit, FITS / CLEARLY_WORSE)
    ]
    chosen = min(alike, key=lambda f: (stated and f.mount != mount, _turned(f), f.mount != mount))
    rig = Rig(table=chosen.table.name, mount=chosen.mount)
    others = simplest([f for f in alike if f is not chosen], rig)[:SHOWN]
    reason = f"gravity follows the table angles within {chosen.misfit:.2g} rad"
    doubts = (f"the same gravity is read if you {'; or '.join(others)}",) if others else ()
    return RigGuess(chosen.table.name, chosen.mount, reason, (*_senses(chosen), *doubts))


def _turned(fit: RigFit) -> int:
    return sum(sense < 0 for sense in fit.senses)


def _senses(fit: RigFit) -> tuple[str, ...]:
    pairs = zip(fit.table.axis_names, fit.senses, strict=True)
    return tuple(
        f"the {name} angle counts the other way: write the recording with its sign changed"
        for name, sense in pairs
        if sense < 0
    )
