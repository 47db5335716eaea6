"""Gravity's direction carried across a hand turn by the gyro, and how small errors of force and
rate change the result.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.setup.pauses import pauses

WILD = 1e3  # rad/s: beyond it a trial of sizes is absurd, and its rotation would not be a number
EDGE = 0.5  # s at the edge of a standstill over which gravity's direction is averaged
LONGEST = 20.0  # s of a turn over which a gyro is trusted


def turns_between(time: Array, stop: Index) -> list[tuple[int, int]]:
    """Last row of each dwell and first row of the next, where both are long enough to know
    gravity's direction, and the log does not pause between.

    Args:
        time: s, (n,).
        stop: number of the dwell at each row, (n,).
    """
    edges: list[tuple[int, int]] = []
    resumes = pauses(time)
    for k in range(int(stop.max(initial=-1))):
        before, after = np.flatnonzero(stop == k), np.flatnonzero(stop == k + 1)
        if min(len(before), len(after)) <= 8 or time[after[0]] - time[before[-1]] >= LONGEST:
            continue
        if not ((resumes > before[-1]) & (resumes <= after[0])).any():
            edges.append((int(before[-1]), int(after[0])))
    return edges


@dataclass(frozen=True)
class Windows:
    """The rows of some turns with the edges of the standstills around them, all as long as the
    longest: (m, L).

    Args:
        rows: of the recording; the last one again where a turn is shorter.
        step: s to the next row, (m, L - 1); 0 beyond the end.
        before, after: weight of each row in the mean direction before and after the turn.
        middle: row in the middle of each turn, (m,).
    """

    rows: Index
    step: Array
    before: Array
    after: Array
    middle: Index

    @classmethod
    def around(cls, time: Array, spans: Sequence[tuple[int, int]]) -> "Windows":
        """The windows of turns given by the last row before and the first row after each.

        Args:
            time: s, (n,).
            spans: first and last row of each turn.
        """
        reach = max(round(EDGE / float(np.median(np.diff(time)))), 4)
        starts = np.array([max(first - reach, 0) for first, _ in spans])
        ends = np.array([min(last + reach, len(time) - 1) for _, last in spans])
        rows = np.minimum(
            starts[:, None] + np.arange(int((ends - starts).max()) + 1), ends[:, None]
        )
        there = starts[:, None] + np.arange(rows.shape[1]) <= ends[:, None]
        before = (rows <= np.array([first for first, _ in spans])[:, None]) & there
        after = (rows >= np.array([last for _, last in spans])[:, None]) & there
        share = [mask / mask.sum(axis=1, keepdims=True) for mask in (before, after)]
        middle = np.array([(a + b) // 2 for a, b in spans])
        return cls(rows, np.diff(time[rows], axis=1), share[0], share[1], middle)


class GravityTransport:
    """Directions of the force around turns, in the frame before each, as the gyro carries them.

    Every sample at the edges of the standstills is carried: a hand is never quite still there.

    Args:
        windows: of m turns.
        force, rate: of all rows, body frame, (n, 3).
    """

    def __init__(self, windows: Windows, force: Array, rate: Array) -> None:
        self.windows = windows
        f, w = force[windows.rows], np.clip(np.nan_to_num(rate[windows.rows]), -WILD, WILD)
        self._length = np.linalg.norm(f, axis=2)
        self._turn = (w[:, :-1] + w[:, 1:]) / 2 * windows.step[:, :, None]
        self._attitude = running(quaternions(self._turn))
        self._unit = f / self._length[:, :, None]
        self._carried = np.einsum("mlij,mlj->mli", matrices(self._attitude), self._unit)
        self._means = tuple(
            np.einsum("ml,mli->mi", share, self._carried)
            for share in (windows.before, windows.after)
        )

    @property
    def errors(self) -> Array:
        """Direction after each turn minus that before, (m, 3)."""
        before, after = (mean / np.linalg.norm(mean, axis=1)[:, None] for mean in self._means)
        return np.asarray(after - before)

    @cached_property
    def slopes(self) -> tuple[Array, Array]:
        """Change of the errors by one of each component of force and rate at each row of the
        windows, (m, 3, L, 3) each.

        A small turn ``d`` of the body at row l carries all later directions c by d x c: a row's
        rate changes the mean direction by its own turn across the sum of all later ones.
        """
        windows = self.windows
        R = matrices(self._attitude)
        middle = matrices(products(self._attitude[:, :-1], quaternions(self._turn / 2)))
        to_force, to_rate = np.zeros((2, *windows.rows.shape, 3, 3))
        lateral = (np.eye(3) - self._unit[..., :, None] * self._unit[..., None, :]) / self._length[
            ..., None, None
        ]
        for sign, share, mean in zip(
            (-1.0, 1.0), (windows.before, windows.after), self._means, strict=True
        ):
            length = np.linalg.norm(mean, axis=1)
            unit = mean / length[:, None]
            across = (
                sign * (np.eye(3) - unit[:, :, None] * unit[:, None, :]) / length[:, None, None]
            )
            to_force += np.einsum(
                "mij,ml,mljk,mlkn->mlin", across, share, R, lateral, optimize=True
            )
            later = np.cumsum((share[:, :, None] * self._carried)[:, ::-1], axis=1)[:, ::-1][:, 1:]
            half = np.einsum(
                "mij,mljk,mlkn,ml->mlin",
                across,
                -cross_matrices(later),
                middle,
                windows.step / 2,
                optimize=True,
            )
            to_rate[:, :-1] += half
            to_rate[:, 1:] += half
        return np.moveaxis(to_force, 1, 2), np.moveaxis(to_rate, 1, 2)

    def answer(self, slopes: Array, change: Array) -> Array:
        """Change of the errors by changes of force or rate at all rows, (n, 3, p) -> (m, 3, p)."""
        m, _, L, _ = slopes.shape
        return np.asarray(
            slopes.reshape(m, 3, 3 * L)
            @ change[self.windows.rows].reshape(m, 3 * L, change.shape[2])
        )


def quaternions(turn: Array) -> Array:
    """Quaternions (x, y, z, w) of rotation vectors, (..., 3) -> (..., 4)."""
    angle = np.linalg.norm(turn, axis=-1, keepdims=True)
    return np.concatenate([turn * np.sinc(angle / (2 * np.pi)) / 2, np.cos(angle / 2)], axis=-1)


def running(q: Array) -> Array:
    """Running products 1, q1, q1 q2, ... of quaternions along the second axis, (m, l, 4) -> (m, l +
    1, 4): within pieces of the square root of the length, all at once, then from piece to piece.
    """
    turns, length = q.shape[:2]
    size = int(np.ceil(np.sqrt(length + 1)))
    count = -(-(length + 1) // size)
    total = np.zeros((4, turns, count * size))
    total[3] = 1.0
    total[:, :, 1 : length + 1] = np.moveaxis(q, -1, 0)
    pieces = total.reshape(4, turns, count, size).transpose(0, 3, 1, 2).copy()
    for k in range(1, size):
        pieces[:, k] = _product(pieces[:, k - 1], pieces[:, k])
    for k in range(1, count):
        pieces[..., k] = _product(pieces[:, -1:, :, k - 1], pieces[..., k])
    found = pieces.transpose(2, 3, 1, 0).reshape(turns, count * size, 4)[:, : length + 1]
    return np.asarray(found / np.linalg.norm(found, axis=-1, keepdims=True))


def products(a: Array, b: Array) -> Array:
    """Products of quaternions, (..., 4)."""
    return np.moveaxis(_product(np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)), 0, -1)


def _product(a: Array, b: Array) -> Array:
    """Products of quaternions, (4, ...)."""
    x, y, z, w = a
    i, j, k, s = b
    return np.stack(
        [
            w * i + x * s + y * k - z * j,
            w * j - x * k + y * s + z * i,
            w * k + x * j - y * i + z * s,
            w * s - x * i - y * j - z * k,
        ]
    )


def matrices(q: Array) -> Array:
    """Rotation matrices of unit quaternions (x, y, z, w), (..., 4) -> (..., 3, 3)."""
    from scipy.spatial.transform import Rotation

    found = Rotation.from_quat(q.reshape(-1, 4)).as_matrix()
    return np.asarray(found.reshape(*q.shape[:-1], 3, 3))


def cross_matrices(v: Array) -> Array:
    """The matrices of v x, (..., 3) -> (..., 3, 3)."""
    x, y, z = np.moveaxis(v, -1, 0)
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
