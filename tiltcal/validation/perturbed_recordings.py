"""A recording as it would read if a source of uncertainty had another size."""

from dataclasses import replace

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import force_of_tilt, tilt_of_force
from tiltcal.core.units import split_unit
from tiltcal.effects.base import Effect, SignalEffect
from tiltcal.effects.sense import Sense
from tiltcal.forward.signal_chain import readings
from tiltcal.laboratory.sensor_columns import to_column
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.replay import replay
from tiltcal.recordings.segmentation import Segment
from tiltcal.setup.setup import Setup

Readings = dict[str, Array]
"""By sensor, SI, (n, k)."""


def with_gravity_error(recording: Recording, setup: Setup, size: float) -> Recording:
    """The recording in a gravity larger by the share ``size``: forces, and so sines of tilts, are
    larger in proportion.
    """
    columns = {n: recording.column(n) for n in recording.column_names}
    for sensor in setup.sensors("accelerometer", "inclinometer"):
        if not recording.has(sensor):
            continue
        samples = recording.sensor(sensor)
        moved = samples.values * (1 + size)
        if sensor.kind == "inclinometer":
            g = setup.site.gravity
            moved = tilt_of_force(force_of_tilt(samples.values, g) * (1 + size), g)
        for i, axis in enumerate(sensor.axes):
            name = str(recording.channel(f"{sensor.name}_{axis}"))
            changed = to_column(sensor, moved, str(split_unit(name)[1]), False)
            columns[name] = columns[name].copy()
            columns[name][samples.rows] = changed[:, i]
    return _like(recording, columns)


def _like(recording: Recording, columns: dict[str, Array]) -> Recording:
    return Recording.from_columns(
        recording.time,
        columns,
        labels=recording.labels,
        metadata=dict(recording.metadata),
        source=recording.source,
    )


def with_effect(
    recording: Recording, setup: Setup, effect: Effect, stop: Segment | None = None
) -> Recording:
    """The recording plus the difference that an effect makes to its readings.

    Args:
        recording: to change.
        setup: it was made with.
        effect: of the catalogue.
        stop: where the effect acts; everywhere unless given.
    """
    predict = _predicted_on_table if setup.rig.axes else _predicted_by_hand
    with_, without, known = predict(recording, setup, effect)
    columns = {n: recording.column(n) for n in recording.column_names}
    inside = np.ones(len(recording), bool)
    if stop is not None:
        inside[:] = False
        inside[stop.first : stop.last] = True
    for sensor in (setup.named(n) for n in with_):
        for i, axis in enumerate(sensor.axes):
            name = str(recording.channel(f"{sensor.name}_{axis}"))
            unit = str(split_unit(name)[1])
            after = to_column(sensor, with_[sensor.name], unit, False)[:, i]
            before = to_column(sensor, without[sensor.name], unit, False)[:, i]
            columns[name] = columns[name] + np.where(inside & known, after - before, 0.0)
    return _like(recording, columns)


def _predicted_on_table(
    recording: Recording, setup: Setup, effect: Effect
) -> tuple[Readings, Readings, Mask]:
    """Predicted readings with and without an effect, and the rows where the table was read."""
    course = replay(recording, setup)
    times = {s.name: recording.time for s in setup.sensor if recording.has(s)}
    after, before = (readings(setup, course, times, effects) for effects in ([effect], []))
    return after, before, course.known


def _predicted_by_hand(
    recording: Recording, setup: Setup, effect: Effect
) -> tuple[Readings, Readings, Mask]:
    """The same without a table: the readings of a sensor are used as its true input (their errors
    are of second order here).
    """
    if not isinstance(effect, SignalEffect):
        raise TiltcalError(
            f"budget, {effect.id}",
            found="a hand-held instrument",
            need="an effect of a sensor, or gravity, fog_axis",
            do="leave it out",
        )
    sensor = setup.named(str(effect.sensor))
    plain = Sense.at_rest(
        sensor, setup.site.gravity, _readings_at_rows(recording, setup, "accelerometer")
    )
    temperature = recording.temperature()
    warm = np.zeros(len(recording)) if temperature is None else temperature - temperature.mean()
    sense = replace(
        plain,
        time=recording.time,
        elapsed=recording.time - recording.time[0],
        rate=_readings_at_rows(recording, setup, "gyro"),
        temperature=warm,
        input_vector=sensor.input_vector if sensor.kind == "fog" else plain.input_vector,
    )
    moved = effect.apply(sense.true_input(), sense, None)
    return {sensor.name: moved}, {sensor.name: sense.true_input()}, np.ones(len(recording), bool)


def _readings_at_rows(recording: Recording, setup: Setup, kind: str) -> Array:
    """Readings of the first sensor of a kind at every row, body axes, (n, 3); zero where there is
    none.
    """
    found = np.zeros((len(recording), 3))
    for sensor in [s for s in setup.sensors(kind) if recording.has(s)][:1]:
        samples = recording.sensor(sensor)
        for i, axis in enumerate(sensor.axis_indices):
            known = ~np.isnan(samples.values[:, i])
            found[:, axis] = np.interp(
                recording.time, samples.time[known], samples.values[known, i]
            )
    return found
