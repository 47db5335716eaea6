"""The unit of an accelerometer triad, by the norm of its readings at rest."""

from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.recordings.proposal.rests import Windows

NORMS = {"m_s2": 9.80665, "g": 1.0, "mg": 1000.0, "ug": 1.0e6}
"""Norm of gravity in each unit."""
_NEAR = 0.06  # relative; biases of consumer sensors
_GAL = 980.665
_EVEN = 0.12  # relative spread of the norm over the standstills of a triad without large offsets


@dataclass(frozen=True)
class UnitGuess:
    """A unit and why.

    Args:
        unit: empty where it cannot be known.
        scale: of the column, to come to that unit.
        reason: why.
        doubt: what cannot be known, empty where all is.
    """

    unit: str
    reason: str
    doubt: str = ""
    scale: float = 1.0


def norm_at_rest(windows: Windows) -> tuple[float, float]:
    """The median norm at rest, and its relative spread over the standstills (10 to 90 per cent)."""
    norms = np.linalg.norm(windows.at_rest, axis=1)
    middle = float(np.median(norms))
    low, high = np.quantile(norms, [0.1, 0.9])
    return middle, float(high - low) / middle if middle > 0 else np.inf


ROUND = 0.03  # relative: standstill means of a triad in counts lie on a sphere as nearly
MIN_MEANS = 6  # distinct ones that a sphere takes


def sphere_through(points: Array) -> tuple[Array, float] | None:
    """Centre and radius of the sphere through points, (m, 3); None where they lie on none."""
    distinct = np.unique(np.round(points / max(float(np.ptp(points)), 1e-30), 1), axis=0)
    if len(distinct) < MIN_MEANS:
        return None
    A = np.column_stack([2 * points, np.ones(len(points))])
    x, _, rank, _ = np.linalg.lstsq(A, (points**2).sum(axis=1), rcond=None)
    centre = x[:3]
    squared = float(x[3] + centre @ centre)
    if rank < 4 or squared <= 0:
        return None
    radius = float(np.sqrt(squared))
    off = np.linalg.norm(points - centre, axis=1) / radius - 1
    return (centre, radius) if float(np.sqrt(np.mean(off**2))) < ROUND else None


def unit_by_norm(windows: Windows | None, stated: str, whole: bool) -> UnitGuess:
    """The unit of a triad that is an accelerometer by its name or its readings.

    Args:
        windows: of its readings.
        stated: by the file; empty where it states none.
        whole: all readings are whole numbers.
    """
    if windows is None:
        return _as_stated(stated, "too few rows to see a standstill")
    norm, spread = norm_at_rest(windows)
    near = [u for u, size in NORMS.items() if abs(norm / size - 1) < _NEAR and spread < _EVEN]
    shown = f"norm at rest {norm:.4g}"
    if stated in ("LSB", "V", "mV", "mA"):
        return UnitGuess(
            stated, f"the file states {stated}", f"its zero and scale ({shown} {stated})"
        )
    if stated == "gal" and abs(norm / _GAL - 1) < _NEAR:
        return UnitGuess("m_s2", f"the file states cm/s2; {shown}", scale=0.01)
    if stated in NORMS:
        if stated in near:
            return UnitGuess(stated, f"the file states {stated}, and the {shown} agrees")
        return UnitGuess(
            "",
            "",
            f"the unit: the file states {stated}, but the {shown} is not {NORMS[stated]:g}",
        )
    if not near:
        return _counts(whole, shown)
    if near == ["mg"] and ((whole and norm > 1005) or abs(norm / _GAL - 1) < 0.01):
        other = "1024 counts a g" if norm > 1005 else "cm/s2"
        return UnitGuess("", "", f"the unit: {shown} is 1000 mg or {other}")
    return UnitGuess(near[0], f"{shown}, as gravity in {near[0]}")


def _as_stated(stated: str, why: str) -> UnitGuess:
    if stated in NORMS or stated in ("LSB", "V", "mV", "mA"):
        return UnitGuess(stated, f"the file states {stated}")
    return UnitGuess("", "", f"the unit: {why}")


def _counts(whole: bool, shown: str) -> UnitGuess:
    if not whole:
        return UnitGuess("", "", f"the unit: {shown} fits neither 9.8 m/s2, 1 g nor 1000 mg")
    return UnitGuess("LSB", f"whole numbers; {shown} is no unit's", "their zero and scale")
