"""Codes that are coarse beside the noise, and angles that were truncated."""

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.quantisation import lsb_grid
from tiltcal.core.units import COLUMN_UNITS, split_unit
from tiltcal.diagnosis.data.channels import (
    column_values,
    runs_of,
)
from tiltcal.diagnosis.data_quality.fault import Fault
from tiltcal.effects.data.labelling_faults import DataTruncation
from tiltcal.effects.electronics.converter import AdcQuantisation, GyrQuantisation
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.recording import Recording
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.tables import angle_channel

# code over noise: below it what rounding does is white to exp(-2 (pi / 1.5)^2), a part in 6000
COARSE = 1.5


def coarse_codes(recording: Recording, sensor: Sensor) -> tuple[Recording, list[Fault]]:
    """Codes that are not small beside the noise. Raw codes of a converter that the scenario states
    are no fault.
    """
    if sensor.input is not None:
        return recording, []
    found = []
    for axis in sensor.axes:
        _, _, values = column_values(recording, sensor, axis)
        width = lsb_grid(values) if len(values) >= 64 else None
        spread = _spread_at_rest(values)
        if width is not None and width > COARSE * spread:
            found.append(
                (
                    axis,
                    AdcQuantisation({"lsb": width}, sensor.name, None, "found"),
                    width,
                    spread,
                )
            )
    if not found:
        return recording, []
    # one code all along
    still = [a for a in sensor.axes if len(np.unique(column_values(recording, sensor, a)[2])) < 3]
    axes = tuple(dict.fromkeys([*(axis for axis, *_ in found), *still]))
    _, effect, width, spread = max(found, key=lambda item: item[2])
    words = (
        f"{sensor.name} {', '.join(axes)} is quantised in steps of {width:.4g} (SI), which is not"
        " small compared with its noise."
    )
    names: tuple[str, ...] = (AdcQuantisation.id,)
    if not sensor.is_accelerometer:
        names, words = (
            (*names, GyrQuantisation.id),
            f"{words[:-1]}: by its own output or by the converter behind it.",
        )
    return recording, [
        Fault(effect, (sensor.name,), axes, words, names=names, sigma={"lsb": 1e-3 * width})
    ]


CUT = 0.002  # deg: finer steps spoil nothing that noise does not
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
        if step is None or step < np.radians(CUT) or not _decimal(step / COLUMN_UNITS[unit].factor):
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


def _spread_at_rest(values: Array) -> float:
    """Standard deviation over sixteen samples where they are quiet, SI: the noise, if the table
    rests a fifth of the time.

    Values at the ends of the range may be clipped, the longest stretch of one value frozen: both
    are left out where anything else is left.
    """
    first, last = runs_of(np.diff(values) == 0)
    if len(first):
        k = int(np.argmax(last - first))
        rest = np.concatenate([values[: first[k]], values[last[k] + 1 :]])
        values = rest if len(rest) > len(values) // 4 else values
    inside = values[(values < values.max()) & (values > values.min())]
    values = inside if len(inside) > max(len(values) // 4, 32) else values
    blocks = values[: len(values) // 16 * 16].reshape(-1, 16)
    return float(np.quantile(blocks.std(axis=1), 0.2)) if len(blocks) else float(values.std())
