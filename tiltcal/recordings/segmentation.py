"""Dwells and moves of a continuous log, found by themselves.

A window is quiet when the variance of every channel in it is near that channel's floor. The floor
is the channel's own quiet level; the limit between quiet and moving is the best split of the
logarithm of the variance ratio into two classes (Otsu 1979), never below what noise alone would
reach in that many windows.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from tiltcal.core.arrays import NOWHERE, Array, Index, Mask
from tiltcal.core.errors import TiltcalError
from tiltcal.core.quantisation import lsb_width
from tiltcal.core.units import COLUMN_UNITS, DEG, split_unit
from tiltcal.recordings.joining import joins_of
from tiltcal.recordings.means_table import MeansTable
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.stamps import require_measurable
from tiltcal.setup.pauses import breaks
from tiltcal.setup.tables import axis_of

MIN_ROWS = 4  # rows, of which any may move
NARROWEST = 6  # rows of a window
WINDOW = 0.5  # s
GUARD = WINDOW / 2  # s cut off at both ends of a dwell: hands leave, structures settle
SHORTEST = 1.0  # s, of a dwell
SET = 0.1 * DEG  # a smaller step of a readout at standstill may be the code of a coarse encoder
# rad/s: a gyro that reads steadily by more than this off its usual quiet reading is turning
STEADY = 1.0 * DEG
_MOVING = {"acceleration", "angle", "rate", "raw"}


@dataclass(frozen=True)
class Segment:
    """A dwell or a move.

    Args:
        start, end: s.
        first, last: rows, last exclusive.
        kind: ``dwell`` or ``move``.
        label: the operator's label on most of its rows, or None.
    """

    start: float
    end: float
    first: int
    last: int
    kind: str
    label: str | None = None


def _rows(table: MeansTable) -> list[Segment]:
    """Each row of a table of means as a dwell."""
    labels = [None] * len(table) if table.labels is None else table.labels
    return [
        Segment(float(t), float(t), k, k + 1, "dwell", label)
        for k, (t, label) in enumerate(zip(table.time, labels, strict=True))
    ]


def find_segments(
    recording: Recording, window: float = WINDOW, guard: float = GUARD, shortest: float = SHORTEST
) -> list[Segment]:
    """All dwells and moves of a recording, in order.

    Args:
        recording: with table, accelerometer, inclinometer or gyro columns.
        window: s, over which quiet is judged; the result hardly depends on it.
        guard: s cut off at both ends of a dwell (not at the ends of the log).
        shortest: s; a shorter standstill counts as moving.

    Raises:
        TiltcalError: no channel can distinguish standstill from motion, or the log is shorter than
            the window.
    """
    recording.require_increasing()
    if isinstance(recording, MeansTable):
        return _rows(recording)
    if len(recording) < 4:
        raise TiltcalError(
            recording.source,
            found=f"{len(recording)} row(s)",
            need="a continuous log",
            do="record longer",
        )
    groups = _signals(recording)
    if not groups:
        raise TiltcalError(
            recording.source,
            found="no table, accelerometer, inclinometer or gyro column",
            need="one that shows motion",
            do="name columns as <sensor>_<axis>_<unit>",
        )
    moving = np.zeros(len(recording), bool)
    parted = []
    for (
        rows,
        values,
        rates,
    ) in groups:  # a long window misses the edges of a move, a short one its slow parts
        quiet = np.ones(len(rows), bool)
        for width in {window, min(window, WINDOW)}:
            quiet &= _quiet(recording.time[rows], values, width, recording.source)
        moving |= _spread(
            rows, ~quiet | _turning(recording.time[rows], rates, quiet), len(recording)
        )
        parted.append(rows[breaks(recording.time[rows], values, quiet)])
    parted.append(np.searchsorted(recording.time, joins_of(recording)))
    parted.append(_settings(recording))
    return _segments(recording, ~moving, np.concatenate(parted), guard, shortest)


def _settings(recording: Recording) -> Index:
    """Rows at which a readout that stood still changes by a step, and stands still again: an angle
    that was set or typed in while the readings went on.
    """
    found = [np.zeros(0, dtype=np.intp)]
    for name in recording.column_names:
        axis = axis_of(split_unit(name)[0])
        if axis is None or COLUMN_UNITS[split_unit(name)[1] or "s"].quantity != "angle":
            continue
        angle = recording.column(name) * COLUMN_UNITS[str(split_unit(name)[1])].factor
        rows = np.flatnonzero(~np.isnan(angle))
        if len(rows) < 2:
            continue
        turned = np.abs(np.diff(angle[rows])) > SET
        beside = np.convolve(turned, np.ones(2 * MIN_ROWS + 1), "full")[MIN_ROWS:][: len(turned)]
        found.append(rows[np.flatnonzero(turned & (beside < 1.5)) + 1])  # itself alone
    return np.concatenate(found)


def dwells_at_settings(recording: Recording, angles: Iterable[Array]) -> list[Segment]:
    """The dwells of a log whose readout only says where each of them is: it goes from setting to
    setting by steps, most with a dwell, and nothing tells the moves between them. None where a
    readout follows the moves, or the log pauses wherever it steps.

    Args:
        recording: with stamps that increase.
        angles: of each axis of its table, gaps interpolated, rad, (n,) each.

    Raises:
        TiltcalError: as in ``find_segments``.
    """
    changes = [np.diff(angle) != 0 for angle in angles]
    steps = np.flatnonzero(np.any(changes, axis=0)) + 1 if changes else NOWHERE
    interval = np.diff(recording.time)
    if not len(steps) or np.setdiff1d(steps, _settings(recording)).size:
        return []
    if (interval[steps - 1] > SHORTEST + np.median(interval)).all():
        return []
    found = dwells(find_segments(recording))
    held = np.searchsorted(steps, [s.first for s in found], side="right")
    # one that is held now and then while its axis moves has none at most of its values
    return found if 2 * len(np.unique(held)) > len(steps) + 1 else []


def standstill_rows(time: Array, angles: Array, window: float = WINDOW) -> Mask:
    """Rows at which a table's readout stands still, (n,). angles: rad, (n, axes)."""
    if len(time) < 3:
        return np.ones(len(time), bool)
    return _quiet(time, angles, window, "readout")


