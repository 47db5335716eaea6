"""Readings of a hand-turned sensor without most of their noise, and without gaps."""

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tiltcal.core.arrays import Array, Index
from tiltcal.core.units import COLUMN_UNITS, split_unit
from tiltcal.forward.gravity_transport import EDGE
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import dwells, find_segments
from tiltcal.setup.sensor import Sensor
from tiltcal.statistics.least_squares import column_space


def quiet_readings(sensor: Sensor, motion: Recording, stop: Index | None = None) -> Array:
    """A triad's readings without gaps, and a gyro's without most of its noise, (m, 3): that would
    be taken for motion.
    """
    return _smooth(sensor, motion, stop)[0]


def independent_readings(sensor: Sensor, motion: Recording, stop: Index) -> Array:
    """Quiet readings of a triad, of a gyro each predicted by the other samples, (m, 3): the noise
    of a sample would explain itself.
    """
    return leave_one_out(bridged(sensor, motion), *_smooth(sensor, motion, stop))


def _smooth(sensor: Sensor, motion: Recording, stop: Index | None) -> tuple[Array, Array]:
    """A triad's quiet readings, and the weight of each sample in its own, (m, 3)."""
    y = bridged(sensor, motion)
    if sensor.kind != "gyro":
        return y, np.ones(y.shape)
    samples = motion.sensor(sensor)
    stop = stops_of(motion) if stop is None else stop
    return smoothed(samples.time, y, stop[samples.rows])


# of what is left by the shortest window: a longer one that leaves more has cut into the motion
LEVEL = 1.03
DEGREE = 4  # of the local polynomials
# of the samples of a window: directions that have no more information stay at zero
MIN_WEIGHT = 1e-12
AT_ONCE = 2**14  # windows
HALF_WINDOWS = (3, 4, 5, 6, 8, 10, 12, 15)  # samples


def smoothed(time: Array, values: Array, stop: Index) -> tuple[Array, Array]:
    """Rates of a hand-held body without most of their noise, (m, k): local quartics while moving,
    means at standstill; and the weight of each sample in its own value, (m, k).

    The window is the longest that leaves no more of any channel than the shorter ones do (their
    residual is noise only).

    Args:
        time: s, increasing, (m,).
        values: (m, k).
        stop: number of the dwell of each, -1 while moving, (m,).
    """
    found, weight = values.copy(), np.ones(values.shape)
    if len(values) < 4 * HALF_WINDOWS[-1]:
        return found, weight
    trials = [_quartics(time, values, half) for half in HALF_WINDOWS]
    for k in range(values.shape[1]):
        left = np.array(
            [
                np.std(values[:, k] - smooth[:, k]) / np.sqrt(1 - own.mean())
                for smooth, own in trials
            ]
        )
        good = [j for j in range(len(left)) if left[j] <= LEVEL * left[: j + 1].min()]
        smooth, own = trials[max(good)]
        found[:, k], weight[:, k] = smooth[:, k], own
    for number in range(int(stop.max(initial=-1)) + 1):
        there = stop == number
        found[there], weight[there] = values[there].mean(axis=0), 1 / there.sum()
    return found, weight


def leave_one_out(values: Array, smooth: Array, weight: Array) -> Array:
    """Prediction of each sample by a smoother of all others, (m, k), free of its own noise.

    A regressor with the noise of its own sample would explain that noise (jackknife instrumental
    variables: Angrist, Imbens, Krueger, J. Appl. Econometrics 14, 1999).

    Args:
        values, smooth: as read and smoothed linearly.
        weight: of each sample in its own value; all (m, k). A sample that nothing else determines
            (weight 1) stays as it is.
    """
    others = 1 - weight
    known = others > MIN_WEIGHT
    return np.where(known, (smooth - weight * values) / np.where(known, others, 1.0), smooth)


def _quartics(time: Array, values: Array, half: int) -> tuple[Array, Array]:
    """Local quartic fits over 2 half + 1 samples, (m, k), and the weight of each sample in its own
    value, (m,). time: (m,); values: (m, k).
    """
    padded = [np.pad(each, half, mode="reflect", reflect_type="odd") for each in (time, *values.T)]
    found, own = np.empty_like(values), np.empty(len(time))
    for first in range(0, len(time), AT_ONCE):
        part = slice(first, min(first + AT_ONCE, len(time)))
        stamps, *read = (
            sliding_window_view(each[first : part.stop + 2 * half], 2 * half + 1) for each in padded
        )
        found[part], own[part] = _at_middles(stamps, read)
    return found, own


