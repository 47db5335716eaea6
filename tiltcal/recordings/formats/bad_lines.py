"""Lines and messages of a file that could not be read."""

import numpy as np

from tiltcal.data_quality.check import Finding
from tiltcal.data_quality.stamps import STAMPS
from tiltcal.recordings.formats.raw_table import CUT, DAMAGED, RAGGED, RawTable

NONE = np.zeros(0, dtype=np.intp)


def find_bad_lines(table: RawTable) -> list[Finding]:
    """The findings of a file of which lines or messages are left out."""
    found = []
    if RAGGED in table.metadata:
        count = int(table.metadata[RAGGED])
        text = f"lines with another number of cells, left out: {count}"
        found.append(Finding("ragged_lines", STAMPS, NONE, text, count))
    if DAMAGED in table.metadata:
        text = f"the file is damaged: {table.metadata[DAMAGED]}; what could be read is here"
        found.append(Finding("damaged", STAMPS, NONE, text, 1))
    if CUT in table.metadata:
        row, line = len(table), table.metadata[CUT][:40]
        text = f"the last line is cut off and left out: '{line}', data row {row + 1}"
        found.append(Finding("cut_line", STAMPS, np.array([row]), text))
    return found
