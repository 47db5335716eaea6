"""Standstills of a table: rows at which its readout has not moved. They are cached by the contents
of the readout, because one recording is replayed many times with its columns read again.
"""

from collections.abc import Iterator
from functools import lru_cache
from itertools import pairwise
from math import comb

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tiltcal.core.arrays import NOWHERE, Array, Index, Mask
from tiltcal.core.quantisation import lsb_width
from tiltcal.recordings.differentiation import Rates, differentiate, noise_of_stamped
from tiltcal.recordings.rest_edges import edges
from tiltcal.recordings.segmentation import standstill_rows
from tiltcal.recordings.stamps import sampled_at
from tiltcal.setup.pauses import breaks
from tiltcal.statistics.dwell_noise import MAD_TO_SIGMA

EDGE = 2  # samples next to a move that are left to the polynomial
WINDOW = 10  # samples on either side of one, whose means show that the readout moves slowly there
SMOOTH = 8  # degree of a polynomial that a motion follows about its turning point
SMOOTH_LIMIT = 3.0  # times the noise, as estimated from so few rows, that its residuals may have
MIN_STANDSTILLS = 3  # of them: a dwell of fewer than four times as many is one standstill
QUARTILE = 0.3186  # of the sizes of standard normal numbers, the lower one
# rad: what a readout covers within a stop; more is a slow move, or the turning point of an
# oscillation
WANDER = 2e-3


def standstills(time: Array, angles: Array) -> tuple[Mask, Index]:
    """Rows at which a readout (n, axes) has not moved, (n,), and the first after each pause of the
    log that parts motions. time: s, (n,); angles: rad.
    """
    at_standstill = standstill_rows(time, angles)
    parted = breaks(time, angles, at_standstill)
    return still_rows(angles, at_standstill, parted), parted


def still_rows(angles: Array, at_standstill: Mask, parted: Index = NOWHERE) -> Mask:
    """Of the rows at standstill those whose readout has not moved, (n,): within six deviations, or
    one LSB, of the dwell's level.

    The search for dwells takes the very start and end of a move for standstill, and the slow parts
    of a table that never stands still; a rate of zero there would be wrong. A slow move within a
    dwell parts it into standstills with a level each, and so does a pause of the log before one of
    the ``parted`` rows.
    """
    still = at_standstill.copy()
    lsb = 1.01 * np.array([lsb_width(column) for column in angles.T])
    ends = {0, len(angles), *(int(row) for row in parted)}  # nothing is known beyond
    for first, last in _runs(at_standstill, parted):
        still[first:last] = False
        for begin, end, level in _levels(angles[first:last], lsb):
            part = angles[first + begin : first + end]
            off = np.abs(part - np.median(part[level], axis=0))
            # half of the readings of one value: the others give the spread
            half, most = np.quantile(off[level], (0.5, 0.8), axis=0)
            spread = 6 * np.maximum(MAD_TO_SIGMA * half, most / 1.2816)
            quiet = np.asarray((off <= np.maximum(np.maximum(spread, lsb), 1e-12)).all(axis=1))
            for _ in range(EDGE):  # the first samples of a move hide in the noise
                quiet[1:-1] &= quiet[:-2] & quiet[2:]
                quiet[0] &= first + begin in ends
                quiet[-1] &= first + end in ends
            still[first + begin : first + end] = quiet & bool(
                (np.ptp(part[quiet], axis=0) <= WANDER).all() if quiet.any() else False
            )
    return still


