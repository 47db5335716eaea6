"""Outliers: single values far from their neighbours, in the residual on a table, in the columns by
hand.
"""

from collections.abc import Collection

import numpy as np

from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.core.quantisation import lsb_width
from tiltcal.diagnosis.data.channels import changed
from tiltcal.diagnosis.data.handheld_recording import known_stops
from tiltcal.diagnosis.data.observations import Observations
from tiltcal.diagnosis.data_faults.fault import Fault
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.effects.data.faults import DataOutlier
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.replay import Replay
from tiltcal.statistics.dwell_noise import MAD_TO_SIGMA, second_difference_noise

GROSS = 8.0  # sigma: nearer in, a heavy tail is no fault
ENDS = 3  # samples to either side of where a stop begins or ends
TAIL = 0.1  # share of the number between 4 and GROSS sigma that a heavy tail has beyond
HAND_HELD_TAIL = 1.0  # the same in a hand, where no model tells a touch from noise
STRETCH = 51  # rows whose median tells the local deviation
BRIEF = 15  # of them, within a move
MIN_ROWS = 32  # rows that tell one at all
TINY = 1e-15  # of a reading, in its unit: a column without noise
ISOLATED = 0.3  # share of its distance that its neighbours may be off as well


def find_outliers(
    observations: Observations, fitted: FittedModel, coarse: Collection[str] = ()
) -> tuple[list[Fault], tuple[Recording, ...]]:
    """Values far off their neighbours, more of them than the tail of the others lets expect; and
    the recordings without them.

    On a table a few by themselves are left out too, and no fault: no physics is that quick, but a
    hand may be. Sensors whose codes, or whose model's angles, are ``coarse`` are left alone: a step
    of theirs stands off its neighbours.
    """
    scenario = observations.scenario
    heavy = TAIL if scenario.rig.axes or scenario.sensors("fog") else HAND_HELD_TAIL
    repaired = list(observations.sources)
    together = zip(observations.sources, observations.recordings, observations.stops, strict=True)
    stops = [stop if used is source else known_stops(source) for source, used, stop in together]
    speeds = [_speed(course) for course in observations.courses]
    speeds = speeds or [(stop < 0).astype(float) for stop in stops]  # of a hand: whether it turns
    seen: dict[str, list[tuple[str, float, float, int]]] = {}
    for number, sensor, axis, rows, values in observations.outlier_signals(fitted.effects, stops):
        if sensor in coarse:
            continue
        anywhere = off_neighbours(values, speeds[number][rows])
        off = np.where(_at_an_end(stops[number], rows), 0.0, anywhere)
        far, tail = off > GROSS, (off > 4) & (off <= GROSS)
        if far.sum() > 3 + heavy * tail.sum() and np.median(off[far]) > GROSS + 2:
            seen.setdefault(sensor, []).append(
                (axis, float(far.mean()), float(np.median(off[far])), int(far.sum()))
            )
            far = anywhere > GROSS
        elif not scenario.rig.axes:
            continue
        if far.any():
            repaired[number] = changed(
                repaired[number], scenario.named(sensor), axis, rows[far], np.nan
            )
    known = {(e.id, e.sensor) for e in scenario.effects}
    return [
        _fault(name, found) for name, found in seen.items() if (DataOutlier.id, name) not in known
    ], tuple(repaired)


def _at_an_end(stop: Index, rows: Index) -> Mask:
    """Rows where a move begins or ends, (n,): a jerk there is real."""
    changes = np.flatnonzero(np.diff(stop) != 0)
    near = np.zeros(len(stop) + 2 * ENDS, bool)
    for shift in range(2 * ENDS):
        near[changes + shift + 1] = True
    return near[ENDS:-ENDS][rows]


def _fault(sensor: str, found: list[tuple[str, float, float, int]]) -> Fault:
    """The fault of one sensor."""
    axes = tuple(dict.fromkeys(axis for axis, *_ in sorted(found, key=lambda item: -item[3])))
    share, size = max(f[1] for f in found), max(found, key=lambda f: f[3])[2]
    count = sum(f[3] for f in found)
    effect = DataOutlier({"share": share, "size": size}, sensor, None, "found")
    words = (
        f"{count} values of {sensor} {', '.join(axes)} lie about {size:.0f} sigma from their"
        " neighbours."
    )
    sigma = {"share": share / np.sqrt(count), "size": size / np.sqrt(count)}
    return Fault(effect, (sensor,), axes, words, sigma=sigma)


def _speed(course: Replay) -> Array:
    """How fast a table turns about all its axes, rad/s, (n,)."""
    axes = course.drive(course.time).axes.values()
    return np.sqrt(sum((jet.v**2 for jet in axes), np.zeros(len(course.time))))


def off_neighbours(values: Array, speed: Array | None = None) -> Array:
    """Distance of each value from the median of its neighbourhood, in local standard deviations; 0
    unless it is a single value, (n,).

    Local is a stretch of rows, and where the table turns no less than the rows of like ``speed``,
    rad/s, (n,), nor than the nearest that turn: noise may grow with the rate, and from move to
    move, within a move that is shorter than a stretch.
    """
    from scipy.ndimage import median_filter

    if len(values) < 2 * MIN_ROWS:
        return np.zeros(len(values))
    off = np.abs(values - median_filter(values, 5, mode="nearest"))
    bent = np.zeros(len(values))  # off the cubic through two neighbours on each side
    bent[2:-2] = values[2:-2] - (4 * (values[1:-3] + values[3:-1]) - (values[:-4] + values[4:])) / 6
    # the crest of a quick turn is where its flanks say
    off[2:-2] = np.minimum(off, np.abs(bent))[2:-2]
    local = MAD_TO_SIGMA * median_filter(off, STRETCH, mode="nearest")
    if speed is not None and (speed > 0).sum() > MIN_ROWS:
        turning = np.flatnonzero(speed > 0)
        alike = turning[np.argsort(speed[turning], kind="stable")]
        for rows, width in ((alike, STRETCH), (turning, BRIEF)):
            usual = MAD_TO_SIGMA * median_filter(off[rows], width, mode="nearest")
            local[rows] = np.maximum(local[rows], usual)
    beside = np.maximum(np.concatenate([[0.0], off[:-1]]), np.concatenate([off[1:], [0.0]]))
    alone = beside < ISOLATED * off  # the corner of a move drags its neighbours along
    # how far the neighbours are off theirs once a value is put where they say
    mended = np.zeros(len(values))
    mended[1:-1] = np.maximum(
        np.abs(bent[:-2] + bent[1:-1] / 1.5), np.abs(bent[2:] + bent[1:-1] / 1.5)
    )
    # a knock is quick, and still some samples wide
    alone &= mended < np.maximum(ISOLATED * off, 4 * local)
    least = max(
        second_difference_noise(values), lsb_width(values), TINY
    )  # of coarse codes most differences are none
    return np.asarray(np.where(alone, off / np.maximum(local, least), 0.0))
