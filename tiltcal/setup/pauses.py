"""Pauses of a log: intervals in which nothing was written, and what the table did is not known.

A polynomial, a window or a standstill that reaches across one joins two motions that have nothing
to do with each other. Only where the table stands at one level on both sides is it taken to have
stood still between.
"""

from itertools import pairwise

import numpy as np

from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.core.quantisation import lsb_width
from tiltcal.statistics.dwell_noise import MAD_TO_SIGMA

# samples: where as many are missing, the narrowest local polynomial would have none of its own
PAUSE = 5.0
NEIGHBOURS = (
    10  # samples on either side, at most, whose means show whether the standstill is the same
)
SAME = 6.0  # sigma that those means may be apart


def pauses(time: Array) -> Index:
    """The first row after each pause. time: s, increasing, (n,)."""
    steps = np.diff(time)
    if not len(steps):
        return np.zeros(0, np.intp)
    return np.flatnonzero(steps > PAUSE * np.median(steps)) + 1


def breaks(time: Array, angles: Array, still: Mask) -> Index:
    """The first row after each pause that is not within one standstill.

    Args:
        time: s, increasing, (n,).
        angles: (n, axes).
        still: rows at standstill, (n,).
    """
    found = pauses(time)
    if not len(found):
        return found
    levels = np.array([lsb_width(column) for column in angles.T])
    steps = np.abs(np.diff(angles[still], axis=0))
    noise = MAD_TO_SIGMA * np.median(steps, axis=0) / np.sqrt(2) if len(steps) else 0.0 * levels
    return np.array(
        [row for row in found if not _same_standstill(angles, still, int(row), noise, levels)],
        np.intp,
    )


def _same_standstill(angles: Array, still: Mask, row: int, noise: Array, steps: Array) -> bool:
    """Whether a table stands at one level before and from this row on."""
    if not (still[row - 1] and still[row]):
        return False
    before, after = slice(max(row - NEIGHBOURS, 0), row), slice(row, row + NEIGHBOURS)
    sides = [angles[side][still[side]] for side in (before, after)]
    apart = np.abs(sides[0].mean(axis=0) - sides[1].mean(axis=0))
    fewest = min(len(side) for side in sides)
    return bool((apart <= SAME * noise * np.sqrt(2 / fewest) + steps).all())


def stretches(n: int, breaks: Index) -> list[slice]:
    """The rows between breaks, of n. breaks: first rows after them, (m,)."""
    ends = [0, *(int(row) for row in breaks), n]
    return [slice(a, b) for a, b in pairwise(ends)]
