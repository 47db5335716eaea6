"""A gyro checked by the accelerometer next to it: gravity turns by the integral of the rate."""

from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import COLUMN_UNITS
from tiltcal.recordings.proposal.gravity import UnitGuess
from tiltcal.recordings.proposal.rests import filled

_WINDOWS_S = (0.1, 0.2, 0.4)
_WINDOWS = (8, 16, 32, 64)  # rows, where the rate is not known
_TURN = 0.5  # rad that gravity has to turn in all
_FITS = 0.7  # share of the turning of gravity that the gyro explains
_NEAR = 0.2  # relative
UNITS = ("rad_s", "deg_s", "deg_h")
LARGEST_RAD = 70.0  # rad/s, 4000 deg/s: no gyro of a few per cent reads more


@dataclass(frozen=True)
class Turning:
    """How gravity follows a gyro.

    Args:
        factor: radians a row that one unit of the gyro means; negative where the senses differ.
        share: of the turning of gravity that it explains.
        turned: total turning of gravity, rad.
    """

    factor: float
    share: float
    turned: float

    @property
    def fits(self) -> bool:
        """Whether gravity follows the gyro."""
        return self.turned > _TURN and self.share > _FITS

    @property
    def enough(self) -> bool:
        """Whether gravity turns at all."""
        return self.turned > _TURN


def follow(force: Array, rates: Array, rate: float | None) -> Turning | None:
    """How the direction of gravity follows a gyro; None where there are too few rows.

    Args:
        force: readings of an accelerometer triad without large offsets, any unit, (n, 3).
        rates: readings of a gyro triad, (n, 3).
        rate: of samples, Hz.
    """
    force, rates = filled(force), filled(rates)
    sizes = {max(4, round(rate * t)) for t in _WINDOWS_S} if rate else set(_WINDOWS)
    found = [t for size in sorted(sizes) if (t := _follow(force, rates, size)) is not None]
    # short windows leave no motion inside them unseen, long ones are less noisy
    return next((t for t in found if t.fits), max(found, key=lambda t: t.share, default=None))


def _follow(force: Array, rates: Array, size: int) -> Turning | None:
    """The same by windows of one size, in rows."""
    count = len(force) // size
    if count < 6:
        return None
    f = force[: count * size].reshape(count, size, 3).mean(axis=1)
    w = rates[: count * size].reshape(count, size, 3).mean(axis=1)
    length = np.linalg.norm(f, axis=1)
    u = f / np.maximum(length, 1e-30)[:, None]
    w = w - _standstill_rate(u, w)
    # from window to window: the mean rate of two windows, along the mean direction
    turn = u[1:] - u[:-1]
    expected = -np.cross((w[1:] + w[:-1]) / 2, (u[1:] + u[:-1]) / 2) * size
    power, both = float(np.sum(expected**2)), float(np.sum(expected * turn))
    total = float(np.sum(turn**2))
    if power == 0 or total == 0:
        return None
    steps = np.linalg.norm(turn, axis=1)
    turned = float(steps[steps > 4 * float(np.median(steps))].sum())
    return Turning(both / power, both**2 / (power * total), turned)


def _standstill_rate(u: Array, w: Array) -> Array:
    """The reading of the gyro while gravity does not turn, (3,)."""
    steps = np.linalg.norm(np.diff(u, axis=0), axis=1)
    still = np.flatnonzero(steps <= float(np.quantile(steps, 0.4)))
    return np.asarray(np.median(w[still], axis=0))


def unit_of_gyro(
    turning: Turning | None, rate: float | None, largest: float, stated: str, whole: bool
) -> UnitGuess:
    """The unit of a triad that is a gyro by its name or its readings.

    Args:
        turning: of gravity, where there is an accelerometer.
        rate: of samples, Hz.
        largest: reading, without its bias.
        stated: by the file; empty where it states none.
        whole: all readings are whole numbers.
    """
    sense = ""
    if turning is not None and turning.fits and turning.factor < 0:
        sense = (
            "the sense of its axes: gravity turns against it, so one of the two has"
            " left-handed axes or opposite signs"
        )
    seen = _seen(turning, rate)
    if stated in ("LSB", "V", "mV", "mA"):
        return UnitGuess(stated, f"the file states {stated}", "its zero and scale")
    if stated in UNITS:
        if seen and seen != stated and not whole:
            doubt = f"the unit: the file states {stated}, but gravity turns as if it were {seen}"
            return UnitGuess("", "", doubt)
        agrees = ", and gravity turns as stated" if seen == stated else ""
        return UnitGuess(stated, f"the file states {stated}{agrees}", sense)
    if seen:
        return UnitGuess(seen, f"gravity turns by its integral in {seen}", sense)
    if whole:
        return UnitGuess("LSB", "whole numbers", sense or "their zero and scale")
    if largest > LARGEST_RAD:
        return UnitGuess("deg_s", f"readings up to {largest:.4g}: too many for rad/s", sense)
    return UnitGuess("", "", _doubt(turning, rate, largest))


def _seen(turning: Turning | None, rate: float | None) -> str:
    """The unit in which gravity follows; empty where that cannot be seen."""
    if turning is None or not turning.fits or not rate:
        return ""
    factor = abs(turning.factor) * rate
    near = [u for u in UNITS if abs(factor / COLUMN_UNITS[u].factor - 1) < _NEAR]
    return near[0] if near else ""


def _doubt(turning: Turning | None, rate: float | None, largest: float) -> str:
    if turning is not None and turning.fits and not rate:
        rates = ", ".join(
            f"about {COLUMN_UNITS[u].factor / abs(turning.factor):.2g} Hz as {u}" for u in UNITS[:2]
        )
        return f"the unit: gravity follows it at {rates}, and the sample rate is not known"
    if turning is not None and turning.enough and not turning.fits:
        return "the unit: gravity does not follow it; axes of the two may differ"
    return f"the unit: readings up to {largest:.3g} may be rad/s or deg/s, and nothing turns"
