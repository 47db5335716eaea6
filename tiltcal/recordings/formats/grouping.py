"""Columns of a file that states no tables: those of one length belong together."""

from collections.abc import Mapping, Sequence

from tiltcal.core.errors import TiltcalError
from tiltcal.recordings.formats.raw_table import Raw, RawTable


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
