"""What a diagnosis shows of each channel: residuals of held-out blocks before and after, and their
spectrum.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.core.units import COLUMN_UNITS, readable_unit
from tiltcal.diagnosis.data.observations import Channel, Observations

PIECES = 150  # of a recording's time: a longer rest or move is shown in several points
UNITS = {
    "accelerometer": "m_s2",
    "inclinometer": "rad",
    "gyro": "rad_s",
    "fog": "rad_s",
    "encoder": "rad",
}


@dataclass(frozen=True)
class View:
    """One channel in one mounting of one recording; a point is the mean over a rest or a move, or
    over a piece of a long one.

    Args:
        channel: ``accel.x``; unit: of the residuals, as the user reads it.
        recording: its source; mount: the mounting in words.
        coordinates: name with unit -> mean coordinate of each point, (m,).
        before, after: mean residual of each point where its block was not fitted to, (m,).
        sigma: standard uncertainty of those means, (m,).
    """

    channel: str
    unit: str
    recording: str
    mount: str
    coordinates: Mapping[str, Array]
    before: Array
    after: Array
    sigma: Array


@dataclass(frozen=True)
class Spectrum:
    """Residual of one channel by frequency.

    Args:
        channel: ``accel.x``.
        frequency: Hz, (f,).
        before, after: rms of the residual in each band, SI, (f,).
    """

    channel: str
    frequency: Array = field(default_factory=lambda: np.zeros(0))
    before: Array = field(default_factory=lambda: np.zeros(0))
    after: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True)
class Points:
    """The points of one channel in one mounting.

    Args:
        channel: whose; mount: in words.
        samples: of the channel, (n,); which: number of the point of each of them, (n,).
    """

    channel: Channel
    mount: str
    samples: Index
    which: Index

    def mean(self, values: Array) -> Array:
        """Means of the values of a channel's samples, (n,) -> (m,)."""
        return np.asarray(np.bincount(self.which, values[self.samples]) / self.counts)

    @property
    def counts(self) -> Index:
        """Number of samples of each point, (m,)."""
        return np.bincount(self.which)


def points_of(observations: Observations, channel: Channel) -> list[Points]:
    """The points of a channel, one element for each mounting in which it has samples."""
    time, stop = channel.time, channel.stop
    recording = observations.recordings[channel.recording]
    words = _mounts(str(recording.metadata.get("mount", observations.scenario.rig.mount)))
    starts = [start for start, _ in words[1:]]
    mounting = np.searchsorted(starts, time, side="right")
    begins = np.concatenate([[True], (np.diff(stop) != 0) | (np.diff(mounting) != 0)])
    run = np.cumsum(begins) - 1
    since = time - time[np.flatnonzero(begins)][run]
    piece = np.floor(since / max(float(np.ptp(time)) / PIECES, np.finfo(float).tiny))
    fresh = begins | np.concatenate([[True], np.diff(piece) != 0])
    number = np.cumsum(fresh) - 1
    found = []
    for k, (_, mount) in enumerate(words):
        samples = np.flatnonzero(mounting == k)
        if len(samples):
            which = number[samples] - number[samples[0]]
            found.append(Points(channel, mount, samples, which))
    return found


def _mounts(text: str) -> list[tuple[float, str]]:
    """Mountings of a recording in words, each with the time from which it holds, s."""
    found = []
    for part in text.split(";"):
        when, colon, mount = part.rpartition(":")
        start = float(when.strip().removesuffix("s")) if colon else -np.inf
        found.append((start, mount.strip()))
    return found


def views_of(
    observations: Observations, before: Sequence[Array], after: Sequence[Array]
) -> tuple[View, ...]:
    """Views of each channel. before, after: residuals by channel, SI, (n,)."""
    found = []
    for channel, b, a in zip(observations.channels, before, after, strict=True):
        unit = shown_unit(channel, observations)
        factor = COLUMN_UNITS[unit].factor
        for points in points_of(observations, channel):
            left = float(np.std(a[points.samples])) / np.sqrt(points.counts)
            found.append(
                View(
                    channel.name,
                    unit,
                    observations.recordings[channel.recording].source,
                    points.mount,
                    coordinates_of(observations, points),
                    points.mean(b) / factor,
                    points.mean(a) / factor,
                    left / factor,
                )
            )
    return tuple(found)


def unit_of(channel: Channel, observations: Observations) -> str:
    """Unit of a channel's residual, SI; an angle where that is a direction's."""
    return (
        "rad" if channel.axis == "turn" else UNITS[observations.scenario.named(channel.sensor).kind]
    )


def shown_unit(channel: Channel, observations: Observations) -> str:
    """Unit in which a channel's residual is shown: that of its column, where that is fine enough;
    else ug, arcsec or deg/h.
    """
    sensor = observations.scenario.named(channel.sensor)
    recording = observations.recordings[channel.recording]
    own = not channel.derived and channel.axis in sensor.axes
    column = recording.sensor(sensor).units[sensor.axes.index(channel.axis)] if own else None
    return readable_unit(unit_of(channel, observations), column)[1]


def coordinates_of(observations: Observations, points: Points) -> dict[str, Array]:
    """Mean coordinates of points, by name with unit, (m,); those that vary."""
    channel = points.channel
    recording = observations.recordings[channel.recording]
    found = {"time_s": channel.time - recording.time[0]}
    if observations.courses:
        course = observations.courses[channel.recording]
        rows = {name: angle[channel.rows] for name, angle in course.angles.items()}
        found |= observations.scenario.rig.kind.columns(rows)
    temperature = recording.temperature()
    if temperature is not None:
        found["temperature_degC"] = temperature[channel.rows]
    unit = {"m_s2": "g", "rad_s": "deg_s", "rad": "deg"}[unit_of(channel, observations)]
    found[f"input_{unit}"] = channel.values / COLUMN_UNITS[unit].factor
    means = {name: points.mean(u) for name, u in found.items()}
    return {name: u for name, u in means.items() if np.ptp(u) > 0}


def spectra_of(
    observations: Observations, before: Sequence[Array], after: Sequence[Array]
) -> tuple[Spectrum, ...]:
    """The spectrum of each channel. before, after: residuals by channel, SI, (n,)."""
    found = []
    for channel, b, a in zip(observations.channels, before, after, strict=True):
        frequency, first = _spectrum(channel.time, b)
        found.append(Spectrum(channel.name, frequency, first, _spectrum(channel.time, a)[1]))
    return tuple(found)


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
