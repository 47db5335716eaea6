"""Which table turned the instrument: from which angle moves which channel."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import COLUMN_UNITS
from tiltcal.recordings.proposal.channels import Channel
from tiltcal.recordings.proposal.pairs import is_readout
from tiltcal.recordings.proposal.rests import Windows, filled
from tiltcal.recordings.rig_fit import up_in_head
from tiltcal.setup.tables import BUILT_IN, Table

_FITS = 0.05  # rms of the direction of gravity, rad
_CLEAR = 3.0  # times worse than the best is clearly worse
_POSES = 4  # distinct ones that it takes
_STILL = 0.02  # rms change of the direction of gravity, rad, that is none
_SENSE = "the sense of an axis: gravity turns as if one angle had the other sign"
_HALF_TURN = 4.0  # a larger reading is not in radians


@dataclass(frozen=True)
class TableGuess:
    """The table.

    Args:
        table: its name; empty where it cannot be known.
        axes: column name -> axis of the table; empty where it cannot be known.
        unit: of the angles.
        reason: why.
        doubt: what cannot be known, empty where all is.
    """

    table: str
    axes: Mapping[str, str]
    unit: str
    reason: str
    doubt: str = ""


@dataclass(frozen=True)
class _Fit:
    table: Table
    order: tuple[int, ...]
    unit: str
    straight: float
    mirrored: float

    @property
    def misfit(self) -> float:
        """Rms of the direction of gravity, rad, whatever the handedness of the axes."""
        return min(self.straight, self.mirrored)


def find_table(
    angles: Sequence[Channel], force: Array | None, windows: Windows | None
) -> TableGuess:
    """The table that has these angles.

    Args:
        angles: the columns that may be its readout, of the rows of ``force``.
        force: readings of an accelerometer triad without large offsets, any unit, (n, 3).
        windows: of ``force``.
    """
    units = _units(angles)
    named = {
        c.name: c.meaning.role for c in angles if c.meaning.role in ("outer", "middle", "inner")
    }
    if force is None or windows is None:
        return _by_names(angles, named, units, "no accelerometer shows what they turn")
    directions, readings = _poses(angles, force, windows)
    if len(directions) < _POSES:
        return _by_names(angles, named, units, "too few poses at rest")
    turned = float(np.sqrt(np.mean(np.sum((directions - directions.mean(axis=0)) ** 2, axis=1))))
    if len(angles) == 1 and turned < _STILL and np.ptp(readings[:, 0]) > 1:
        return TableGuess(
            "vertical",
            {angles[0].name: "outer"},
            units[0] if len(units) == 1 else "",
            "it turns, and the direction of gravity stays",
            "" if len(units) == 1 else f"the unit of {angles[0].name}",
        )
    fits = sorted(_fits(directions, readings, units, len(angles)), key=lambda f: f.misfit)
    return _judged(fits, angles, named, units)


def _units(angles: Sequence[Channel]) -> list[str]:
    """The units that the angles may be in."""
    stated = {c.unit for c in angles if c.unit in ("deg", "rad", "arcsec")}
    if len(stated) == 1:
        return [stated.pop()]
    largest = max((float(np.nanmax(np.abs(c.values))) for c in angles), default=0.0)
    return ["deg"] if largest > 2 * _HALF_TURN else ["deg", "rad"]


def _poses(angles: Sequence[Channel], force: Array, windows: Windows) -> tuple[Array, Array]:
    """Directions of gravity, (m, 3), and readings, (m, k), of the windows at rest."""
    size, count = windows.size, len(force) // windows.size
    read = filled(np.column_stack([c.values for c in angles]))
    f = filled(force)[: count * size].reshape(count, size, 3)
    a = read[: count * size].reshape(count, size, -1)
    still = np.isfinite(a).all(axis=(1, 2)) & (np.ptp(a, axis=1).max(axis=1) < 1e-2 * _range(read))
    spread = np.sqrt(f.var(axis=1).sum(axis=1))
    still &= spread <= 4 * max(windows.noise, 1e-12) * np.sqrt(3)
    mean = f[still].mean(axis=1)
    readings = a[still].mean(axis=1)
    unit = mean / np.linalg.norm(mean, axis=1)[:, None]
    _, first = np.unique(np.round(readings, 1), axis=0, return_index=True)
    return unit[first], readings[first]


def _range(read: Array) -> float:
    return float(np.nanmax(read) - np.nanmin(read)) or 1.0


def _fits(directions: Array, readings: Array, units: Sequence[str], count: int) -> list[_Fit]:
    found = []
    for table in BUILT_IN.values():
        if len(table.axes) != count or not table.tilting:
            continue
        for order in permutations(range(count)):
            for unit in units:
                radians = readings[:, list(order)] * COLUMN_UNITS[unit].factor
                up = up_in_head(table, radians)
                found.append(_Fit(table, order, unit, *_misfits(directions, up)))
    return found


def _misfits(seen: Array, up: Array) -> tuple[float, float]:
    """Rms of ``seen`` from the best rotation of ``up``, rad, and with mirrored axes."""
    U, _, Vt = np.linalg.svd(seen.T @ up)
    sign = np.sign(np.linalg.det(U @ Vt))
    found = []
    for last in (sign, -sign):
        R = U @ np.diag([1.0, 1.0, last]) @ Vt
        found.append(float(np.sqrt(np.mean(np.sum((seen - up @ R.T) ** 2, axis=1)))))
    return found[0], found[1]


def _judged(
    fits: Sequence[_Fit], angles: Sequence[Channel], named: Mapping[str, str], units: Sequence[str]
) -> TableGuess:
    if not fits or fits[0].misfit > _FITS:
        best_text = f"; best {fits[0].table.name}, off by {fits[0].misfit:.2g} rad" if fits else ""
        return _by_names(angles, named, units, f"gravity follows no table{best_text}")
    best = fits[0]
    alternatives = [f for f in fits[1:] if f.misfit < max(_CLEAR * best.misfit, _FITS)]
    axes = {angles[k].name: best.table.axis_names[slot] for slot, k in enumerate(best.order)}
    if alternatives:
        other = alternatives[0].table.name
        return _by_names(angles, named, units, f"{best.table.name} and {other} fit alike")
    if any(axes[name] != role for name, role in named.items()):
        return _by_names(angles, {}, units, f"their names disagree with gravity on {axes}")
    reason = f"gravity follows these angles within {best.misfit:.2g} rad on this table"
    if best.mirrored < best.straight / _CLEAR:
        return TableGuess(best.table.name, axes, best.unit, reason, _SENSE)
    return TableGuess(best.table.name, axes, best.unit, reason)


def _by_names(
    angles: Sequence[Channel], named: Mapping[str, str], units: Sequence[str], why: str
) -> TableGuess:
    """The axes by their names alone."""
    unit = units[0] if len(units) == 1 else ""
    doubt = f"the table: {why}" + ("" if unit else "; the unit of the angles")
    axes = dict(named) if len(named) == len(angles) else {}
    if not axes and len(angles) == 1 and unit and is_readout(angles[0]):
        reason = "an angle that stands still without noise, as a readout does"
        return TableGuess("", {angles[0].name: "outer"}, unit, reason, doubt)
    return TableGuess("", axes, unit, "their names" if axes else "", doubt)
