"""The sweeps behind a placing-angle table: visits of each angle, up and down; the drift, and the
table's own axis, are separated from the sensor.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import pairwise
from typing import Literal

import numpy as np
import numpy.typing as npt

from tiltcal.core.arrays import Array
from tiltcal.core.frames import parse_mounts
from tiltcal.core.units import DEG
from tiltcal.effects.sensor.dynamics import placing_angle
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.references import NO_REFERENCES, References
from tiltcal.recordings.segmentation import GUARD, Segment
from tiltcal.recordings.static_poses import Poses
from tiltcal.setup.setup import Setup
from tiltcal.statistics.least_squares import CommonErrors

SAME = 0.02 * DEG  # dwells nearer than this are at one angle
Drift = Literal["linear", "warm_up"]
DRIFTS: tuple[Drift, ...] = ("linear", "warm_up")
OFF_GRID = 0.1  # of a step


@dataclass(frozen=True)
class Sweep:
    """The dwells of one mounting in which one axis lies along the table's.

    Args:
        axis: x or y; sign: +1 when it points North, -1 when it was turned round by 180 deg.
        node: number of the angle each dwell stands at, on the grid common to all sweeps of an axis,
            (m,).
        beta: its placing angle, rad; time: of its middle, s; value: its mean reading, m/s2;
            variance: of that mean, (m,).
        references: what uncertain references add to the readings, (q, m, 1).
    """

    axis: str
    sign: int
    node: npt.NDArray[np.intp]
    beta: Array
    time: Array
    value: Array
    variance: Array
    references: References = NO_REFERENCES

    def solve(self, drift: Drift = "linear") -> "Table":
        """Table entries and a drift of the zero: ``y = b_node + d (t - t_mid)``, or a warm-up,
        ``y = b_node + d exp(-(t - t_0) / T)`` with the T that leaves least.

        Least squares in closed form; the drift is determined by repeated visits only.
        """
        if drift == "linear":
            return self._solve(self.time - float(np.mean(self.time)))
        elapsed = self.time - self.time[0]
        tried = np.geomspace(1 / 60, 1, 40) * max(float(elapsed[-1]), 1e-9)
        tables = [self._solve(np.exp(-elapsed / constant)) for constant in tried]
        return min(tables, key=lambda t: float(t.residuals @ t.residuals))

    def _solve(self, t: Array) -> "Table":
        """Entries and the size of one course of the drift, t (m,)."""
        nodes, where = np.unique(self.node, return_inverse=True)
        w = 1 / self.variance
        average = (where == np.arange(len(nodes))[:, None]) * w
        weight = average.sum(axis=1)
        average /= weight[:, None]
        # what references add goes the same way as the readings
        common = self.references.along(np.ones((len(w), 1)))
        y = np.column_stack([self.value, common.columns])
        mean_t, mean_y = average @ t, average @ y
        dt, dy = t - mean_t[where], y - mean_y[where]
        information = float(np.sum(w * dt * dt))
        repeats = np.bincount(where) > 1
        drifting = bool(information > 0 and repeats.sum() >= 2)
        drift = (w * dt) @ dy / information if drifting else np.zeros(y.shape[1])
        noise = np.diag(1 / weight)
        if drifting:
            noise += np.outer(mean_t, mean_t) / information
        entries = mean_y - np.outer(mean_t, drift)
        residuals = (dy - np.outer(dt, drift)) * np.sqrt(w)[:, None]
        return Table(
            nodes,
            average @ self.beta,
            entries[:, 0],
            noise,
            residuals[:, 0],
            len(nodes) + drifting,
            float(drift[0]) if drifting else None,
            CommonErrors(entries[:, 1:], common.fitted),
            CommonErrors(residuals[:, 1:], common.fitted),
        )

    @property
    def repeated(self) -> float:
        """Share of the angles that were visited more than once: these determine the drift."""
        return float(np.mean(np.unique(self.node, return_counts=True)[1] > 1))

    @property
    def both_ways(self) -> float:
        """Share of the inner angles that were approached from both sides."""
        came = np.sign(np.diff(self.beta, prepend=np.nan))
        up, down = set(self.node[came > 0]), set(self.node[came < 0])
        inner = set(self.node) - {self.node.min(), self.node.max()}
        return len(inner & up & down) / max(len(inner), 1)


@dataclass(frozen=True)
class Table:
    """Bias against placing angle, solved.

    Args:
        node: numbers of the angles, (n,); beta: mean angle, rad; value: m/s2.
        noise: covariance by the noise of the record, (n, n).
        residuals: whitened, of the single visits; rank: parameters fitted to them; drift: m/s2 per
            s, None if not seen.
        common: what uncertain references change in the entries, m/s2, and ``visits`` in the
            whitened residuals.
    """

    node: npt.NDArray[np.intp]
    beta: Array
    value: Array
    noise: Array
    residuals: Array
    rank: int
    drift: float | None
    common: CommonErrors
    visits: CommonErrors

    @property
    def covariance(self) -> Array:
        """Of the entries by noise and stated references, (n, n)."""
        stated = self.common.columns[:, self.common.fitted]
        return np.asarray(self.noise + stated @ stated.T)

    def at_nodes(self, node: npt.NDArray[np.intp]) -> "Table":
        """The entries at some of the nodes. node: numbers of the nodes, (n,)."""
        keep = np.isin(self.node, node)
        return replace(
            self,
            node=self.node[keep],
            beta=self.beta[keep],
            value=self.value[keep],
            noise=self.noise[np.ix_(keep, keep)],
            common=self.common.times(np.eye(len(keep))[keep]),
        )


@dataclass(frozen=True)
class AxisTable:
    """All that was found about one axis.

    Args:
        axis: x or y; start, step: of the grid, rad.
        sensor: its table; axle: elevation of the table's axis as a reading, m/s2, where a reversed
            sweep split it off.
        sweeps: what it came from; solved: each of them.
    """

    axis: str
    start: float
    step: float
    sensor: Table
    axle: Table | None
    sweeps: tuple[Sweep, ...]
    solved: tuple[Table, ...]

    @property
    def angles(self) -> Array:
        """Nominal angle of each entry, rad, (n,)."""
        return np.asarray(self.start + self.sensor.node * self.step, dtype=float)

    @property
    def missing(self) -> list[float]:
        """Angles of the grid without a dwell, deg."""
        first, last = self.sensor.node[[0, -1]]
        absent = sorted(set(range(first, last + 1)) - set(self.sensor.node.tolist()))
        return [(self.start + k * self.step) / DEG for k in absent]


def split_at_remounts(
    segments: Sequence[Segment], recording: Recording, setup: Setup
) -> list[Segment]:
    """Dwells split where the mounting changes, with a guard time: a remount between two rests need
    not be visible as a move.
    """
    found: list[Segment] = []
    time = recording.time
    starts = [when for when, _ in mountings(recording, setup)[1:]]
    for s in segments:
        cuts = [when for when in starts if s.start - GUARD < when < s.end + GUARD]
        for after, before in pairwise([-np.inf, *cuts, np.inf]):
            first = max(s.first, int(np.searchsorted(time, after + GUARD)))
            last = min(s.last, int(np.searchsorted(time, before - GUARD, side="right")))
            if last > first:
                start, end = float(time[first]), float(time[last - 1])
                found.append(replace(s, start=start, end=end, first=first, last=last))
    return found


def mountings(recording: Recording, setup: Setup) -> list[tuple[float, Array]]:
    """(from time, R_mount) of each mounting."""
    return parse_mounts(recording.metadata.get("mount", setup.rig.mount))


def mounting_of(
    poses: Poses, recording: Recording, setup: Setup
) -> tuple[npt.NDArray[np.intp], list[Array]]:
    """Number of the mounting of each pose, (m,), and the mountings."""
    stated = mountings(recording, setup)
    starts = np.array([when for when, _ in stated])
    middle = np.array([(s.start_s + s.end_s) / 2 for s in poses.spans])
    return np.searchsorted(starts, middle, side="right") - 1, [R for _, R in stated]


def mounts_of(poses: Poses, recording: Recording, setup: Setup) -> Array:
    """R_mount at each pose, (m, 3, 3)."""
    which, mounts = mounting_of(poses, recording, setup)
    return np.array(mounts)[which]


def find_sweeps(
    poses: Poses, recording: Recording, setup: Setup, axis: str
) -> tuple[list[Sweep], tuple[float, float], list[str]]:
    """All sweeps of one axis, the (start, step) of their grid, and notes on dwells that were left
    out.
    """
    which, _ = mounting_of(poses, recording, setup)
    channel = poses.sensor.axes.index(axis)
    # North component of the axis, whatever the table does
    lying = mounts_of(poses, recording, setup)[:, 1, "xyz".index(axis)]
    used = np.abs(np.abs(lying) - 1) < 1e-6
    if not used.any():
        return [], (0.0, 0.0), []
    beta = placing_angle(axis, poses.up)
    start, step = _grid(beta[used])
    node = np.round((beta - start) / step).astype(np.intp) if step else np.zeros(len(beta), np.intp)
    off = used & (np.abs(beta - start - node * step) > OFF_GRID * step)
    notes = []
    if off.any():
        angles = ", ".join(f"{b / DEG:.4g}" for b in beta[off][:6])
        notes.append(
            f"dwells off the steps of {step / DEG:.4g} deg are not used: axis {axis} at"
            f" {angles} deg"
        )
    time = np.array([(s.start_s + s.end_s) / 2 for s in poses.spans])
    variance = poses.covariances[:, channel, channel]
    value = poses.means[:, channel] - setup.site.gravity * poses.up[:, "xyz".index(axis)]
    sweeps = []
    for number in np.unique(which[used & ~off]):
        k = np.flatnonzero(used & ~off & (which == number))
        sweeps.append(
            Sweep(
                axis,
                int(np.sign(lying[k[0]])),
                node[k],
                beta[k],
                time[k],
                value[k],
                variance[k],
                poses.references.at(k).of([channel]),
            )
        )
    return sweeps, (start, step), notes


def _grid(beta: Array) -> tuple[float, float]:
    """First angle and step, rad: what the operator dialled, to a thousandth of a degree."""
    ordered = np.sort(beta)
    gaps = np.diff(ordered)
    gaps = gaps[gaps > SAME]
    step = round(float(np.median(gaps)) / DEG, 3) if len(gaps) else 0.0
    first = float(ordered[ordered <= ordered[0] + SAME].mean()) / DEG
    if step and abs(first / step - round(first / step)) < OFF_GRID:
        first = round(first / step) * step
    return round(first, 3) * DEG, step * DEG


def solve_axis(
    axis: str, sweeps: Sequence[Sweep], grid: tuple[float, float], drift: Drift = "linear"
) -> AxisTable:
    """One table of an axis from all its sweeps; a sweep reversed by 180 deg separates the table's
    axis from the sensor.

    With the axis pointing North a dwell reads b + e, reversed b - e (e: elevation of the table's
    axis as a reading): half the sum is b, half the difference e. The part of e that is odd in the
    table's angle stays in b.

    Source: docs/physics.md, "Placing-angle tables".
    """
    solved = [s.solve(drift) for s in sweeps]
    forth = [t for s, t in zip(sweeps, solved, strict=True) if s.sign > 0]
    back = [t for s, t in zip(sweeps, solved, strict=True) if s.sign < 0]
    axle = None
    if forth and back:
        plus, minus = _at_common_nodes([_average(forth), _average(back)])
        sensor = _combined([plus, minus], [0.5, 0.5])
        axle = replace(_combined([plus, minus], [0.5, -0.5]), beta=sensor.beta)
    else:
        sensor = _average(forth or back)
    nominal = grid[0] + sensor.node * grid[1]
    if len(nominal) > 1:  # to the nominal angles, along the slope of the table
        slope = np.gradient(sensor.value, sensor.beta)
        sensor = replace(sensor, value=sensor.value + slope * (nominal - sensor.beta))
    return AxisTable(axis, *grid, sensor, axle, tuple(sweeps), tuple(solved))


def _average(tables: Sequence[Table]) -> Table:
    """Plain mean of tables over the nodes they share."""
    if len(tables) == 1:
        return tables[0]
    return _combined(_at_common_nodes(tables), [1 / len(tables)] * len(tables))


def _combined(tables: Sequence[Table], weights: Sequence[float]) -> Table:
    """A weighted sum of tables over the same nodes; the angle is their mean."""
    pairs = list(zip(weights, tables, strict=True))
    columns = np.sum([w * t.common.columns for w, t in pairs], axis=0)
    return replace(
        tables[0],
        value=np.sum([w * t.value for w, t in pairs], axis=0),
        beta=np.mean([t.beta for t in tables], axis=0),
        noise=np.sum([w * w * t.noise for w, t in pairs], axis=0),
        common=replace(tables[0].common, columns=columns),
    )


def _at_common_nodes(tables: Sequence[Table]) -> list[Table]:
    """The entries of several tables at the nodes that all of them have."""
    common = reduce(np.intersect1d, [t.node for t in tables])
    return [t.at_nodes(common) for t in tables]
