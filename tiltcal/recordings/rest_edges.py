"""Where an axis leaves its rest and where it comes to one: at an instant between two samples, its
rate being zero there.

A polynomial across that instant rings. From it on the course is a sum of powers of the time since,
the square first, and before it the level of the rest: that tells the rate beside a rest better than
any window on one side of it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations_with_replacement, pairwise, product

import numpy as np

from tiltcal.core.arrays import NOWHERE, Array, Index, Mask

WIDTHS = (5, 6, 7, 8, 9, 11, 13, 16, 20, 25)  # samples after the rest
REACHES = (6, 8, 11, 16, 25, 36, 50)  # that tell one law of a start from another
POWERS: tuple[tuple[float, ...], ...] = ((2.0, 3.0), (2.0, 3.0, 4.0))
# how a drive may begin: its acceleration at once, soon, late
STARTS: tuple[tuple[float, ...], ...] = (
    (2.0, 3.0, 4.0),
    (3.0, 4.0, 5.0, 6.0),
    (4.0, 5.0, 6.0),
)
# sigma that the noise beside a course may be off: to tell a law, and to use it once it is told
STRICT, LOOSE = (
    1.0,
    3.0,
)
# samples: what begins slowly hides in the noise of the rest, and a rest ends with a margin
EARLIEST, LATEST = (
    -4,
    5,
)
HIDDEN = -16  # samples that the slowest may have been on its way
COARSE = 0.25  # samples between the instants tried first
ZOOM = 8.0  # times finer, each time
ZOOMS = 3
REST = (6, 50)  # samples of a rest, at least, and as many at most for its level
NEAR = 2.5  # samples from the instant in which every window reaches across it


@dataclass(frozen=True)
class Corner:
    """The motion beside one end of a rest.

    Args:
        rows: (n,); near: of them those that every window would take across the corner, (n,).
        rate, acceleration: per sample and per sample squared, (n,).
        variance: of the rate, in units of the readout's, (n,).
    """

    rows: Index
    near: Mask
    rate: Array
    acceleration: Array
    variance: Array


@dataclass(frozen=True)
class _Side:
    """Moves as they leave a rest; time runs backwards for those that reach one.

    Args:
        time: samples, (n,); angle: (n,).
        last: row of the rest's last sample, (k,); rows: how many it has, (k,); level: of the rest,
            (k,).
        end: first row after the move, (k,).
    """

    time: Array
    angle: Array
    last: Index
    rows: Index
    end: Index
    level: Array


def corners(time: Array, angle: Array, still: Mask, noise: float) -> Iterator[Corner]:
    """Both ends of every move between rests at which such a course leaves no more than the
    readout's noise.

    Args:
        time: in samples, increasing, (n,).
        angle: rad, (n,).
        still: rows of the axis' rests, (n,).
        noise: standard deviation of the readout, rad.
    """
    n = len(time)
    yield from _fitted(_side(time, angle, still), noise)
    for c in _fitted(_side(-time[::-1], angle[::-1], still[::-1]), noise):
        yield Corner(n - 1 - c.rows, c.near, -c.rate, c.acceleration, c.variance)


def edges(
    time: Array, angle: Array, still: Mask, noise: float, parted: Index = NOWHERE
) -> tuple[Array, Array]:
    """The instants at which moves leave a rest, and those at which they reach one, in samples; none
    where they cannot be determined. time: s, (n,); angle: rad, (n,).

    Args:
        time, angle, still, noise: see ``corners``.
        parted: first rows after pauses of the log, which no move and no rest goes on across.
    """
    back = len(time) - parted[::-1]
    leaves = _told(_side(time, angle, still, parted), noise)
    comes = _told(_side(-time[::-1], angle[::-1], still[::-1], back), noise)
    return leaves, -comes[::-1]


def _told(side: _Side, noise: float) -> Array:
    """When these moves leave their rests, in order: by the law of the start, one for all of them,
    that fits them the furthest.
    """
    best, powers, when = -1.0, STARTS[0], np.full(len(side.last), np.nan)
    for law in STARTS:
        total, found = _reached(side, law, noise, best)
        if total > best:
            best, powers, when = total, law, found
    for earliest, width in product((EARLIEST, HIDDEN), reversed(REACHES)):  # the widest tell best
        _tell(side, np.isnan(when), width, powers, noise, when, LOOSE, earliest)
    return when[~np.isnan(when)]


def _reached(
    side: _Side, powers: tuple[float, ...], noise: float, least: float
) -> tuple[float, Array]:
    """How many samples a law fits all these moves together, each by the widest window that it fits,
    and when they leave their rests by it; as soon as it cannot be more than ``least``, at most as
    many as that.
    """
    reach, when = np.zeros(len(side.last)), np.full(len(side.last), np.nan)
    for width in reversed(REACHES):
        if reach.sum() + width * (reach == 0).sum() <= least:
            break
        reach[_tell(side, reach == 0, width, powers, noise, when)] = width
    return float(reach.sum()), when


def _tell(
    side: _Side,
    wanted: Mask,
    width: int,
    powers: tuple[float, ...],
    noise: float,
    when: Array,
    off: float = STRICT,
    earliest: int = EARLIEST,
) -> Index:
    """Write ``when`` the wanted moves leave their rests by a window of this width; those that it
    fits.
    """
    tried = np.flatnonzero(
        wanted & (side.last + 1 + width <= side.end) & (side.rows >= REST[0] - earliest)
    )
    if not len(tried):
        return tried
    instant, fits = _instants(side, tried, width, powers, noise, off, earliest)
    when[tried[fits]] = side.time[side.last[tried[fits]]] + instant[fits]
    return tried[fits]


def _side(time: Array, angle: Array, still: Mask, parted: Index = NOWHERE) -> _Side:
    n = len(time)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    inside = parted[still[parted] & still[parted - 1]]
    first, after = np.sort(np.append(edges[::2], inside)), np.sort(np.append(edges[1::2], inside))
    limits = np.append(parted, n)
    end = np.minimum(np.append(first[1:], n), limits[np.searchsorted(limits, after)])
    left = (after < end) & (after - first >= REST[0])
    level = np.array(
        [
            angle[max(a, b - REST[1]) : b].mean()
            for a, b in zip(first[left], after[left], strict=True)
        ]
    )
    return _Side(time, angle, after[left] - 1, (after - first)[left], end[left], level)


def _fitted(side: _Side, noise: float) -> Iterator[Corner]:
    """The corners of one side, each by the window and the powers that tell its rate best among
    those that fit.
    """
    chosen: dict[int, tuple[int, tuple[float, ...], float]] = {}
    for width, powers in sorted(product(WIDTHS, POWERS), key=lambda window: _spread(*window)):
        left = np.array([k not in chosen for k in range(len(side.last))], bool)
        tried = np.flatnonzero((side.last + 1 + width <= side.end) & left)
        if not len(tried):
            continue
        instant, fits = _instants(side, tried, width, powers, noise)
        told = zip(tried[fits].tolist(), instant[fits].tolist(), strict=True)
        chosen |= {k: (width, powers, t) for k, t in told}
    for k, (width, powers, instant_k) in sorted(chosen.items()):
        yield _corner(side, k, width, powers, instant_k)


@lru_cache(maxsize=len(WIDTHS) * len(POWERS))
def _spread(width: int, powers: tuple[float, ...]) -> float:
    """What the variance of the rate just after a corner in mid-sample would be, in units of the
    readout's.
    """
    u = np.maximum(np.arange(width + 1) - 1.5, 0.0)
    return float(_variance(u, np.ones(len(powers)), powers)[u > 0][:3].sum())


def _instants(
    side: _Side,
    which: Index,
    width: int,
    powers: tuple[float, ...],
    noise: float,
    off: float = STRICT,
    earliest: int = EARLIEST,
) -> tuple[Array, Mask]:
    """The instant at which each of these moves leaves its rest, samples, (k,), and whether the
    course then fits, (k,).
    """
    rows = side.last[which, None] + np.arange(earliest, width + 1)
    time = side.time[rows] - side.time[side.last[which], None]
    y = side.angle[rows] - side.level[which, None]
    each = np.arange(len(which))
    grid = np.tile(np.arange(earliest, LATEST, COARSE), (len(which), 1))
    step, inside = COARSE, np.ones(len(which), bool)
    for zoom in range(ZOOMS + 1):
        u = np.maximum(time[:, None, :] - grid[:, :, None], 0.0)
        enough = (u > 0).sum(axis=2) >= len(powers) + 2
        left = np.where(enough, _left(u / width, y, powers), np.inf)
        at = np.argmin(left, axis=1)
        if zoom == 0:
            inside = (at > 0) & (at < grid.shape[1] - 1)
        instant, least = grid[each, at], left[each, at]
        grid = instant[:, None] + step * np.linspace(-1, 1, round(2 * ZOOM) + 1)
        step /= ZOOM
    moving = (time > instant[:, None]).sum(axis=1)
    dof = np.maximum(moving - len(powers) - 1, 1)
    # the rest has its own share of the noise
    excess = np.maximum(least - noise**2 * (len(rows[0]) - moving), 0.0)
    return instant, inside & (np.sqrt(excess / dof) <= noise * (1 + off / np.sqrt(2 * dof)))


def _left(u: Array, y: Array, powers: tuple[float, ...]) -> Array:
    """What the best sums of powers leave of each course, squares summed, (k, t). u: (k, t, n); y:
    (k, n).
    """
    columns = _powers(u, powers)
    k = len(columns)
    gram = np.empty((*u.shape[:2], k, k))
    for i, j in combinations_with_replacement(range(k), 2):
        gram[..., i, j] = gram[..., j, i] = _along(columns[i], columns[j])
    gram += 1e-14 * np.eye(k)  # none has moved: nothing to fit
    c = np.linalg.solve(
        gram, np.stack([(column @ y[:, :, None])[..., 0] for column in columns], axis=-1)[..., None]
    )[..., 0]
    rest = y[:, None, :] - sum(c[..., i, None] * column for i, column in enumerate(columns))
    return _along(rest, rest)


def _powers(u: Array, powers: tuple[float, ...]) -> list[Array]:
    """``u`` to each of these whole powers, in order: a product from one to the next."""
    found = [u ** int(powers[0])]
    for before, power in pairwise(powers):
        found.append(found[-1] * u ** int(power - before))
    return found


def _along(one: Array, other: Array) -> Array:
    """Sum of products along the last axis, (k, t)."""
    return np.asarray(np.einsum("ktn,ktn->kt", one, other))


def _corner(side: _Side, k: int, width: int, powers: tuple[float, ...], instant: float) -> Corner:
    rows = side.last[k] + np.arange(EARLIEST, width + 1)
    since = side.time[rows] - side.time[side.last[k]] - instant
    u = np.maximum(since, 0.0)
    c = np.linalg.lstsq(
        np.column_stack([u**p for p in powers]), side.angle[rows] - side.level[k], rcond=None
    )[0]
    return Corner(rows, since <= NEAR, *_rates(u, c, powers), _variance(u, c, powers))


def _rates(u: Array, c: Array, powers: tuple[float, ...]) -> tuple[Array, Array]:
    """First and second derivative of the course, (n,)."""
    v = sum((a * p * u ** (p - 1) for a, p in zip(c, powers, strict=True)), np.zeros_like(u))
    bend = sum(
        (a * p * (p - 1) * u ** (p - 2) for a, p in zip(c, powers, strict=True)), np.zeros_like(u)
    )
    return v, np.where(u > 0, bend, 0.0)


def _variance(u: Array, c: Array, powers: tuple[float, ...]) -> Array:
    """Of the rate, in units of the readout's, the instant being fitted too, (n,)."""
    v, bend = _rates(u, c, powers)
    fitted = np.column_stack([*(u**p for p in powers), -v])
    rate = np.column_stack([*(p * u ** (p - 1) for p in powers), -bend])
    scale = np.linalg.norm(fitted, axis=0) + (np.linalg.norm(fitted, axis=0) == 0)
    spread = np.linalg.pinv(fitted / scale)
    return np.asarray(((rate / scale @ spread) ** 2).sum(axis=1))
