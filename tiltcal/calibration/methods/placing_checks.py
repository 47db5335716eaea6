"""Checks of a placing sweep: the stated mounting, clipped channels, sweeps in one direction only,
missing angles; and notes on the tables.

Sweeps whose visits do not repeat: single causes compared; and what no table corrects.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from tiltcal.calibration.methods.placing_sweep import AxisTable, Drift, Sweep
from tiltcal.calibration.screen.explanations import Explanation, in_words
from tiltcal.calibration.validity import Test, chi2_test, threshold_test
from tiltcal.core.arrays import Array, Index
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import rotation
from tiltcal.core.units import ARCSEC, DEG
from tiltcal.recordings.static_poses import Poses
from tiltcal.statistics.least_squares import linear_fit

TIME_CONSTANTS = np.geomspace(1 / 60, 1, 60)  # of a warm-up, of the length of the sweep
TRIED = 20  # changes of those that explain most alone, tried with their neighbours free
ALONG = 1e-6  # a component of a mounting by quarter turns below it is none
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


def left_uncorrected(poses: Poses, mounts: Array, g: float) -> str:
    """Scale and fixture errors of a channel across the table's axis, in words: no table holds them,
    they stay after the correction. Empty where they are not significant.

    Args:
        poses: of one channel.
        mounts: R_mount at each, (m, 3, 3).
        g: m/s2.
    """
    axis, i = poses.sensor.axes[0], poses.sensor.axis_indices[0]
    f, up = g * poses.up[:, i], g * poses.up[:, 2]
    # an axis along the table's reads its bias at the placing angle: that is the table
    across = np.abs(mounts[:, 1, i]) < ALONG
    if not across.any() or np.ptp(f[across]) < SWEPT * g:
        return ""
    weight = 1 / np.sqrt(poses.covariances[across, 0, 0])
    design = np.column_stack([np.ones(len(f)), f, up])[across]
    error = (poses.means[:, 0] - f)[across]
    fit = linear_fit(("bias", "scale", "lean"), design * weight[:, None], error * weight)
    if fit.dropped:
        return ""
    found = fit.values[1:]
    size = float(found @ np.linalg.solve(fit.covariance[1:, 1:], found))
    if chi2_test("scale and lean", size / max(fit.chi2_per_dof, 1.0), 2, "").passed:
        return ""
    left = float(np.sqrt(np.mean((design[:, 1:] @ found) ** 2)))
    return (
        f"no table corrects the scale error of {axis}, {fit.values[1]:.3g} +-"
        f" {fit.sigmas[1]:.2g}, nor the fixture misalignment (or the index error),"
        f" {fit.values[2] / ARCSEC:.4g} +- {fit.sigmas[2] / ARCSEC:.2g} arcsec:"
        f" {left / g / ARCSEC:.4g} arcsec rms stay in tilt_{axis} over this sweep; six_position"
        " corrects them"
    )


OTHER_MOUNTING = 0.3  # of g: another mounting differs by more than any error of a sensor
CLIPPED = 0.02  # of g: by which a clipped channel is too small where it is largest
QUARTERS = range(0, 360, 90)
REPEATED = 0.5  # share of the angles; with fewer repeated visits the drift is poorly known
REMOUNT = {"x": "Rz(90)", "y": "identity"}


def require_mounting(each: Sequence[Poses], which: Sequence[Index], g: float, source: str) -> None:
    """Refuse readings that contradict the stated mounting.

    Args:
        each: poses of one channel.
        which: numbers of their mountings, (m,) each.
        g: m/s2.
        source: of the recording.

    Raises:
        TiltcalError: naming the time, and the mounting that the readings look like.
    """
    for number in np.unique(np.concatenate(which)):
        mine = [
            p.subset(np.asarray(w == number))
            for p, w in zip(each, which, strict=True)
            if np.any(w == number)
        ]
        if _misfit(mine, np.eye(3), g) < OTHER_MOUNTING:
            continue
        misfits = [_misfit(mine, rotation("z", d * DEG), g) for d in QUARTERS]
        better = int(np.argmin(misfits))
        guess = ""
        if misfits[better] < OTHER_MOUNTING / 2:
            guess = f" but look like one turned by a further Rz({QUARTERS[better]})"
        start = min(p.spans[0].start_s for p in mine)
        raise TiltcalError(
            f"{source}, mounting from {start:.6g} s",
            found=f"readings up to {misfits[0]:.2g} g off the stated mounting{guess}",
            need="the mounting that was used",
            do="correct the metadata line `# mount: ...`, or rig.mount",
        )


def _misfit(each: Sequence[Poses], turn: Array, g: float) -> float:
    """The 90 % quantile over the dwells of the difference from the readings expected after a turn,
    in g, of the worst channel.

    A channel that reads too little in the right direction clips; that is not a mounting.
    """
    worst = 0.0
    for poses in each:
        expected = (poses.up @ turn)[:, poses.sensor.axis_indices[0]]
        seen = poses.means[:, 0] / g
        clipped = (
            (np.sign(seen) == np.sign(expected))
            & (np.abs(seen) < np.abs(expected))
            & (np.abs(seen) > 0.1)
        )
        off = np.where(clipped, 0.0, np.abs(seen - expected))
        worst = max(worst, float(np.quantile(off, 0.9)))
    return worst


def range_test(each: Sequence[Poses], g: float) -> Test:
    """Channels that stay at one reading where more acts on them, by name. each: of one channel."""
    clipped = []
    for poses in each:
        expected, seen = poses.up[:, poses.sensor.axis_indices[0]], poses.means[:, 0] / g
        top = np.abs(seen).max()
        at_stop = (np.abs(seen) > top - CLIPPED / 4) & (np.abs(expected) - np.abs(seen) > CLIPPED)
        if at_stop.sum() >= 3 and np.ptp(expected[at_stop]) > 2 * CLIPPED:
            acts = np.abs(expected[at_stop]).max() * g
            clipped.append(
                f"{poses.sensor.axes[0]} stays at {top * g:.4g} m/s2 on {at_stop.sum()} dwells"
                f" where up to {acts:.4g} act"
            )
    words = "no channel is clipped"
    if clipped:
        words = (
            f"saturated: {'; '.join(clipped)}; the placing angle of the other axis is wrong there"
        )
    count = len(clipped)
    return threshold_test("channels within range", count, not clipped, words, dof=len(each))


def sweep_tests(axes: Sequence[AxisTable]) -> list[Test]:
    """Sweeps in one direction, and missing angles, by name."""
    one_way = [a.axis for a in axes if any(s.repeated < REPEATED for s in a.sweeps)]
    least = min(s.both_ways for a in axes for s in a.sweeps)
    words = (
        f"{100 * least:.0f} % of the inner angles were approached from both sides, a linear drift"
        " is subtracted"
    )
    if one_way:
        words = (
            f"one-way sweep of axis {' and '.join(one_way)}: a linear drift of the zero enters the"
            " table in full and cannot be detected; sweep up and down"
        )
    return [
        threshold_test("up and down", least, not one_way, words, dof=len(axes)),
        _angles_complete(axes),
    ]


def _angles_complete(axes: Sequence[AxisTable]) -> Test:
    missing = {a.axis: a.missing for a in axes if a.missing}
    ranges = "; ".join(
        f"axis {a.axis}: {a.angles[0] / DEG:.4g} ... {a.angles[-1] / DEG:.4g} deg" for a in axes
    )
    words = f"every step was visited ({ranges})"
    if missing:
        named = "; ".join(
            f"axis {x}: {', '.join(f'{m:.4g}' for m in angles[:12])} deg"
            for x, angles in missing.items()
        )
        words = f"no dwell at {named}: interpolated between their neighbours"
    return threshold_test("angles complete", sum(map(len, missing.values())), not missing, words)


def table_notes(axes: Sequence[AxisTable], g: float, drift: Drift) -> list[str]:
    """The range and the contents of the tables, and what to record next."""
    notes = []
    for a in axes:
        first, last = a.angles[[0, -1]] / DEG
        notes.append(
            f"the table of axis {a.axis} is valid for placing angles {first:.4g} ... {last:.4g}"
            " deg; beyond, in negative or mirrored quadrants, the bias differs: those samples are"
            " left empty"
        )
        notes += _drift_notes(a, g, drift)
        notes.append(_axle_note(a, g))
    for axis in {"x", "y"} - {a.axis for a in axes}:
        notes.append(
            f"axis {axis} has no table: remount ({REMOUNT[axis]}) and sweep again; its reading is"
            " passed on unchanged"
        )
    return notes


def _drift_notes(a: AxisTable, g: float, drift: Drift) -> list[str]:
    drifts = [t.drift for t in a.solved if t.drift is not None]
    notes = []
    if drifts and drift == "warm_up":
        sizes = ", ".join(f"{d / g * 1e6:.3g} ug" for d in drifts)
        notes.append(f"warm-up of axis {a.axis}, subtracted: {sizes} at the start of each sweep")
    elif drifts:
        rates = ", ".join(f"{60 * d / g * 1e6:.3g} ug/min" for d in drifts)
        notes.append(f"drift of axis {a.axis}, subtracted: {rates}")
    if len(drifts) == len(a.solved) and not any(s.both_ways > 0.5 for s in a.sweeps):
        notes.append(
            f"axis {a.axis} was swept in one direction each time: hysteresis cannot be detected"
        )
    return notes


def _axle_note(a: AxisTable, g: float) -> str:
    """Whether the tilt of the table's axis is inside the table of a sensor axis."""
    if a.axle is None:
        return (
            "the tilt and wobble of the table's own axis are inside the table of axis"
            f" {a.axis}; a second sweep, reversed by a remount of 180 deg, separates them"
        )
    n = len(a.axle.value)
    lean = float(np.mean(a.axle.value)) / g / ARCSEC
    sigma = float(np.sqrt(a.axle.covariance.sum())) / n / g / ARCSEC
    return (
        f"table separated from sensor on axis {a.axis}: the table's axis leans by {lean:.4g} +-"
        f" {sigma:.2g} arcsec, subtracted"
    )
