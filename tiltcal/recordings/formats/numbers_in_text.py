"""Columns of text that are meant as numbers: some of their cells are not."""

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.recordings.formats.cells import kind_of
from tiltcal.recordings.formats.raw_table import Raw


def numbers_in(texts: Raw, decimal: str) -> tuple[Array, Index]:
    """The numbers of a column, (n,), NaN for every other cell, and the rows of cells that are
    neither numbers nor empty.

    Args:
        texts: objects, (n,).
        decimal: point or comma.
    """
    values = np.full(len(texts), np.nan)
    bad = []
    for k, item in enumerate(texts):
        cell = "" if item is None else str(item).strip()
        kind = kind_of(cell, decimal)
        if kind == "number":
            values[k] = float(cell.replace(",", "."))
        elif kind != "empty":
            bad.append(k)
    return values, np.array(bad, dtype=np.intp)
