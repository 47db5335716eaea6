"""Faults of a readout's column: angles that were written with too few decimals, or repeated while
the table moves, because they were sent less often than they were written.
"""

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.quantisation import lsb_grid
from tiltcal.core.units import COLUMN_UNITS, split_unit
from tiltcal.diagnosis.data.observations import COARSE
from tiltcal.diagnosis.data_faults.fault import Fault
from tiltcal.effects.data.labelling_faults import DataTruncation
from tiltcal.effects.timing.readout_timing import ReadoutRate
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.recording import Recording
from tiltcal.setup.tables import angle_channel

DECIMAL = 1e-3  # relative, to which steps are told


def _decimal(step: float) -> bool:
    """Whether a step is 1, 2 or 5 in some decimal place."""
    first = step / 10 ** np.floor(np.log10(step))
    return bool(np.min(np.abs(first / np.array([1.0, 2.0, 5.0, 10.0]) - 1)) < DECIMAL)


def truncated_angles(recording: Recording, scenario: Scenario) -> list[Fault]:
    """A readout of the table that was written with too few decimals: its steps are decimal ones.
    Those of an encoder are parts of a turn.
    """
    found = []
    for axis in scenario.rig.kind.turning:
        angle = recording.table(axis)
        if angle is None:
            continue
        angle = angle[~np.isnan(angle)]
        step = lsb_grid(angle) if len(angle) >= 64 else None
        unit = str(split_unit(str(recording.channel(angle_channel(axis))))[1])
        if step is None or step < COARSE or not _decimal(step / COLUMN_UNITS[unit].factor):
            continue
        counts = angle / step
        if np.abs(counts - np.rint(counts)).max() < 0.03 and len(np.unique(np.rint(counts))) > 64:
            effect = DataTruncation({"step": step}, None, axis, "found")
            names = tuple(s.name for s in scenario.sensor)
            words = f"The {axis} angle is truncated to steps of {np.degrees(step):.4g} deg."
            found.append(
                Fault(
                    effect,
                    names[:1],
                    tuple(scenario.sensor[0].axes),
                    words,
                    sigma={"step": 1e-3 * step},
                )
            )
    return found


MIN_STEPS = 16  # steps of a move that an interval is told from
MOVING = 0.1  # of the largest steps: smaller ones are the ends of moves, or noise at rest
CODES = 4.0  # a step of so many codes is no slow turn of a coarse readout
ALIKE = 0.98  # of the intervals: they are whole numbers of rows next to their mean


def held_readout(recording: Recording, scenario: Scenario) -> list[Fault]:
    """A readout that stands still between updates while the table moves."""
    found = [
        interval
        for axis in scenario.rig.axis_names
        if (angle := recording.table(axis)) is not None
        and (interval := update_interval(recording.time, angle)) is not None
    ]
    if not found:
        return []
    interval = float(np.mean(found))
    step = float(np.median(np.diff(recording.time)))
    words = (
        f"The readout of the table is updated every {1e3 * interval:.4g} ms only; in between the"
        " file repeats it. Dwells and steady turns are compared, and no other moves."
    )
    first = scenario.sensor[0]
    effect = ReadoutRate({"interval": interval}, None, None, "found")
    return [
        Fault(effect, (first.name,), tuple(first.axes), words, sigma={"interval": step / MIN_STEPS})
    ]


def update_interval(time: Array, angle: Array) -> float | None:
    """Time between the updates of a readout (rad, (n,), NaN where it was not read), s; None where
    each row has its own.
    """
    read = np.flatnonzero(~np.isnan(angle))
    new = np.flatnonzero(np.diff(angle[read], prepend=np.nan) != 0)
    steps = np.abs(np.diff(angle[read][new]))
    if len(steps) <= MIN_STEPS:
        return None
    moving = steps > MOVING * np.partition(steps, -MIN_STEPS)[-MIN_STEPS]
    code = lsb_grid(angle[read])
    inside = np.flatnonzero(moving[1:] & moving[:-1]) + 1
    if len(inside) < MIN_STEPS or (code and np.median(steps[inside]) < CODES * code):
        return None
    rows = np.diff(new)[inside]
    mean = float(np.mean(rows))
    alike = np.abs(rows - mean) < 1
    if mean < 2 - 1 / MIN_STEPS or np.mean(alike) < ALIKE:
        return None
    return float(np.mean(np.diff(time[read][new])[inside][alike]))
