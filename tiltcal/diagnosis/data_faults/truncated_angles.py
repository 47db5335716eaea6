"""Angles of the table that were written with too few decimals."""

import numpy as np

from tiltcal.core.quantisation import lsb_grid
from tiltcal.core.units import COLUMN_UNITS, split_unit
from tiltcal.diagnosis.data.observations import COARSE
from tiltcal.diagnosis.data_faults.fault import Fault
from tiltcal.effects.data.labelling_faults import DataTruncation
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
