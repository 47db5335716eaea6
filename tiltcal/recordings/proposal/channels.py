"""Columns of a foreign file with what their names and their file say."""

from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.recordings.formats.raw_table import Raw, RawFile
from tiltcal.recordings.formats.unit_words import stated_unit, unit_of
from tiltcal.recordings.proposal.names import Meaning, meaning_of


@dataclass(frozen=True)
class Channel:
    """A column.

    Args:
        table: it stands in.
        source: as ``from`` names it: its name, or its number from 1.
        name: for messages.
        raw: values as read, (n,).
        meaning: of its name.
        unit: stated by the file; empty where it states none.
    """

    table: str
    source: int | str
    name: str
    raw: Raw
    meaning: Meaning
    unit: str

    @property
    def numeric(self) -> bool:
        """Whether it holds numbers."""
        return self.raw.dtype.kind in "if"

    @property
    def values(self) -> Array:
        """As floats, (n,)."""
        return np.asarray(self.raw, dtype=float)

    @property
    def whole(self) -> bool:
        """Whether all its values are whole numbers, and not all the same."""
        known = self.values[np.isfinite(self.values)]
        return bool(len(known)) and bool(np.all(known == np.round(known)))


def channels_of(file: RawFile) -> list[Channel]:
    """All columns of all tables, in their order."""
    found = []
    for table in file.tables:
        names = table.names
        numbered = names == [str(k + 1) for k in range(len(names))]
        for k, (name, raw) in enumerate(table.columns):
            by_number = numbered or names.count(name) > 1 or not name
            stated = unit_of(table.units[name]) if name in table.units else stated_unit(name)
            meaning = Meaning("", "", "") if numbered else meaning_of(name, table.name)
            shown = f"column {k + 1}" if by_number else name
            found.append(
                Channel(table.name, k + 1 if by_number else name, shown, raw, meaning, stated or "")
            )
    return found