def _at_middles(time: Array, values: Sequence[Array]) -> tuple[Array, Array]:
    """The quartics through windows at their middles, (m, k), and the weights of the samples there
    in them, (m,). time: (m, w); values: of each channel, (m, w).
    """
    since = time - time[:, [time.shape[1] // 2]]
    u = since / np.abs(since).max(axis=1, keepdims=True)
    power, sums, along = np.ones_like(u), [], []
    for p in range(2 * DEGREE + 1):
        sums.append(power.sum(axis=1))
        if p <= DEGREE:
            along.append([np.einsum("mw,mw->m", power, y) for y in values])
        power = power * u
    orders = np.arange(DEGREE + 1)
    gram = np.moveaxis(np.array(sums)[orders[:, None] + orders], 2, 0)
    # next to a long pause the near samples do not determine the curvature
    gram += MIN_WEIGHT * time.shape[1] * np.eye(DEGREE + 1)
    level = np.zeros((len(u), DEGREE + 1, 1))
    level[:, 0] = 1.0
    weights = np.linalg.solve(gram, level)[:, :, 0]
    return np.einsum("mp,pkm->mk", weights, np.array(along)), weights[:, 0]


def bridged(sensor: Sensor, motion: Recording) -> Array:
    """A triad's readings without gaps, (m, k)."""
    samples = motion.sensor(sensor)
    return _bridged(samples.time, samples.values)


def _bridged(time: Array, values: Array) -> Array:
    """Values with what is missing interpolated, channel by channel, (m, k)."""
    found = values.copy()
    for column in found.T:
        missing = np.isnan(column)
        if missing.any() and not missing.all():
            column[missing] = np.interp(time[missing], time[~missing], column[~missing])
    return found


TREMOR = 1.0  # s, within which a hand trembles: what is slower is drift
MOVED = 0.5  # share of a FOG's variance that a triad has to explain
BY_CHANCE = 1e-6  # that noise makes a triad explain so much
CORRELATED = 2.0  # samples of filtered noise that hold as much information as one


def stops_of(motion: Recording) -> Index:
    """Number of the dwell of each row, -1 while moving, (n,). A hand that trembles does not stand
    still: there a FOG reads more of the motion that a gyro triad reads than of its own noise.
    """
    stop, count = np.full(len(motion), -1, dtype=np.intp), 0
    rates = _rates(motion)
    fogs = [values for values in rates if values.shape[1] == 1]
    triads = [values for values in rates if values.shape[1] == 3]
    for s in dwells(find_segments(motion)):
        rows = slice(s.first, s.last)
        pairs = product(fogs, triads)
        if not any(_trembles(motion.time[rows], fog[rows], gyro[rows]) for fog, gyro in pairs):
            stop[rows] = count
            count += 1
    return stop


def _rates(motion: Recording) -> list[Array]:
    """What each rate sensor read, as written, at all rows, NaN where it was not sampled, (n, k)."""
    found: dict[str, list[Array]] = {}
    for block in motion.blocks:
        rows = slice(None) if block.rows is None else block.rows
        for name, values in block.columns.items():
            stem, unit = split_unit(name)
            if unit is not None and COLUMN_UNITS[unit].quantity == "rate":
                full = np.full(len(motion), np.nan)
                full[rows] = values
                found.setdefault(stem.rpartition("_")[0], []).append(full)
    return [np.column_stack(columns) for columns in found.values()]


def _trembles(time: Array, fog: Array, gyro: Array) -> bool:
    """Whether a FOG and a triad read the same motion in a dwell, away from its ends: there the hand
    lets go. time: s, (n,); fog: (n, 1); gyro: (n, 3).
    """
    from scipy.ndimage import uniform_filter1d
    from scipy.special import chdtri

    edge = min(EDGE, float(np.ptp(time)) / 4)
    both = np.column_stack([fog, gyro])[(time > time[0] + edge) & (time < time[-1] - edge)]
    both = both[~np.isnan(both).any(axis=1)]
    if len(both) < 2 or (step := float(np.median(np.diff(time)))) <= 0:
        return False
    width = max(round(TREMOR / step), 2)
    quick = both - uniform_filter1d(both, width, axis=0)
    Q = column_space(quick[:, 1:])
    total = float(quick[:, 0] @ quick[:, 0])
    explained = float(np.sum((Q.T @ quick[:, 0]) ** 2))
    least = CORRELATED * float(chdtri(3, BY_CHANCE)) / len(both)
    return total > 0 and explained > max(MOVED, least) * total
