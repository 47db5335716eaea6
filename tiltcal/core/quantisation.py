"""The quantisation steps that a column was rounded to."""

import numpy as np

from tiltcal.core.arrays import Array

LEAST = 16  # different steps that determine a grid
SMOOTH = 0.1  # of the steps: a computed course goes on by the same, a rounded one alternates


def lsb_width(column: Array) -> float:
    """The smallest step between successive samples, in the column's unit; 0 when it never changes.
    (n,)
    """
    steps = np.abs(np.diff(column[:20000]))
    steps = steps[steps > 0]
    return float(steps.min()) if len(steps) else 0.0


def lsb_grid(column: Array) -> float | None:
    """LSB of a column, in its unit: all values are whole multiples of it apart; None where there is
    no such grid.

    A text file rounds LSBs of a converter to its own digits, so the smallest step is refined by
    larger and larger ones.

    Args:
        column: (n,).
    """
    steps = np.abs(np.diff(column))
    steps = steps[steps > 0]
    if len(steps) < 8:
        return None
    width = float(steps.min())
    for reach in (3.5, 12.5, 50.5, 1e9):
        near = steps[steps < reach * width]
        counts = np.rint(near / width)
        width = float(near @ counts / (counts @ counts))
    off = np.abs(steps / width - np.rint(steps / width))
    if float(off.max()) >= 0.03:  # without a grid it is up to a half
        return None
    few = len(np.unique(np.rint(steps / width))) < LEAST < len(np.unique(column)) / 2
    every = np.diff(column)
    bends = np.abs(np.diff(every))[every[:-1] != 0] > width / 2
    computed = few and float(np.mean(bends)) < SMOOTH
    return None if computed else width