def can_show_standstill(time: Array, window: float = WINDOW) -> bool:
    """Whether rows are enough to distinguish standstill from motion: more than one window. time: s,
    (n,); window: s.
    """
    return len(time) < MIN_ROWS or len(time) > _width(time, window)


def _width(time: Array, window: float) -> int:
    """Rows of a window, s; all rows where most stamps repeat."""
    step = float(np.median(np.diff(time)))
    return max(round(min(window / step, len(time))) if step else len(time), NARROWEST)


def _signals(recording: Recording) -> list[tuple[npt.NDArray[np.intp], Array, Array]]:
    """Rows, all moving channels as written (n, k), and those among them that are rates in rad/s (n,
    j), of each block.
    """
    found = []
    for block in recording.blocks:
        columns, rates = [], []
        for name, values in block.columns.items():
            unit = COLUMN_UNITS[split_unit(name)[1] or "s"]
            if unit.quantity in _MOVING:
                stamps = recording.time if block.rows is None else recording.time[block.rows]
                require_measurable(values, stamps, name, recording.source)
                columns.append(values)
            if unit.quantity == "rate":
                rates.append(values * unit.factor)
        rows = np.arange(len(recording)) if block.rows is None else block.rows
        if columns and len(rows):
            found.append((rows, np.column_stack(columns), np.array(rates).reshape(-1, len(rows)).T))
    return found