def _runs(at_standstill: Mask, parted: Index) -> Iterator[tuple[int, int]]:
    """First and last row, exclusive, of each run of rows at standstill without a parting row."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], at_standstill.astype(int), [0]])))
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        inside = [int(row) for row in parted if first < row < last]
        yield from pairwise([int(first), *inside, int(last)])


def _levels(part: Array, lsb: Array) -> Iterator[tuple[int, int, slice]]:
    """The standstills of a dwell: from row, to row, and which of these rows give the level.

    Slow moves lie between them, each half a standstill's, or before the first and after the last. A
    readout that hardly ever stays where it is wanders: that is one standstill; or it moves
    smoothly: that is the turning point of a motion, and no standstill.

    Args:
        part: rad, (n, axes).
        lsb: of each axis, rad.
    """
    n = len(part)
    whole = [(0, n, slice(None))]
    m = min(WINDOW, n // 4)
    if m < MIN_STANDSTILLS:
        yield from whole
        return
    means = sliding_window_view(part, m, axis=0).mean(axis=-1)
    # most of the steps may be those of a move; rounding to one LSB hides less than one of it
    quick = np.quantile(np.abs(np.diff(part, axis=0)), 0.25, axis=0) + lsb
    # a smooth motion leaves nothing of its fourth differences
    bent = np.median(np.abs(np.diff(part, 4, axis=0)), axis=0) * MAD_TO_SIGMA / np.sqrt(comb(8, 4))
    noise = np.minimum(quick / QUARTILE / np.sqrt(2), bent + lsb)
    steps = np.abs(means[m:] - means[:-m])
    slow = np.ones(n, bool)
    slow[m : n - m + 1] = (steps > 6 * noise * np.sqrt(2 / m) + lsb).any(axis=1)
    slow[:m], slow[n - m :] = slow[m], slow[n - m]
    ends = np.flatnonzero(np.diff(np.concatenate([[0], ~slow, [0]])))
    dwells = [(a, b) for a, b in zip(ends[::2], ends[1::2], strict=True) if b - a >= m]
    if sum(b - a + m for a, b in dwells) < n / 3:  # means see a slow move that many rows early
        if not _is_smooth(part, noise):
            yield from whole
        return
    parted = [0, *((b + a) // 2 for (_, b), (a, _) in pairwise(dwells)), n]
    for (a, b), begin, end in zip(dwells, parted, parted[1:], strict=False):
        yield begin, end, slice(a - begin, b - begin)


def _is_smooth(part: Array, noise: Array) -> bool:
    """Whether a readout, rad, (n, axes), is one smooth motion within its noise, rad, (axes,)."""
    time = np.linspace(-1.0, 1.0, len(part))
    degree = min(SMOOTH, len(part) // 3)
    basis = np.linalg.qr(np.vander(time, degree + 1))[0]
    left = part - basis @ (basis.T @ part)
    spread = np.sqrt((left**2).sum(axis=0) / (len(part) - degree - 1))
    return bool((spread <= SMOOTH_LIMIT * noise).all())


def sign_of(angle: Array) -> float:
    """Sign of the angle that is furthest from zero. angle: rad, (n,)."""
    return -1.0 if angle[np.argmax(np.abs(angle))] < 0 else 1.0


@lru_cache(maxsize=24)
def standstills_of(time: bytes, angles: bytes, axes: int) -> tuple[Mask, Index]:
    """``standstills`` of the contents of arrays, (n,) and (n, axes)."""
    return standstills(np.frombuffer(time), np.frombuffer(angles).reshape(-1, axes))


@lru_cache(maxsize=24)
def edges_of(time: bytes, angle: bytes) -> tuple[Array, Array]:
    """Instants at which an axis began a move, s, (k,), and ended one, of the contents of arrays."""
    x = np.frombuffer(angle)
    t = sampled_at(np.frombuffer(time), x)
    if len(t) < 9 or np.ptp(x) == 0:
        return np.zeros(0), np.zeros(0)
    still, parted = standstills_of(t.tobytes(), angle, 1)
    noise, step = noise_of_stamped(t, x, still, parted), float(np.median(np.diff(t)))
    if not len(noise):
        return np.zeros(0), np.zeros(0)
    leaves, comes = edges(t / step, x, still, noise, parted)
    return leaves * step, comes * step


@lru_cache(maxsize=24)
def rates_of(time: bytes, angle: bytes) -> Rates:
    """The rates of one axis, of the contents of arrays, (n,), by its own standstills, whatever the
    others do.
    """
    x = np.frombuffer(angle)
    t = sampled_at(np.frombuffer(time), x)
    return differentiate(t, x, *standstills_of(t.tobytes(), angle, 1))


def forget_replays() -> None:
    """Free what is kept of the readouts that were replayed last."""
    standstills_of.cache_clear()
    edges_of.cache_clear()
    rates_of.cache_clear()
