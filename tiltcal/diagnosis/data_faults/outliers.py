"""Outliers: single values far from their neighbours, in the residual on a table, in the columns by
hand.
"""

from collections.abc import Collection

import numpy as np

from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.data_quality.spikes import GROSS, off_neighbours
from tiltcal.diagnosis.data.channels import changed
from tiltcal.diagnosis.data.handheld_recording import known_stops
from tiltcal.diagnosis.data.observations import Observations
from tiltcal.diagnosis.data_faults.fault import Fault
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.effects.data.faults import DataOutlier
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.replay import Replay

ENDS = 3  # samples to either side of where a stop begins or ends
TAIL = 0.1  # share of the number between 4 and GROSS sigma that a heavy tail has beyond
HAND_HELD_TAIL = 1.0  # the same in a hand, where no model tells a touch from noise


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
    known = {e.sensor for e in scenario.effects if isinstance(e, DataOutlier)}
    new = [_fault(name, found) for name, found in seen.items() if name not in known]
    return new, tuple(repaired)


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
