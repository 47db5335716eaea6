"""Columns of a foreign file with what their names and their file say."""

from dataclasses import dataclass, replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.recordings.formats.numbers_in_text import numbers_in
from tiltcal.recordings.formats.raw_table import Raw, RawFile
from tiltcal.recordings.formats.unit_words import stated_unit, unit_of
from tiltcal.recordings.import_checks import Finding
from tiltcal.recordings.proposal.names import Meaning, meaning_of

_BY_UNIT = dict.fromkeys(("m_s2", "g", "mg", "ug", "gal"), "accel") | dict.fromkeys(
    ("rad_s", "deg_s", "deg_h"), "gyro"
)
"""What a column is whose name says an axis and a unit only."""
_MOSTLY = 0.9  # share of numbers among the filled cells of a channel


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


def channels_of(file: RawFile, decimal: str = "point") -> tuple[list[Channel], list[Finding]]:
    """All columns of all tables, in their order, and the cells of channels that are no numbers.

    Args:
        file: what was read of it.
        decimal: mark of numbers in text.
    """
    found: list[Channel] = []
    faults: list[Finding] = []
    for table in file.tables:
        names = table.names
        numbered = names == [str(k + 1) for k in range(len(names))]
        for k, (name, raw) in enumerate(table.columns):
            by_number = numbered or names.count(name) > 1 or not name
            stated = unit_of(table.units[name]) if name in table.units else stated_unit(name)
            meaning = Meaning("", "", "") if numbered else meaning_of(name, table.name)
            if not meaning.role and meaning.axis:
                meaning = replace(meaning, role=_BY_UNIT.get(stated or "", ""))
            shown = f"column {k + 1}" if by_number else name
            raw, fault = _mended(raw, shown, decimal)
            faults += fault
            found.append(
                Channel(table.name, k + 1 if by_number else name, shown, raw, meaning, stated or "")
            )
    return found, faults


def _mended(raw: Raw, name: str, decimal: str) -> tuple[Raw, list[Finding]]:
    """A column of text with few cells that are no numbers, as numbers."""
    if raw.dtype != object:
        return raw, []
    values, bad = numbers_in(raw, decimal)
    if np.isfinite(values).sum() <= _MOSTLY * max(len(raw) - sum(t is None for t in raw), 1):
        return raw, []
    rows = tuple(int(k) + 1 for k in bad[:3])
    places = ", ".join(map(str, rows)) + (", ..." if len(bad) > len(rows) else "")
    text = f"{name}: {len(bad)} cells are no numbers, first in data row {places}"
    return values, [Finding("text", name, len(bad), rows, text, "empty_text")]
