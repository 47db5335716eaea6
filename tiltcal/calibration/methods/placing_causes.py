"""Sweeps whose visits do not repeat: single causes compared; and what no table corrects."""

from collections.abc import Iterator, Sequence

import numpy as np

from tiltcal.calibration.methods.placing_sweep import AxisTable, Sweep
from tiltcal.calibration.screen.explanations import Explanation, in_words
from tiltcal.core.arrays import Array, Index
from tiltcal.core.units import ARCSEC
from tiltcal.recordings.static_poses import Poses
from tiltcal.statistics.least_squares import linear_fit

TIME_CONSTANTS = np.geomspace(1 / 60, 1, 60)  # of a warm-up, of the length of the sweep
TRIED = 20  # changes of those that explain most alone, tried with their neighbours free
SWEPT = 0.3  # of g: range of a channel from which its scale factor is determined


def why_visits_differ(axes: Sequence[AxisTable]) -> str:
    """The single causes that would explain the sweep that repeats worst, in words."""
    pairs = [(s, t) for a in axes for s, t in zip(a.sweeps, a.solved, strict=True)]
    sweep, _ = max(pairs, key=lambda st: float(st[1].residuals @ st[1].residuals))
    return in_words(_causes(sweep), "no single cause that was tried explains it")


def _causes(s: Sweep) -> Iterator[Explanation]:
    """A warm-up, hysteresis, a step, a passing change; each beside a linear drift."""
    project = _Projection(s)
    t = (s.time - s.time[0]) / max(float(np.ptp(s.time)), 1e-9)
    m = len(t)
    warm = np.exp(-t[:, None] / TIME_CONSTANTS)
    words = "a warm-up that dies away exponentially (wait for it, or use --option drift=warm_up)"
    yield project.best(words, warm, further=1)
    way = np.sign(np.diff(s.beta, prepend=s.beta[0]))
    way[0] = way[1] if m > 1 else 0.0
    x = (s.beta - s.beta.min()) / max(float(np.ptp(s.beta)), 1e-9)
    loop = np.column_stack([way, way * np.sin(np.pi * x)])
    yield project.together("hysteresis: readings depend on the direction of approach", loop)
    first, last = np.triu_indices(m + 1, 1)
    once = (last == m) & (first > 0)
    words = "the base moved, or the bias jumped, at about {} s"
    yield project.best_box(words, first[once], last[once], s.time)
    while_off = (last - first <= m // 3) & (first > 0) & (last < m)
    words = "a bump: the base or the bias was off for a while from about {} s"
    yield project.best_box(words, first[while_off], last[while_off], s.time)


class _Projection:
    """What a sweep leaves after its table and its drift, and how much further columns take."""

    def __init__(self, sweep: Sweep) -> None:
        nodes, where = np.unique(sweep.node, return_inverse=True)
        self.root = 1 / np.sqrt(sweep.variance)
        design = np.hstack([np.eye(len(nodes))[where], (sweep.time - sweep.time.mean())[:, None]])
        u, s, _ = np.linalg.svd(design * self.root[:, None], full_matrices=False)
        self.basis = u[:, s > 1e-9 * s[0]]
        self.left = self._rest(sweep.value * self.root)

    def _rest(self, columns: Array) -> Array:
        return np.asarray(columns - self.basis @ (self.basis.T @ columns))

    def _gains(self, columns: Array) -> Array:
        """What each of some columns (m, c) alone takes from the chi-square, (c,)."""
        part = self._rest(columns * self.root[:, None])
        size = np.maximum((part * part).sum(axis=0), 1e-300)
        return np.where(size > 1e-9, (self.left @ part) ** 2 / size, 0.0)

    def best(self, words: str, columns: Array, *, further: int = 0) -> Explanation:
        """The best of some columns (m, c) alone."""
        gain = float(self._gains(columns).max())
        return self._explanation(words, gain, 1 + further, columns.shape[1])

    def best_box(self, words: str, first: Index, last: Index, time: Array) -> Explanation:
        """The best change that lasts from one dwell to before another; the dwells beside it, in
        which it may have begun or ended, are left free.
        """
        m = len(time)
        rows = np.arange(m)[:, None]
        gains = self._gains(((rows >= first) & (rows < last)).astype(float))
        found = []
        for k in np.argsort(-gains)[:TRIED]:
            box = ((rows >= first[k]) & (rows < last[k])).astype(float)
            beside = [j for j in (first[k] - 1, last[k]) if 0 <= j < m]
            named = words.format(f"{time[first[k]]:.6g}")
            found.append(self.together(named, np.hstack([box, np.eye(m)[:, beside]]), len(first)))
        return min(found, key=lambda e: e.bic)

    def together(self, words: str, columns: Array, tried: int = 1) -> Explanation:
        """All of some columns (m, c) at once."""
        part = self._rest(columns * self.root[:, None])
        u, s, _ = np.linalg.svd(part, full_matrices=False)
        u = u[:, s > 1e-6 * max(float(s[0]), 1e-12)]
        return self._explanation(words, float(((self.left @ u) ** 2).sum()), u.shape[1], tried)

    def _explanation(self, words: str, gain: float, added: int, tried: int) -> Explanation:
        n, p = len(self.left), self.basis.shape[1] + added
        chi2 = float(self.left @ self.left) - gain
        return Explanation.of(words, chi2, n - p, n, tried)


def left_uncorrected(poses: Poses, g: float) -> list[str]:
    """Scale and fixture errors of the channels across the table's axis, in words: no table holds
    them, they stay after the correction.
    """
    notes = []
    for i, axis in enumerate(poses.sensor.axes):
        f, up = g * poses.up[:, poses.sensor.axis_indices[i]], g * poses.up[:, 2]
        if axis not in "xy" or np.ptp(f) < SWEPT * g:
            continue
        across = np.hypot(f, up) > 0.9 * g  # not the dwells with this axis along the table's
        weight = 1 / np.sqrt(poses.covariances[across, i, i])
        design = np.column_stack([np.ones(len(f)), f, up])[across]
        error = (poses.means[:, i] - f)[across]
        fit = linear_fit(("bias", "scale", "lean"), design * weight[:, None], error * weight)
        if fit.dropped:
            continue
        left = float(np.sqrt(np.mean((design[:, 1:] @ fit.values[1:]) ** 2)))
        notes.append(
            f"no table corrects the scale error of {axis}, {fit.values[1]:.3g} +-"
            f" {fit.sigmas[1]:.2g}, nor the fixture misalignment (or the index error),"
            f" {fit.values[2] / ARCSEC:.4g} +- {fit.sigmas[2] / ARCSEC:.2g} arcsec:"
            f" {left / g / ARCSEC:.4g} arcsec rms stay in tilt_{axis} over this sweep; six_position"
            " corrects them"
        )
    return notes
