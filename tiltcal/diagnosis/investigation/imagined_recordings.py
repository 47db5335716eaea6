"""What a block would record: the recording that a design is judged by."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tiltcal.core.units import ARCSEC, COLUMN_UNITS, DEG, split_unit
from tiltcal.design.recording_blocks import Block
from tiltcal.diagnosis.investigation.rival_hypotheses import Question
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import Scenario, fresh
from tiltcal.recordings.recording import Recording
from tiltcal.setup.schedule import build_schedule
from tiltcal.setup.sequence import Step
from tiltcal.setup.tables import angle_key, axis_of

READOUT = 0.05 * ARCSEC / DEG  # deg, noise of an imagined readout


COMING = 5.0  # deg before the first pose of an imagined block


MOVED = 0.1  # of the largest step between samples: what is no noise of the readout


def imagined(block: Block, scenario: Scenario, question: Question) -> Recording:
    """What a block would read if nothing were wrong, in a room that goes back the way it came, with
    the white noise of the recordings so far: by it a row is seen to weigh as much as another.
    """
    last = question.observations.recordings[-1]
    recording = come_to(block, scenario, last_sides(last, scenario))
    rng = np.random.default_rng(0)
    columns = {n: recording.column(n) for n in recording.column_names}
    for (sensor, axis), noise in question.noise.items():
        if (name := recording.channel(f"{sensor}_{axis}")) is not None:
            unit = COLUMN_UNITS[split_unit(name)[1] or ""].factor
            white = noise.white * np.sqrt(question.block) / unit
            columns[name] = columns[name] + white * rng.standard_normal(len(recording))
    temperature = last.temperature()
    if temperature is not None:
        age = np.minimum(recording.time - recording.time[0], last.time[-1] - last.time[0])
        columns["temperature_degC"] = np.interp(last.time[-1] - age, last.time, temperature)
    return Recording.from_columns(
        recording.time, columns, metadata=recording.metadata, source="imagined block"
    )


def last_sides(recording: Recording, scenario: Scenario) -> dict[str, float]:
    """Which way each axis of the table moved last, +1 or -1."""
    found = {}
    for axis in scenario.rig.kind.turning:
        readout = recording.table(axis)
        steps = np.diff(readout[~np.isnan(readout)]) if readout is not None else np.zeros(0)
        moved = steps[np.abs(steps) > MOVED * np.abs(steps).max(initial=0.0)]
        found[axis] = float(np.sign(moved[-1])) if len(moved) else 1.0
    return found


def come_to(block: Block, scenario: Scenario, sides: Mapping[str, float]) -> Recording:
    """What a block would read without effects, its first pose come to as the table moved last.

    From which side a table will come to it nobody has said: a block must not promise what it would
        tell if that were new.
    After remounting the table has moved anyhow.
    """
    if block.remounts or not sides:
        return blank(block, scenario)
    first = {angle_key(axis): 0.0 for axis in sides}
    for step in reversed(block.steps):
        stated = {angle_key(name): angle for name, angle in step.angles_deg.items()}
        first |= {key: angle for key, angle in stated.items() if key in first}
    away = Step(
        action="move",
        **{angle_key(axis): first[angle_key(axis)] - side * COMING for axis, side in sides.items()},
    )
    steps = (away, Step(action="move", **first, dwell_s=1.0), *block.steps)
    recording = blank(replace(block, steps=steps), scenario)
    # how it got away is no part of the block
    known = recording.time >= build_schedule((away,), scenario.rig).times[1]
    columns = {n: recording.column(n)[known] for n in recording.column_names}
    return Recording.from_columns(
        recording.time[known], columns, metadata=recording.metadata, source=recording.source
    )


def blank(block: Block, scenario: Scenario) -> Recording:
    """A recording of a block without effects or noise, but for that of the readout: what rests is
    told by it.
    """
    recording = SimulatedLaboratory().record(
        fresh(scenario, sequence=block.steps, effect=(), grade=None, dynamics=None)
    )
    rng = np.random.default_rng(0)
    columns = {n: recording.column(n) for n in recording.column_names}
    for name in columns:
        if axis_of(name) is not None:
            columns[name] = columns[name] + READOUT * rng.standard_normal(len(recording))
    return Recording.from_columns(
        recording.time, columns, metadata=recording.metadata, source=f"block {block.name}"
    )
