"""What every reader of a foreign format returns: tables of named raw columns. Where a file states
no tables, columns of one length belong together.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from tiltcal.core.errors import TiltcalError, nearest

CUT = "cut line"
"""Key of the metadata of a text whose last line ends before its last cell: that line."""
RAGGED = "ragged lines"
"""Key of the metadata of a text with lines of another width that are left out: how many."""
DAMAGED = "damaged"
"""Key of the metadata of a file that is not whole: message of the library."""
Raw = npt.NDArray[Any]
"""Values as stored in the file, (n,): float64, int64, datetime64[ns], or objects for text."""


@dataclass(frozen=True)
class RawTable:
    """Columns with one time base: a text file, a topic, a group, a variable.

    Args:
        name: the topic, group or variable; empty where the file has one table.
        columns: name -> values, (n,) each; names may repeat, so they stand in a tuple of pairs.
        units: name -> unit as the file states it.
        metadata: further statements of the file.
    """

    name: str
    columns: tuple[tuple[str, Raw], ...]
    units: Mapping[str, str] = field(default_factory=dict)
    metadata: Mapping[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.columns[0][1]) if self.columns else 0

    @property
    def names(self) -> list[str]:
        """Names of the columns, in the order of the file."""
        return [name for name, _ in self.columns]

    def has(self, which: int | str) -> bool:
        """Whether it has a column of this number (from 1) or name."""
        names = self.names
        return 0 < which <= len(names) if isinstance(which, int) else which in names

    def column(self, which: int | str, source: str) -> Raw:
        """A column by number (from 1) or name, (n,).

        Raises:
            TiltcalError: there is no such column.
        """
        names = self.names
        if not self.has(which):
            named = any(name != str(i + 1) for i, name in enumerate(names))
            valid = names if named else [str(i + 1) for i in range(len(names))]
            location = f", table {self.name}" if self.name else ""
            raise TiltcalError(
                f"foreign recording {source}{location}",
                found=f"no column {which}",
                need="a column of it",
                do=nearest(str(which), valid),
            )
        return self.columns[which - 1 if isinstance(which, int) else names.index(which)][1]


@dataclass(frozen=True)
class RawFile:
    """A foreign file as read.

    Args:
        source: its name.
        format: name of the format.
        tables: one or more.
    """

    source: str
    format: str
    tables: tuple[RawTable, ...]

    def table(self, name: str) -> RawTable:
        """A table by name; the only one where no name is given.

        Raises:
            TiltcalError: there is no such table, or several and no name.
        """
        found = [t for t in self.tables if t.name == name]
        if found:
            return found[0]
        if not name and len(self.tables) == 1:
            return self.tables[0]
        names = [t.name for t in self.tables]
        raise TiltcalError(
            f"foreign recording {self.source}",
            found=f"no table '{name}'" if name else f"{len(names)} tables and no table named",
            need="the table (topic, group, variable) that a column stands in",
            do=nearest(name, names),
        )


def vectors(name: str, values: Raw) -> list[tuple[str, Raw]]:
    """An array of a file as columns.

    Args:
        name: of the columns.
        values: (n,), or (n, k) with k columns, or (1, n).

    Returns:
        ``name``, or ``name_1`` ... ``name_k``; nothing where it is neither numbers nor text.
    """
    values = np.asarray(values)
    if values.ndim == 2 and 1 in values.shape:
        values = values.reshape(-1)
    if values.ndim == 2 and values.shape[0] < values.shape[1]:
        values = values.T
    if values.ndim == 1:
        kept = typed(values)
        return [] if kept is None else [(name, kept)]
    if values.ndim == 2 and values.shape[1] <= MOST_COLUMNS:
        parts = [typed(values[:, k]) for k in range(values.shape[1])]
        return [(f"{name}_{k + 1}", part) for k, part in enumerate(parts) if part is not None]
    return []


MOST_COLUMNS = 64  # a wider array is a picture or a covariance, not channels


def typed(values: Raw) -> Raw | None:
    """One column, (n,), in one of the types of ``Raw``; None where it is none of them."""
    if values.dtype.kind == "M":
        return values.astype("datetime64[ns]")
    if values.dtype.kind == "m":
        return values.astype("timedelta64[ns]").astype(np.int64) / 1e9
    if values.dtype.kind == "u" and values.dtype.itemsize == 8:
        return values.astype(np.int64) if not (values >> 63).any() else values.astype(float)
    if values.dtype.kind in "iu":
        return values.astype(np.int64)
    if values.dtype.kind in "fb":
        return values.astype(float)
    if values.dtype.kind in "USO":
        texts = [v.decode(errors="replace") if isinstance(v, bytes) else v for v in values]
        return np.array([str(t) if t is not None else None for t in texts], dtype=object)
    return None


def by_length(
    columns: Sequence[tuple[str, Raw]],
    units: Mapping[str, str],
    source: str,
    prefix: str = "",
) -> tuple[RawTable, ...]:
    """Tables of equally long columns, the longest first; single values are metadata.

    Args:
        source: of the file, for the names of the tables.
        columns: name and values, (n,) each.
        units: name -> unit as stated.
        prefix: name of the longest table; the others are called ``<prefix>rows_<n>``.

    Raises:
        TiltcalError: there is no column.
    """
    single = {name: str(values[0]) for name, values in columns if len(values) == 1}
    groups: dict[int, list[tuple[str, Raw]]] = {}
    for name, values in columns:
        if len(values) > 1:
            groups.setdefault(len(values), []).append((name, values))
    if not groups:
        raise TiltcalError(
            f"foreign recording {source}",
            found="no array of numbers",
            need="columns of numbers, as vectors, matrices or structures of them",
            do="save the channels as plain arrays",
        )
    found: list[RawTable] = []
    for n in sorted(groups, reverse=True):
        name = prefix if not found else f"{prefix}{'.' if prefix else ''}rows_{n}"
        found.append(RawTable(name, tuple(groups[n]), units, single))
    return tuple(found)
