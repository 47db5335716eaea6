"""What turns of a table with a readout say about the model of a rate sensor."""

from dataclasses import replace

import numpy as np

from tiltcal.calibration.correction import thermal_course
from tiltcal.calibration.evidence import (
    NOTHING,
    Evidence,
    in_standard_deviations,
    linear_columns,
)
from tiltcal.calibration.methods.gyro_rates import block_means, block_references, steady_blocks
from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.core.units import DEG, EARTH_RATE
from tiltcal.effects.sense import Sense
from tiltcal.forward.kinematics import closed_form
from tiltcal.forward.signal_chain import make_sense
from tiltcal.instrument.model import InstrumentModel
from tiltcal.instrument.temperature import ThermalStream
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.replay import replay
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.statistics.dwell_noise import pooled_noise
from tiltcal.statistics.noise_spectrum import most_slow_variance

LEAST_TURN = 0.5 * DEG  # rad/s: of a table that turns


def evidence_in_turns(
    model: InstrumentModel, sensor: Sensor, recording: Recording, setup: Setup
) -> Evidence | None:
    """Steady turns of a table with a readout against the model of a rate sensor; None where the
    recording has none.

    Args:
        model: of the sensor.
        sensor: a gyro or FOG.
        recording: of any motion.
        setup: of the recording.
    """
    names = setup.rig.axis_names
    if not names or any(recording.table(name) is None for name in names):
        return None
    read = recording.sensor(sensor)
    complete = ~np.isnan(read.values).any(axis=1)
    course, time = replay(recording, setup), read.time[complete]
    drive = course.drive(time)
    speed = np.column_stack([np.asarray(jet.v) for jet in drive.axes.values()])
    size = max(round(sensor.rate_hz), 2)
    if np.abs(speed).max() < LEAST_TURN or len(speed) < size:
        return None
    used = steady_blocks(drive, speed, size)
    if not used.any():
        return None
    sense = make_sense(sensor, setup, closed_form(setup.seen_by(sensor), drive), drive)
    sense = _under_temperature(model, sensor, sense, recording, read.rows[complete])
    left = read.values[complete] - model.predict(sensor, sense)
    residual = block_means(left, size)[used]
    columns = np.array([block_means(c, size)[used] for c in model.sensitivity(sensor, sense)])
    noise, most = _noise_of_blocks(left, residual, used, size)
    middle = np.flatnonzero(used) * size + size // 2
    at = sense.rows(middle)
    earth = np.zeros((0, *residual.shape))
    if setup.site.latitude_deg is None or setup.site.heading_deg == "unknown":
        earth = _earth_rate(sensor, sense, size)[:, used]
    found = Evidence(
        sensor,
        "rate",
        at,
        residual,
        noise,
        in_standard_deviations(model, columns.reshape(-1, *residual.shape)),
        earth,
        np.asarray(np.abs(columns).max(axis=(1, 2)) > NOTHING),
        [(float(t) - 0.5, float(t) + 0.5) for t in at.time],
        len(earth),
        "means of 1 s",
        block_references(sensor, setup, course, time, size).at(used).stated(residual.shape),
    )
    return found.with_scatter(np.array(list(linear_columns(sensor, at).values())), most)


def _under_temperature(
    model: InstrumentModel, sensor: Sensor, sense: Sense, recording: Recording, rows: Index
) -> Sense:
    """What a sensor senses with the temperature as the terms of its model follow it.

    Args:
        model: of the sensor.
        sensor: which.
        sense: at some rows, (n,).
        recording: that they are of.
        rows: their numbers, (n,).
    """
    terms = model.temperature_terms(sensor)
    if terms is None:
        return sense
    course = thermal_course(recording, ThermalStream(terms))
    warm = course.level[rows] - (model.reference_degC or 0.0)
    return replace(sense, temperature=warm, temperature_memory=course.memory[rows])


def _noise_of_blocks(left: Array, residual: Array, used: Mask, size: int) -> tuple[Array, Array]:
    """Covariance of the mean of each block by white noise, SI, (m, k, k), and with as much flicker
    as the samples allow.

    Args:
        left: residual of each sample, SI, (n, k).
        residual: of the blocks that are used, (m, k).
        used: which blocks, (b,).
        size: samples of a block.
    """
    samples = left[: len(used) * size].reshape(len(used), size, -1)[used]
    within = [block - mean for block, mean in zip(samples, residual, strict=True)]
    white, _ = pooled_noise(within)
    runs = np.cumsum(np.diff(np.flatnonzero(used), prepend=-1) > 1)
    parts = [samples[runs == k].reshape(-1, samples.shape[2]) for k in np.unique(runs)]
    counts = np.full(len(samples), float(size))
    noise = np.tile(white / size, (len(samples), 1, 1))
    most = noise.copy()
    for i in range(len(white)):
        series = [part[:, i] - part[:, i].mean() for part in parts]
        most[:, i, i] += most_slow_variance(series, counts, len(left))
    return noise, most


def _earth_rate(sensor: Sensor, sense: Sense, size: int) -> Array:
    """What the Earth's rate along up, North and East adds to means over some samples, rad/s, (3, m,
    k).
    """
    frame = (sense.up, sense.north, np.cross(sense.north, sense.up))
    axes = (
        sensor.input_vector[:, None] if sensor.kind == "fog" else np.eye(3)[:, sensor.axis_indices]
    )
    return EARTH_RATE * np.array([block_means(v @ axes, size) for v in frame])
