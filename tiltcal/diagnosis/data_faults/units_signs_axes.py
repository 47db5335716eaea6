"""Columns that are labelled wrongly: units, signs, exchanged axes, a table counted in the opposite
sense.

Each interpretation of the columns (48 signed permutations of a triad, each axis of the table in
both senses) is compared with the model; one that fits far better than the scenario's is what the
file holds. To gravity an axis that counts in the opposite sense is often a sign of a column: only
motion separates them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.design.identifiability import SEPARABLE
from tiltcal.diagnosis.data.channels import meant_matrix
from tiltcal.diagnosis.data_faults.fault import Fault
from tiltcal.diagnosis.data_faults.labelling import (
    FAR,
    LEAST,
    affine_fit,
    faults_of_sensor,
    misfit_of,
)
from tiltcal.diagnosis.data_faults.labelling_by_hand import labelling_faults_by_hand
from tiltcal.effects.base import Effect
from tiltcal.effects.data.labelling_faults import (
    ColumnFault,
    DataRotationSense,
    DataUnit,
)
from tiltcal.effects.events import active_in
from tiltcal.forward.signal_chain import readings
from tiltcal.laboratory.laboratory import restored
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.replay import Replay, replay
from tiltcal.setup.sensor import Sensor

ROWS = 4000  # compared
EXACT = 1e-9  # of the largest reading: a recording without noise is no nearer than this


@dataclass(frozen=True)
class Version:
    """One interpretation of all columns.

    Args:
        faults: what the file does in it, first the axes that count the other way.
        signs: number of axes and columns that are turned round or exchanged in it.
        misfit: what it leaves of all sensors, over the square of the largest prediction.
        left: mean square that an affine map of each sensor's predictions leaves of its columns, SI,
            all columns.
        rows: that each column was compared in.
    """

    faults: tuple[Fault, ...]
    signs: int
    misfit: float
    left: Array
    rows: Array

    def others(self, version: "Version") -> list[Fault]:
        """Faults of the other that this one does not have."""
        mine = [f.effect for f in self.faults]
        return [f for f in version.faults if f.effect not in mine]


def find_labelling_faults(scenario: Scenario, recording: Recording) -> list[Fault]:
    """Labelling faults of a recording on a table whose angles were read."""
    if any(e.mislabels for e in scenario.effects):
        return []
    if not scenario.rig.axes:
        return labelling_faults_by_hand(scenario, recording)
    try:
        course = restored(
            replay(recording, scenario, scenario.climate.reference_degC), scenario.effects
        )
    except TiltcalError:
        return []
    words, *others = _subsets(scenario.rig.kind.turning)
    as_written = _version(scenario, recording, course, words)
    if not as_written.faults and as_written.misfit < LEAST:
        return []
    return _likeliest(
        [as_written, *(_version(scenario, recording, course, axes) for axes in others)]
    )


def require_labelled_alike(
    scenario: Scenario,
    recordings: Sequence[Recording],
    repaired: Sequence[Recording],
    faults: Sequence[Fault],
) -> None:
    """Refuse recordings whose columns are labelled otherwise than those of the first.

    Args:
        scenario: what is known of all of them.
        recordings: as they were read; repaired: by the labelling faults of the first.
        faults: those.

    Raises:
        TiltcalError: naming the first such recording, and what is wrong there.
    """
    known = [f.effect for f in faults]
    for recording, sound in zip(recordings[1:], repaired[1:], strict=True):
        own = find_labelling_faults(scenario, recording)
        if [f.effect for f in own] == known:
            continue
        # one that tells nothing by itself is as the first, unless that repair is wrong there; how
        # an axis counts is no column's fault, and not repaired
        again = find_labelling_faults(scenario, sound)
        if any(isinstance(f.effect, ColumnFault) or f.effect not in known for f in again):
            said = (
                " ".join(f.words for f in own) or "Its columns are labelled as the scenario says."
            )
            raise TiltcalError(
                recording.source,
                found=f"columns that are labelled otherwise than in {recordings[0].source}: {said}",
                need="recordings that are written alike",
                do="diagnose each by itself, or correct the columns of one",
            )


def _subsets(axes: Sequence[str]) -> list[tuple[str, ...]]:
    """Axes that may count in the opposite sense: none first."""
    return [
        tuple(a for part in parts for a in part)
        for parts in product(*[((), (axis,)) for axis in axes])
    ]


def _likeliest(versions: Sequence[Version]) -> list[Fault]:
    """The faults of the simplest of the interpretations that fit best, with the ids of others as
    simple that fit as well.
    """
    near = [v for v in versions if v.misfit <= FAR * min(v.misfit for v in versions)]
    words = versions[0]
    if not words.faults and words in near:
        return []
    least = np.min([v.left for v in near], axis=0)
    worse = [float(np.sum(v.rows * (v.left / least - 1))) for v in near]
    tied = [v for v, w in zip(near, worse, strict=True) if w < min(worse) + SEPARABLE]
    told = min(tied, key=lambda v: v.signs)
    faults = list(told.faults)
    for other in tied:
        theirs, mine = told.others(other), other.others(told)
        if len(theirs) == len(mine) == 1:  # one for one
            k = faults.index(next(f for f in faults if f.effect == mine[0].effect))
            names = (
                *(faults[k].names or (faults[k].effect.id,)),
                *(theirs[0].names or (theirs[0].effect.id,)),
            )
            faults[k] = replace(faults[k], names=tuple(dict.fromkeys(names)))
    return faults


def _version(
    scenario: Scenario, recording: Recording, course: Replay, reversed_: Sequence[str]
) -> Version:
    """The columns interpreted with these axes in the opposite sense."""
    faults: list[Fault] = []
    for axis in reversed_:
        effect = DataRotationSense({"reversed": 1.0}, None, axis, "found")
        words = f"The {axis} axis of the table is counted in the opposite sense."
        faults.append(
            Fault(effect, (scenario.sensor[0].name,), tuple(scenario.sensor[0].axes), words)
        )
    effects = [*scenario.effects, *(f.effect for f in faults)]
    misfit, left, rows = 0.0, [], []
    for sensor in scenario.sensor:
        if recording.has(sensor):
            y, f = _pair(scenario, recording, course, sensor, effects)
            own = faults_of_sensor(y, f, sensor)
            faults += own
            size = max(float(np.abs(f).max(initial=0.0)), 1e-12)
            misfit += (
                misfit_of(_relabelled(y, own, sensor) / size, f / size, np.eye(f.shape[1]))
                if len(y)
                else 0.0
            )
            left += [max(float(v), (EXACT * size) ** 2) for v in affine_fit(y, f)]
            rows += [len(y)] * y.shape[1]
    signs = sum(
        1 if isinstance(f.effect, DataRotationSense) else len(f.axes)
        for f in faults
        if not isinstance(f.effect, DataUnit)
    )
    return Version(tuple(faults), signs, misfit, np.array(left), np.array(rows))


def _relabelled(y: Array, faults: Sequence[Fault], sensor: Sensor) -> Array:
    """Columns with these labelling faults undone."""
    for fault in reversed(faults):
        y = y @ np.linalg.inv(meant_matrix(fault.effect, sensor)).T
    return y


def _pair(
    scenario: Scenario,
    recording: Recording,
    course: Replay,
    sensor: Sensor,
    effects: Sequence[Effect],
) -> tuple[Array, Array]:
    samples = recording.sensor(sensor)
    turned = restored(course, [e for e in effects if e not in scenario.effects])
    there = np.flatnonzero(~np.isnan(samples.values).any(axis=1) & turned.known[samples.rows])
    some = there[:: max(1, len(there) // ROWS)]
    met = active_in(effects, recording.fingerprint)
    predicted = readings(scenario, turned, {sensor.name: recording.time[samples.rows[some]]}, met)[
        sensor.name
    ]
    told = ~np.isnan(predicted).any(axis=1)  # a stated loss of samples leaves rows without one
    return samples.values[some[told]], predicted[told]
