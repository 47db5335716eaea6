"""The law of each finding for a picture: what it does to the readings, with everything that
completes its form, and the deviation of a table axis or of a frame that causes it.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.core.units import ARCSEC, COLUMN_UNITS, DEG, G0
from tiltcal.diagnosis.conclusions.residual_plots import coordinates_of, points_of, shown_unit
from tiltcal.diagnosis.data.observations import Channel, Observations
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.effects.base import AngleEffect, Effect, FrameEffect
from tiltcal.effects.learned import LearnedReading
from tiltcal.effects.mechanisms import Context
from tiltcal.recordings.replay import nearest_rows
from tiltcal.setup.setup import Setup
from tiltcal.setup.trajectory import Drive

MOST = 400  # points of a law that has no data of its own
OWN = {
    "force": ("g", G0),
    "rate": ("deg_s", DEG),
    "turn_rate": ("deg_s", DEG),
    "transverse": ("deg_s", DEG),
    "turned": ("deg", DEG),
    "speed": ("deg_s", DEG),
    "braking": ("deg_s2", DEG),
    "since_move": ("s", 1.0),
    "since_start": ("s", 1.0),
    "moves": ("count", 1.0),
}
"""Unit of a coordinate that only a learned curve follows, and its size, SI."""


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
    stem = name if name in OWN else name.rpartition("_")[0]
    if stem not in OWN or effect.play:
        return {}
    watch = watches[channel.recording]
    sense = watch.sense[channel.sensor]
    own = sense.true_input()[:, channel.column]
    u = effect.followed(sense, own)[nearest_rows(watch.time, channel.time)]
    unit, size = OWN[stem]
    return {f"{name}_{unit}": (u % effect.period if effect.period else u) / size}


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
