"""The codes that a column was rounded to."""

import numpy as np

from tiltcal.frames import Array


def code_width(column: Array) -> float:
    """The smallest step between successive samples, in the column's unit; 0 when it never changes. (n,)"""
    steps = np.abs(np.diff(column[:20000]))
    steps = steps[steps > 0]
    return float(steps.min()) if len(steps) else 0.0
