"""The time stamps of a recording: they have to increase, and may be rounded."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.data_quality.stamps import faults_of_order

DECIMALS = 7  # of a second: stamps with more are as good as exact
ORDER = 4  # of the differences by which a readout is smooth
LOST = 1.5  # steps of a regular clock, at least, where samples are missing: no readout is smooth
ROUNDING = 1e-9  # s, what stamps near zero are off by
CERTAIN = 0.1  # of a unit: what is off by more is no whole number of it
LARGEST = 1e30  # of a reading or a stamp: its eighth power is still a number


def require_onward(time: Array, source: str, before: int = 0, last: float = -np.inf) -> None:
    """Refuse stamps that do not increase.

    Args:
        time: s, (n,).
        source: for the message.
        before: rows of the recording before these.
        last: the stamp of the last of them, s.

    Raises:
        TiltcalError: naming the first rows where time does not run forward.
    """
    if not np.all(np.isfinite(time)):
        row = int(np.argmax(~np.isfinite(time)))
        raise TiltcalError(
            f"{source}, data row {before + row + 1}",
            found=f"the time {time[row]}",
            need="finite time stamps",
            do="correct it",
        )
    for fault in faults_of_order(time, before, last):
        raise TiltcalError(
            source,
            found=fault.statement,
            need="time stamps that increase",
            do=(
                f"write it anew with `tiltcal import --repair {fault.repair}`, or split it there;"
                " `tiltcal diagnose` reads it as it is"
            ),
        )


def require_measurable(values: Array, time: Array, name: str, source: str) -> None:
    """Refuse numbers that no instrument gives, and whose powers are no numbers.

    Args:
        name, source: of the channel and its recording, for the message.
        values: of a column, (n,), NaN where it was not sampled.
        time: their stamps, s, (n,).

    Raises:
        TiltcalError: naming the first stamp or reading that is one.
    """
    for column, of in ((time, "time_s"), (values, name)):
        if len(column) and np.fmax.reduce(np.abs(column)) > LARGEST:
            first = int(np.argmax(np.abs(np.nan_to_num(column)) > LARGEST))
            raise TiltcalError(
                f"{source}, column {of}, at {time[first]:.10g} s",
                found=f"{column[first]:g}",
                need=f"a number of at most {LARGEST:g}",
                do="correct that cell, or leave it empty",
            )


def unrounded(time: Array) -> Array:
    """Stamps without the rounding that they were written with, where they agree with a regular
    clock that lost samples: s, (n,) -> (n,). Others as they are.

    Rates of a readout need them: at 40 deg/s a stamp that is rounded to 0.1 ms is off by up to
    7 arcsec of the angle.
    """
    since, step = time - time[:1], np.diff(time)
    resolution = next((10.0**-k for k in range(DECIMALS) if _in_units(time, 10.0**k)), 0.0)
    if not resolution or len(time) < 3 or not step.min() > 0:
        return time
    count = np.concatenate([[0.0], np.cumsum(np.round(step / np.median(step)))])
    pace, begin = np.polyfit(count, since, 1)
    even = time[0] + (begin + pace * count)
    off = np.abs(even - time).max()
    # the clock itself is known to a part of the rounding
    return even if off <= (0.5 + 2 / np.sqrt(len(time))) * resolution else time


def sampled_at(time: Array, angle: Array) -> Array:
    """When rows were sampled, s, (n,): at even times that were written rounded, or at the rounded
    times themselves, as a recorder does whose clock ticks as coarsely. The readout of an axis is
    smoother over the true ones, where no sample is missing.

    Args:
        time: stamps, s, (n,).
        angle: readout of the axis, rad, (n,).
    """
    even = unrounded(time)
    if even is time or len(time) <= ORDER:
        return even
    at_even = angle - np.gradient(angle, even) * (time - even)
    step = np.diff(even)
    in_turn = sliding_window_view(step < LOST * np.median(step), ORDER).all(axis=1)
    written, ticked = (float(np.sum(np.diff(x, ORDER)[in_turn] ** 2)) for x in (angle, at_even))
    return even if written <= ticked else time


def _in_units(time: Array, scale: float) -> bool:
    """Whether stamps, s, are whole numbers of 1 / scale."""
    units = (time - time[:1]) * scale
    # far from zero a number of seconds is itself known to a few tenths of a microsecond
    off = scale * max(ROUNDING, 2 * float(np.spacing(np.abs(time).max(initial=0.0))))
    return off < CERTAIN and bool(np.abs(units - np.round(units)).max(initial=0.0) <= off)
