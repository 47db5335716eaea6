"""Columns that were sampled together, and one sensor's readings."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tiltcal.core.arrays import Array

Rows = npt.NDArray[np.intp]
Labels = npt.NDArray[np.object_]


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