def _turning(time: Array, rates: Array, quiet: Mask) -> Mask:
    """Rows of a steady turn: quiet, but a gyro reads more than STEADY off its usual quiet reading,
    (n,).
    """
    turning = np.zeros(len(time), bool)
    if not quiet.any() or len(time) < 2:
        return turning
    width = max(round(WINDOW / float(np.median(np.diff(time)))), 1)
    first = np.clip(np.arange(len(time)) - width // 2, 0, max(len(time) - width, 0))
    last = np.minimum(first + width, len(time))
    counted = np.cumsum(np.concatenate([[0], quiet]))
    whole = counted[last] - counted[first] == last - first  # windows without any motion
    for rate in rates.T:
        total = np.cumsum(np.concatenate([np.zeros(1), rate]))
        mean = (total[last] - total[first]) / (last - first)
        turning |= whole & (np.abs(mean - np.median(mean[quiet])) > STEADY)
    return turning


def _quiet(time: Array, values: Array, window: float, source: str) -> Mask:
    n = len(time)
    if n < MIN_ROWS:
        return np.ones(n, bool)
    width = _width(time, window)
    if n <= width:
        raise TiltcalError(
            source,
            found=f"{n} rows",
            need=f"more than one window of {width} rows",
            do="record longer",
        )
    ratio = np.zeros(n - width + 1)
    for column in values.T:
        np.maximum(ratio, _variance_ratio(np.ascontiguousarray(column), width), out=ratio)
    score = np.log10(np.maximum(ratio, 1e-3))
    return _cover(score <= _limit(score, values.shape[1], width), width, n)


def _variance_ratio(column: Array, width: int) -> Array:
    """Variance of one channel in every full window over its quiet floor, (n - width + 1,).

    The floor is the tenth percentile of the windows, not below what rounding makes.
    """
    centred = column - column.mean()
    squares = centred * centred
    total = np.cumsum(squares)
    s, q = np.cumsum(centred), total
    variance = q[width - 1 :].copy()
    variance[1:] -= q[:-width]
    mean = s[width - 1 :].copy()
    mean[1:] -= s[:-width]
    variance -= mean * mean / width
    variance /= width - 1
    quantile = float(np.quantile(variance[:: max(1, width // 2)], 0.1))
    arithmetic = 64 * np.finfo(float).eps * total[-1] / width
    return variance / max(quantile, lsb_width(column) ** 2 / 12, arithmetic, 1e-30)


def _limit(score: Array, channels: int, width: int) -> float:
    """The split between quiet and moving windows, on the log10 scale."""
    from scipy.special import chdtri  # inverse of the chi-square survival function

    n = len(score) * channels
    # floor sits at the 10 % quantile of quiet windows; the largest of n quiet ones at the (1 -
    # 1e-3/n) quantile
    noise = float(np.log10(chdtri(width - 1, 1e-3 / n) / chdtri(width - 1, 0.9)))
    if score.max() <= noise:
        return noise
    counts, edges = np.histogram(score, bins=128)
    centres = (edges[:-1] + edges[1:]) / 2
    weight = np.cumsum(counts) / counts.sum()
    mean = np.cumsum(counts * centres) / counts.sum()
    with np.errstate(divide="ignore", invalid="ignore"):
        between = (mean[-1] * weight - mean) ** 2 / (weight * (1 - weight))
    return max(float(edges[1:][np.nanargmax(np.where(np.isfinite(between), between, -1.0))]), noise)


def _cover(quiet: Mask, width: int, n: int) -> Mask:
    """Rows covered by at least one quiet window, (n,)."""
    steps = np.zeros(n + 1, np.int32)
    steps[: len(quiet)] += quiet
    steps[width : width + len(quiet)] -= quiet
    return np.cumsum(steps[:-1]) > 0


def _spread(rows: npt.NDArray[np.intp], mask: Mask, n: int) -> Mask:
    """A mask known on some rows, extended over the rows between them."""
    if len(rows) == n:
        return mask
    where = np.clip(np.searchsorted(rows, np.arange(n), side="right") - 1, 0, len(rows) - 1)
    return mask[where]


def _segments(
    recording: Recording, still: Mask, parted: Index, guard: float, shortest: float
) -> list[Segment]:
    time = recording.time
    changes = np.flatnonzero(np.diff(still.astype(int))) + 1
    # a pause of the log may hide the move from one dwell to the next
    inside = parted[still[parted] & still[parted - 1]]
    edges = [0, *np.union1d(changes, inside).tolist(), len(time)]
    found: list[Segment] = []
    for first, last in pairwise(edges):
        dwell = bool(still[first])
        if dwell:
            cut_first = first if first == 0 else int(np.searchsorted(time, time[first] + guard))
            cut_last = (
                last
                if last == len(time)
                else int(np.searchsorted(time, time[last - 1] - guard, side="right"))
            )
            dwell = cut_last - cut_first >= 3 and time[last - 1] - time[first] >= shortest
            if dwell:
                first, last = cut_first, cut_last
        kind = "dwell" if dwell else "move"
        label = majority(recording, first, last)
        found.append(Segment(float(time[first]), float(time[last - 1]), first, last, kind, label))
    return found


def majority(recording: Recording, first: int, last: int) -> str | None:
    """The label on most of these rows; None when most have none."""
    if recording.labels is None:
        return None
    labels = [str(w) for w in recording.labels[first:last] if w]
    if 2 * len(labels) < last - first:
        return None
    values, counts = np.unique(labels, return_counts=True)
    return str(values[np.argmax(counts)])


def dwells(segments: Iterable[Segment]) -> list[Segment]:
    """The dwells among them."""
    return [s for s in segments if s.kind == "dwell"]
