"""Residuals of each channel before and after, binned for plots against time, angles, temperature
and frequency.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Channel, Observations
from tiltcal.setup.tables import angle_channel

POINTS = 150  # of a picture: few enough that a mean shows what single samples hide


@dataclass(frozen=True)
class View:
    """One channel.

    Args:
        channel: ``accel.x``; unit: of the residuals.
        coordinates: name with unit -> mean coordinate of each bin, (m,).
        before, after: mean residual of each bin, by coordinate, (m,).
        sigma: standard uncertainty of those means, by coordinate, (m,).
        frequency: Hz, (f,); spectrum_before, spectrum_after: rms of the residual in each band,
            (f,).
    """

    channel: str
    unit: str
    coordinates: Mapping[str, Array] = field(default_factory=dict)
    before: Mapping[str, Array] = field(default_factory=dict)
    after: Mapping[str, Array] = field(default_factory=dict)
    sigma: Mapping[str, Array] = field(default_factory=dict)
    frequency: Array = field(default_factory=lambda: np.zeros(0))
    spectrum_before: Array = field(default_factory=lambda: np.zeros(0))
    spectrum_after: Array = field(default_factory=lambda: np.zeros(0))


UNITS = {"accelerometer": "m_s2", "inclinometer": "rad", "gyro": "rad_s", "fog": "rad_s"}


def views_of(
    observations: Observations, before: list[Array], after: list[Array]
) -> tuple[View, ...]:
    """A view of each channel. before, after: residuals by channel, SI, (n,)."""
    return tuple(
        _view(observations, channel, b, a)
        for channel, b, a in zip(observations.channels, before, after, strict=True)
    )


def unit_of(channel: Channel, observations: Observations) -> str:
    """Unit of a channel's residual; an angle where that is a direction's."""
    return (
        "rad" if channel.axis == "turn" else UNITS[observations.scenario.named(channel.sensor).kind]
    )


def _view(observations: Observations, channel: Channel, before: Array, after: Array) -> View:
    coordinates, means, left, sigmas = {}, {}, {}, {}
    for name, u in _coordinates(observations, channel).items():
        if np.ptp(u) == 0:
            continue
        edges = np.linspace(u.min(), u.max(), POINTS + 1)
        which = np.clip(np.searchsorted(edges, u, side="right") - 1, 0, POINTS - 1)
        count = np.bincount(which, minlength=POINTS)
        used = count > 0
        coordinates[name] = np.bincount(which, u, POINTS)[used] / count[used]
        means[name] = np.bincount(which, before, POINTS)[used] / count[used]
        left[name] = np.bincount(which, after, POINTS)[used] / count[used]
        sigmas[name] = float(np.std(after)) / np.sqrt(count[used])
    frequency, first = _spectrum(channel.time, before)
    _, last = _spectrum(channel.time, after)
    unit = unit_of(channel, observations)
    return View(channel.name, unit, coordinates, means, left, sigmas, frequency, first, last)


def _coordinates(observations: Observations, channel: Channel) -> dict[str, Array]:
    recording = observations.recordings[channel.recording]
    found = {"time_s": channel.time - recording.time[0]}
    if observations.courses:
        course = observations.courses[channel.recording]
        found |= {
            f"{angle_channel(name)}_deg": np.degrees(angle[channel.rows])
            for name, angle in course.angles.items()
        }
    temperature = recording.temperature()
    if temperature is not None:
        found["temperature_degC"] = temperature[channel.rows]
    return found | {"input": channel.values}


def _spectrum(time: Array, residual: Array) -> tuple[Array, Array]:
    """Rms of a residual in bands of frequency, (f,)."""
    n = len(residual)
    rate = (n - 1) / max(float(time[-1] - time[0]), 1e-9)
    power = np.abs(np.fft.rfft(residual - residual.mean())) ** 2 * 2 / n**2
    frequency = np.fft.rfftfreq(n, 1 / rate)
    edges = np.unique(np.geomspace(1, len(power), 80).astype(int))
    total = np.add.reduceat(power, edges[:-1])
    centre = (
        np.add.reduceat(frequency, edges[:-1]) / np.diff(edges, append=len(power))[: len(edges) - 1]
    )
    return centre, np.sqrt(total)
