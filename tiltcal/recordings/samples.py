"""Columns of a recording: those that were sampled together, one sensor's readings, and the
contents of a file.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import COLUMN_UNITS, split_unit
from tiltcal.setup.sensor import Sensor

Rows = npt.NDArray[np.intp]
Labels = npt.NDArray[np.object_]


class Columns(Protocol):
    """Contents of the file of a recording: all that a writer asks of one."""

    @property
    def time(self) -> Array:
        """Stamps, s, (n,)."""

    @property
    def metadata(self) -> Mapping[str, str]:
        """``# key: value`` lines."""

    @property
    def column_names(self) -> Sequence[str]:
        """Numeric columns, in their order."""

    @property
    def texts(self) -> Mapping[str, Labels]:
        """Columns of text, (n,) each."""

    @property
    def written_names(self) -> Sequence[str]:
        """All columns, in their order."""

    def column(self, name: str) -> Array:
        """A numeric column, (n,), NaN where not sampled."""


@dataclass(frozen=True)
class Block:
    """Columns that were sampled together.

    Args:
        rows: indices into the recording's time axis, (m,), increasing; None for every row.
        columns: name with unit -> values as written in the file, (m,) each.
    """

    rows: Rows | None
    columns: Mapping[str, Array]


@dataclass(frozen=True)
class Samples:
    """One sensor's readings in SI.

    Args:
        time: s, (m,).
        values: (m, k), NaN where one channel was not sampled.
        axes: names of the k channels.
        units: the unit each column was written in.
        rows: rows of the recording, (m,).
    """

    time: Array
    values: Array
    axes: tuple[str, ...]
    units: tuple[str, ...]
    rows: Rows


def si_values(sensor: Sensor, names: Sequence[str], raw: Array, source: str) -> Array:
    """Readings of columns in SI, (m, k).

    Raises:
        TiltcalError: the unit of a column does not fit the sensor.
    """
    units = [split_unit(name)[1] for name in names]
    if sensor.input is not None and all(u == sensor.input.unit for u in units):
        return _turned_back(sensor, sensor.input.to_si(raw))
    factors = []
    for name, unit in zip(names, units, strict=True):
        known = COLUMN_UNITS[str(unit)]
        if known.quantity != sensor.quantity:
            fix = "rename it"
            if known.quantity == "raw":
                fix = "add input = {unit = ..., zero = ..., per_...} to the sensor"
            elif known.quantity == "angle":
                fix = 'a sensor that reads tilt is of kind = "inclinometer"'
            raise TiltcalError(
                f"{source}, column {name}",
                found=f"unit {unit}",
                need=f"a unit of {sensor.quantity}",
                do=fix,
            )
        factors.append(known.factor)
    return _turned_back(sensor, np.asarray(raw * np.array(factors)))


def _turned_back(sensor: Sensor, values: Array) -> Array:
    """Tilt that counts from 0 to 360 deg as it is: within half a turn of zero. values: SI."""
    if sensor.kind != "inclinometer":
        return values
    return np.where(np.abs(values) > np.pi, np.remainder(values + np.pi, 2 * np.pi) - np.pi, values)
