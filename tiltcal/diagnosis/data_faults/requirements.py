"""What a diagnosis needs of its recordings, before anything is read out of them."""

from collections.abc import Sequence

import numpy as np

from tiltcal.core.errors import TiltcalError
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.replay import numbered_stops
from tiltcal.setup.sensor import Sensor


def require_diagnosable(
    scenario: Scenario, recordings: Sequence[Recording], static: Recording | None
) -> None:
    """Refuse what no diagnosis can use.

    Args:
        scenario: what is known of them.
        recordings: to be diagnosed; static: the record at rest, if there is one.

    Raises:
        TiltcalError: a recording has no column of any sensor, or was given twice; the table moves
            in the record at rest.
    """
    for recording in recordings:
        if not any(recording.has(sensor) for sensor in scenario.sensor):
            _require_readings(recording, scenario.sensor[0])
    prints = [recording.fingerprint for recording in recordings]
    for k, recording in enumerate(recordings):
        if prints[k] in prints[:k]:
            raise TiltcalError(
                recording.source,
                found=f"the same readings as in {recordings[prints.index(prints[k])].source}",
                need="each recording once",
                do="leave one of them out: a copy says nothing new",
            )
    if static is not None:
        _require_rest(scenario, static)


def _require_readings(recording: Recording, sensor: Sensor) -> None:
    samples = recording.sensor(sensor)  # says which column it lacks
    empty = [a for a, x in zip(sensor.axes, samples.values.T, strict=True) if np.isnan(x).all()]
    raise TiltcalError(
        f"{recording.source}, sensor {sensor.name}",
        found=f"no reading of its axis {', '.join(empty)}",
        need="readings of every axis",
        do="leave that axis out of `axes` in the scenario",
    )


def _require_rest(scenario: Scenario, static: Recording) -> None:
    angles = {axis: static.table(axis) for axis in scenario.rig.axis_names}
    read = {axis: angle for axis, angle in angles.items() if angle is not None}
    known = np.isfinite(static.time) & np.all([~np.isnan(a) for a in read.values()], axis=0)
    if not read or known.sum() < 2:
        return
    stops = numbered_stops(static.time[known], {axis: a[known] for axis, a in read.items()})
    if stops.max() != 0:
        raise TiltcalError(
            static.source,
            found=f"a table that moves and stops {stops.max() + 1} times",
            need="a record at rest (--static), in which it stands still",
            do="cut it to one standstill, or leave --static out: the noise is then taken from the"
            " recording",
        )
