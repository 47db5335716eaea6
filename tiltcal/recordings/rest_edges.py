"""Instants at which an axis begins and ends a move, between two samples, its rate being zero
there; and those at which a steady turn begins and ends.
"""

from collections.abc import Iterator
from itertools import product

import numpy as np

from tiltcal.core.arrays import NOWHERE, Array, Index, Mask
from tiltcal.recordings.starting_courses import (
    EARLIEST,
    STANDSTILL,
    Corner,
    Side,
    corner_at,
    instants,
    side_of,
    spread_of,
)

WIDTHS = (5, 6, 7, 8, 9, 11, 13, 16, 20, 25)  # samples after the standstill
REACHES = (6, 8, 11, 16, 25, 36, 50)  # that distinguish one functional form of a start from another
POWERS: tuple[tuple[float, ...], ...] = (
    (2.0, 3.0),
    (2.0, 3.0, 4.0),
    (3.0, 4.0, 5.0),
    (3.0, 4.0, 5.0, 6.0),
    (3.0, 5.0, 7.0),  # the rate on a cosine
)
# how a drive may begin: its acceleration at once, soon, later
STARTS: tuple[tuple[float, ...], ...] = (
    (2.0, 3.0, 4.0),
    (3.0, 4.0, 5.0, 6.0),
    (4.0, 5.0, 6.0),
)
# sigma that the residuals of a course may exceed the noise: to choose a functional form, and to
# use it once it is chosen
STRICT, LOOSE = 1.0, 3.0
HIDDEN = -16  # samples that the slowest may have been moving unseen


def corners(time: Array, angle: Array, still: Mask, steady: Mask, noise: Array) -> Iterator[Corner]:
    """Both ends of every move between standstills or steady turns at which such a course leaves no
    more than the noise of readout and stamps.

    Args:
        time: in samples, increasing, (n,).
        angle: rad, (n,).
        still: rows at which the axis stands still, (n,).
        steady: rows of its steady turns, (n,).
        noise: standard deviation of the angle at each stamp, rad, (n,).
    """
    n = len(time)
    yield from _fitted(side_of(time, angle, still, steady, noise))
    for c in _fitted(side_of(-time[::-1], angle[::-1], still[::-1], steady[::-1], noise[::-1])):
        yield Corner(n - 1 - c.rows, c.near, -c.rate, c.acceleration, c.variance, c.bending)


def edges(
    time: Array, angle: Array, still: Mask, noise: Array, parted: Index = NOWHERE
) -> tuple[Array, Array]:
    """The instants at which moves begin, and those at which they end, in samples; none
    where they cannot be determined. time: s, (n,); angle: rad, (n,).

    Args:
        time, angle, still, noise: see ``corners``.
        parted: first rows after pauses of the log, which no move and no standstill continues
            across.
    """
    back = len(time) - parted[::-1]
    turning = np.zeros(len(time), bool)
    leaves = _departures(side_of(time, angle, still, turning, noise, parted))
    comes = _departures(side_of(-time[::-1], angle[::-1], still[::-1], turning, noise[::-1], back))
    return leaves, -comes[::-1]


def _departures(side: Side) -> Array:
    """Instants at which these moves begin, in order: by the form of the start, one for all of them,
    that fits them the furthest.
    """
    best, powers, when = -1.0, STARTS[0], np.full(len(side.last), np.nan)
    for trial in STARTS:
        total, found = _reached(side, trial, best)
        if total > best:
            best, powers, when = total, trial, found
    # the widest are most informative
    for earliest, width in product((EARLIEST, HIDDEN), reversed(REACHES)):
        _fit_window(side, np.isnan(when), width, powers, when, LOOSE, earliest)
    return when[~np.isnan(when)]


def _reached(side: Side, powers: tuple[float, ...], least: float) -> tuple[float, Array]:
    """Number of samples over which a form fits all these moves together, each by the widest window
    that it fits, and the instants at which they begin by it; as soon as it cannot be more than
    ``least``, at most as many as that.
    """
    reach, when = np.zeros(len(side.last)), np.full(len(side.last), np.nan)
    for width in reversed(REACHES):
        if reach.sum() + width * (reach == 0).sum() <= least:
            break
        reach[_fit_window(side, reach == 0, width, powers, when)] = width
    return float(reach.sum()), when


def _fit_window(
    side: Side,
    wanted: Mask,
    width: int,
    powers: tuple[float, ...],
    when: Array,
    off: float = STRICT,
    earliest: int = EARLIEST,
) -> Index:
    """Write into ``when`` the beginnings of the wanted moves by a window of this width; return the
    moves that it fits.
    """
    tried = np.flatnonzero(
        wanted & (side.last + 1 + width <= side.end) & (side.rows >= STANDSTILL[0] - earliest)
    )
    if not len(tried):
        return tried
    instant, beyond = instants(side, tried, width, powers, off, earliest)
    fits = beyond <= off
    when[tried[fits]] = side.time[side.last[tried[fits]]] + instant[fits]
    return tried[fits]


def _fitted(side: Side) -> Iterator[Corner]:
    """The corners of one side, each by the window and the powers that determine its rate best among
    those that fit; where none fits well, among those that are not refused.
    """
    chosen: dict[int, tuple[int, tuple[float, ...], float]] = {}
    allowed = dict(chosen)
    for width, powers in sorted(product(WIDTHS, POWERS), key=lambda trial: spread_of(*trial)):
        long_enough = side.last + 1 + width <= side.end
        tried = np.array([k for k in np.flatnonzero(long_enough) if k not in chosen], dtype=int)
        if not len(tried):
            continue
        instant, off = instants(side, tried, width, powers, LOOSE)
        for k, t, beyond in zip(tried.tolist(), instant.tolist(), off.tolist(), strict=True):
            if beyond <= STRICT:
                chosen[k] = width, powers, t
            elif beyond <= LOOSE:
                allowed.setdefault(k, (width, powers, t))
    for k, (width, powers, instant_k) in sorted((allowed | chosen).items()):
        yield corner_at(side, k, width, powers, instant_k)
