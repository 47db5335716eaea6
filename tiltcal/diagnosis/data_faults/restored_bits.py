"""Bits that are never set put back.

Only a prediction shows which readings lack the bit: it is put back where that brings a reading
nearer to the model. By hand a FOG predicts a gyro along its axis; where nothing does, the smoothest
course that the codes allow is taken.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.core.quantisation import lsb_width
from tiltcal.data_quality.bits import LEAST, is_set
from tiltcal.diagnosis.data.channels import changed, column_values, written
from tiltcal.diagnosis.data.observations import Observations
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.recording import Recording
from tiltcal.setup.sensor import Sensor
from tiltcal.statistics.dwell_noise import robust_white

MIN_BIT_OVER_NOISE = 4.0  # times the noise of a FOG, at least, of what a bit of a gyro is along it


def with_bits(
    recordings: Sequence[Recording],
    observations: Observations,
    fitted: FittedModel,
    bits: Mapping[tuple[str, str], float],
) -> tuple[Recording, ...]:
    """The recordings with each missing bit put back where the fitted model, fitted to
    ``observations`` of them, says that it was set.

    The first time it is still missing there, and the fitted model goes between the readings with it
    and those without.

    Args:
        recordings: that lack the bits.
        observations: of them.
        fitted: to the observations.
        bits: SI, by sensor and axis.
    """
    restored = [
        _smoothest(recording, observations.scenario, bits, observations, k)
        for k, recording in enumerate(recordings)
    ]
    for number, sensor, axis, rows, r in _predicted(observations, fitted, bits):
        bit = bits[sensor.name, axis]
        before, now = (
            written(recordings[number], sensor, axis)[rows],
            written(observations.sources[number], sensor, axis)[rows],
        )
        there, _, values = column_values(observations.sources[number], sensor, axis)
        values = values[np.searchsorted(there, rows)]
        unit = float(np.ptp(values) / np.ptp(now))  # SI
        side = np.ones(len(r))
        if _with_sign(before, bit / unit):  # what lacks its bit may read nothing, of either sign
            side = np.sign(np.where(before == 0, values - r, before))
        # 0 where the bit was not set, 1 where it was
        lacks = side * (unit * (now - before) - r) / bit
        between = 0.5 if np.any(now != before) else float(np.quantile(lacks, [0.05, 0.95]).mean())
        whole = before + np.where(lacks > between, side * bit / unit, 0.0)
        restored[number] = changed(restored[number], sensor, axis, rows, whole)
    return tuple(restored)


def _predicted(
    observations: Observations, fitted: FittedModel, bits: Mapping[tuple[str, str], float]
) -> Iterator[tuple[int, Sensor, str, Index, Array]]:
    """Recording, sensor, axis, rows and residual, SI, of the channels with these bits that
    something predicts.

    A FOG beside a gyro by hand tells what the gyro should have read along its axis.
    """
    scenario = observations.scenario
    for channel, r in zip(
        observations.channels, observations.residuals(fitted.effects), strict=True
    ):
        if (channel.sensor, channel.axis) in bits:
            yield channel.recording, scenario.named(channel.sensor), channel.axis, channel.rows, r
        elif scenario.named(channel.sensor).kind == "fog" and not scenario.rig.axes:
            for (name, axis), bit in bits.items():
                along = float(scenario.named(channel.sensor).input_vector["xyz".index(axis)])
                read, _, _ = column_values(
                    observations.sources[channel.recording], scenario.named(name), axis
                )
                # of what is left the missing bit makes noise
                quiet = channel.values[channel.stop >= 0]
                told = (
                    scenario.named(name).kind == "gyro"
                    and len(quiet) > 2
                    and abs(along) * bit > MIN_BIT_OVER_NOISE * robust_white(quiet)
                )
                if told and np.isin(channel.rows, read).all():
                    yield channel.recording, scenario.named(name), axis, channel.rows, -r / along


def _smoothest(
    recording: Recording,
    scenario: Scenario,
    bits: Mapping[tuple[str, str], float],
    observations: Observations,
    number: int,
) -> Recording:
    """A recording with the bits of those channels put back that no observation predicts."""
    predicted = {(c.sensor, c.axis) for c in observations.channels if c.recording == number}
    for (name, axis), bit in bits.items():
        sensor = scenario.named(name)
        rows, _, values = column_values(recording, sensor, axis)
        if (name, axis) in predicted or len(rows) < LEAST:
            continue
        codes = written(recording, sensor, axis)[rows]
        bit_in_file = bit * float(np.ptp(codes) / np.ptp(values))
        side = _sign_of_course(codes) if _with_sign(codes, bit_in_file) else np.ones(len(codes))
        recording = changed(
            recording,
            sensor,
            axis,
            rows,
            codes + side * bit_in_file * was_set(codes, side * bit_in_file),
        )
    return recording


def _sign_of_course(codes: Array) -> Array:
    """The sign of each code, that of the one before where it reads nothing, (n,)."""
    last = np.maximum.accumulate(np.where(codes != 0, np.arange(len(codes)), 0))
    return np.sign(codes[last])


def was_set(codes: Array, bit: Array) -> Mask:
    """Where a bit was set if the course was the smoothest, the sum of its squared second
    differences the least, (n,).

    Args:
        codes: without the bit, (n,), n > 2.
        bit: what it adds to each, (n,).
    """
    either = np.stack([codes, codes + bit])  # (2, n)
    cost = np.zeros((2, 2))  # of the last two samples' states
    came = np.zeros((len(codes), 2, 2), np.intp)
    for k in range(2, len(codes)):
        second = (
            either[:, k][None, None, :]
            - 2 * either[:, k - 1][None, :, None]
            + either[:, k - 2][:, None, None]
        )
        total = cost[:, :, None] + second**2
        came[k] = total.argmin(axis=0)
        cost = total.min(axis=0)
    state = np.zeros(len(codes), np.intp)
    state[-2:] = np.unravel_index(int(cost.argmin()), cost.shape)
    for k in range(len(codes) - 1, 1, -1):
        state[k - 2] = came[k, state[k - 1], state[k]]
    return np.asarray(state == 1)


def _with_sign(codes: Array, bit: float) -> bool:
    """Whether these codes are magnitudes with a sign: their bit is never set, that of a two's
    complement is.
    """
    width = lsb_width(codes)
    return bool(
        is_set(np.abs(codes), 1 / (2 * bit), width).mean()
        < is_set(codes, 1 / (2 * bit), width).mean()
    )
