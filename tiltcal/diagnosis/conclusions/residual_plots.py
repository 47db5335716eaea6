"""What a diagnosis shows of each channel: residuals of held-out blocks before and after, and their
spectrum.

The law of each finding is what it does to the readings, with everything that completes its form,
and the deviation of a table axis or of a frame that causes it.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.core.units import ARCSEC, COLUMN_UNITS, readable_unit
from tiltcal.diagnosis.data.observations import Channel, Observations
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.effects.base import AngleEffect, Effect, FrameEffect
from tiltcal.effects.curve_coordinates import coordinate_named, shown_name
from tiltcal.effects.learned import LearnedReading
from tiltcal.effects.mechanisms import Context
from tiltcal.recordings.replay import nearest_rows
from tiltcal.setup.setup import Setup
from tiltcal.setup.tables import axis_of
from tiltcal.setup.trajectory import Drive

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


MOST = 400  # points of a law that has no data of its own
SHOWN_ANYWAY = ("input", "time", "temperature")
"""Coordinates that each channel is shown over, beside the angles of a table."""


@dataclass(frozen=True)
class LawView:
    """A finding's law in one channel and mounting, or as a deviation of the table.

    Args:
        subject: ``accel.x``, or what deviates; sensor, axis: of the channel, empty for the table.
        unit: of the values; mount: the mounting in words, recording: its source.
        coordinates: name with unit -> (m,).
        law: with everything that completes it, (m,); leading: its leading form alone, (m,).
        data: what is measured where only this finding is left out, (m,), and its standard
            uncertainty; empty for the table.
        still: whether the table rests, (m,).
        follows: name of the coordinate that a learned curve follows, where it is among them.
    """

    subject: str
    sensor: str
    axis: str
    unit: str
    mount: str
    recording: str
    coordinates: Mapping[str, Array]
    law: Array
    leading: Array
    data: Array
    sigma: Array
    still: Mask
    follows: str = ""


def laws_of(
    fitted: FittedModel, observations: Observations, left: Sequence[Array]
) -> list[tuple[LawView, ...]]:
    """The law of each finding of a model.

    Args:
        fitted: the model.
        observations: whose channels.
        left: residuals of the model by channel, SI, (n,).
    """
    whole = observations.predict(fitted.effects)
    return [
        (
            *_deviations(observations, [fitted.terms[k].effect for k in places]),
            *_in_channels(fitted, observations, places, whole, left),
        )
        for places in fitted.findings()
    ]


def _in_channels(
    fitted: FittedModel,
    observations: Observations,
    places: Sequence[int],
    whole: Sequence[Array],
    left: Sequence[Array],
) -> Iterator[LawView]:
    """What a finding does to each channel that it changes."""
    first = fitted.terms[places[0]].effect
    rest: list[Effect] = [*fitted.known, *(t.effect for t in fitted.nuisance)]
    rest += [t.effect for k, t in enumerate(fitted.terms) if k not in places]
    without = observations.predict(rest)
    leading = observations.predict([*rest, first]) if len(places) > 1 else whole
    for i, channel in enumerate(observations.channels):
        law = np.nan_to_num(whole[i] - without[i])
        if not np.any(law):
            continue
        unit = shown_unit(channel, observations)
        factor = COLUMN_UNITS[unit].factor
        own = _followed(observations, channel, first, fitted.effects)
        for points in points_of(observations, channel):
            noise = float(np.std(left[i][points.samples])) / np.sqrt(points.counts)
            yield LawView(
                channel.name,
                channel.sensor,
                channel.axis,
                unit,
                points.mount,
                observations.recordings[channel.recording].source,
                coordinates_of(observations, points)
                | {name: points.mean(u) for name, u in own.items()},
                points.mean(law) / factor,
                points.mean(np.nan_to_num(leading[i] - without[i])) / factor,
                points.mean(law + left[i]) / factor,
                noise / factor,
                points.mean(channel.stop.astype(float)) >= 0,
                "".join(own),
            )


def _followed(
    observations: Observations, channel: Channel, effect: Effect, around: Sequence[Effect]
) -> dict[str, Array]:
    """The coordinate of a learned curve at a channel's samples, by name with unit, (n,); none where
    it is a table angle, time or temperature, or nothing tells it.
    """
    watches = observations.watches(around) if isinstance(effect, LearnedReading) else ()
    if not isinstance(effect, LearnedReading) or not watches or channel.sensor != effect.sensor:
        return {}
    name = effect.coordinate
    if name in SHOWN_ANYWAY or axis_of(name) or effect.play:
        return {}
    watch = watches[channel.recording]
    sense = watch.sense[channel.sensor]
    own = sense.true_input()[:, channel.column]
    u = effect.followed(sense, own)[nearest_rows(watch.time, channel.time)]
    phase = u % effect.period if effect.period else u
    return {shown_name(name): phase / coordinate_named(name).size}


def _deviations(observations: Observations, effects: Sequence[Effect]) -> Iterator[LawView]:
    """Deviation of each table axis and turn of each frame that some effects cause, the leading one
    first, along the first recording.
    """
    if not observations.courses:
        return
    course = observations.courses[0]
    drive = course.drive(course.time)
    found: dict[str, list[Array]] = {}
    for k, effect in enumerate(effects):
        for name, angle in angles_of(effect, drive, observations.scenario).items():
            sums = found.setdefault(name, [np.zeros(len(drive.time)), np.zeros(len(drive.time))])
            sums[0] = sums[0] + angle
            sums[1] = sums[1] + (angle if k == 0 else 0.0)
    rows = np.unique(np.linspace(0, len(drive.time) - 1, MOST).astype(int))
    coordinates = observations.scenario.rig.kind.columns(course.angles)
    coordinates |= {"time_s": drive.elapsed, "temperature_degC": drive.temperature}
    shown = {name: u[rows] for name, u in coordinates.items() if np.ptp(u) > 0}
    source = observations.recordings[0].source
    for name, (law, leading) in found.items():
        if np.ptp(law) > 0:
            sizes, none = (law[rows] / ARCSEC, leading[rows] / ARCSEC), np.zeros(0)
            still = drive.stop[rows] >= 0
            yield LawView(name, "", "", "arcsec", "", source, shown, *sizes, none, none, still)


def angles_of(effect: Effect, drive: Drive, setup: Setup) -> dict[str, Array]:
    """Deviations of table axes and turns of frames by an effect, in words, rad, (n,) or (1,). What
    bends under load shows in the channels only: its turn needs the load.
    """
    rig = setup.rig
    if isinstance(effect, AngleEffect):
        return {
            f"true angle minus readout of the {axis} axis": np.atleast_1d(
                effect.deviation(drive, axis, None).x
            )
            for axis in rig.axis_names
            if effect.acts_on(axis, rig)
        }
    found: dict[str, Array] = {}
    if isinstance(effect, FrameEffect) and not effect.mechanised:
        context = Context.along(drive, drive.axes, rig, setup.site.gravity)
        for slot in rig.kind.slots:
            for turn in effect.turns(slot, context):
                name = f"turn of the frame {slot} about {turn.axis}"
                found[name] = found.get(name, np.zeros(1)) + turn.angle.x
    return found
