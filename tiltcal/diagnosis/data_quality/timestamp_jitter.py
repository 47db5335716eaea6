"""Random errors of the time stamps."""

from collections.abc import Mapping

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.diagnosis.data.channels import changed
from tiltcal.diagnosis.data.observations import Observations
from tiltcal.diagnosis.data_quality.fault import Fault
from tiltcal.diagnosis.data_quality.stop_errors import SPOILS
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.effects.timing.delays import DataJitter, DataLatency
from tiltcal.recordings.recording import Recording
from tiltcal.statistics.noise_spectrum import robust_white


def find_stamp_jitter(fitted: FittedModel, observations: Observations) -> Fault | None:
    """Random errors of the time stamps: the variance of the residual grows with the square of the
    rate of the reading.
    """
    if not observations.courses:
        return None
    late = DataLatency({"latency": 1e-3}, None, None, "found")
    slopes = observations.changes(late, fitted.effects)
    noises = [
        _quiet_noise(r, c.stop)
        for r, c in zip(observations.residuals(fitted.effects), observations.channels, strict=True)
    ]
    top = bottom = smooth = 0.0
    energy: dict[tuple[str, str], float] = {}
    for i, r in enumerate(observations.residuals(fitted.effects)):
        if i not in slopes:
            continue
        channel = observations.channels[i]
        noise = noises[i]
        s2 = (slopes[i] / 1e-3 / noise) ** 2
        excess = np.minimum((r / noise) ** 2, 400.0) - 1
        top += float(excess @ s2)
        next_to = np.sqrt(s2[1:] * s2[:-1])
        # a smooth misfit is like its neighbour
        smooth += float(np.clip(r[1:] * r[:-1] / noise**2, -400.0, 400.0) @ next_to)
        bottom += float(s2 @ s2)
        energy[channel.sensor, channel.axis] = float(s2.sum())
    if bottom <= 0:
        return None
    # heavier than Gaussian tails double the variance of a square
    value, sigma = (
        top / bottom,
        np.sqrt(4.0 / bottom),
    )
    if value < 8 * sigma or smooth > 0.3 * top:
        return None
    return _jitter(float(np.sqrt(value)), float(sigma / (2 * np.sqrt(value))), energy)


def _jitter(size: float, sigma: float, energy: Mapping[tuple[str, str], float]) -> Fault:
    """Random stamps of this rms size, s, seen in channels by the energy of their slopes."""
    total = sum(energy.values())
    ordered = sorted(energy.items(), key=lambda item: -item[1])
    strong = [key for key, e in ordered if e > 0.05 * total]
    effect = DataJitter({"jitter": size}, strong[0][0], None, "found")
    words = (
        f"Time stamps scatter by {1e3 * size:.3g} ms rms: the residual grows with the rate of the"
        " reading."
    )
    sensors, axes = (tuple(dict.fromkeys(column)) for column in zip(*strong, strict=True))
    return Fault(effect, sensors, axes, words, sigma={"jitter": sigma})


def _quiet_noise(residual: Array, stop: Index) -> float:
    """Standard deviation of a residual at rest; of its second differences where it never rests."""
    still = stop >= 0
    return float(np.std(residual[still])) if still.sum() > 32 else robust_white(residual)


def at_rest_only(
    observations: Observations, fitted: FittedModel, jitter: float
) -> tuple[Recording, ...]:
    """The recordings without the samples that random stamps (s, rms) spoil."""
    late = DataLatency({"latency": 1e-3}, None, None, "found")
    recordings = list(observations.recordings)
    residuals = observations.residuals(fitted.effects)
    for i, slope in observations.changes(late, fitted.effects).items():
        channel = observations.channels[i]
        spoiled = np.abs(slope) / 1e-3 * jitter > SPOILS * _quiet_noise(residuals[i], channel.stop)
        sensor = observations.scenario.named(channel.sensor)
        recordings[channel.recording] = changed(
            recordings[channel.recording], sensor, channel.axis, channel.rows[spoiled], np.nan
        )
    return tuple(recordings)
