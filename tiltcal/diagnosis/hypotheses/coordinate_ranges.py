"""What recordings span: where shapes and curves of hypotheses come from."""

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.diagnosis.data.observations import Channel, Observations
from tiltcal.effects.spans import CoordinateRanges, SpectralLines


def ranges_of(observations: Observations, lines: SpectralLines) -> CoordinateRanges:
    """What some recordings span."""
    ranges: dict[str, tuple[float, float]] = {}
    duration = max(float(r.time[-1] - r.time[0]) for r in observations.recordings)
    ranges["time"] = (0.0, duration)
    temperature = [
        t - t.mean() for r in observations.recordings if (t := r.temperature()) is not None
    ]
    if temperature:
        both = np.concatenate(temperature)
        ranges["temperature"] = (float(both.min()), float(both.max()))
        slopes = np.concatenate(
            [
                np.gradient(t, r.time)
                for t, r in zip(temperature, observations.recordings, strict=False)
            ]
        )
        ranges["warming"] = (float(slopes.min()), float(slopes.max()))
    for axis in observations.scenario.rig.axis_names:
        turned = np.concatenate(
            [a[~np.isnan(a)] for r in observations.recordings if (a := r.table(axis)) is not None]
        )
        ranges[f"table_{axis}"] = (float(turned.min()), float(turned.max()))
    for channel in observations.channels:
        values = _readings(channel, observations)
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
        known = ranges.get(f"{channel.sensor}_input", (low, high))
        ranges[f"{channel.sensor}_input"] = (min(low, known[0]), max(high, known[1]))
    g = observations.scenario.site.gravity
    stops = observations.stops
    if any((stop >= 0).any() and (stop < 0).any() for stop in stops):
        ranges["since_move"] = (
            0.0,
            max(
                _longest_rest(r.time, s)
                for r, s in zip(observations.recordings, stops, strict=True)
            ),
        )
        ranges["moves"] = (0.0, float(max(stop.max() for stop in stops)) + 1)
    ranges |= {f"force_{a}": (-g, g) for a in "xyz"}
    if (top := fastest(observations)) > 0:
        ranges |= {f"rate_{a}": (-top, top) for a in "xyz"} | {"transverse": (0.0, top)}
    rate = max(s.rate_hz for s in observations.scenario.sensor)
    return CoordinateRanges(duration, rate, lines, ranges)


def _readings(channel: Channel, observations: Observations) -> Array:
    """What the sensor of a channel read; by hand on all rows and axes: the channel holds a part of
    it only, or its length.
    """
    if observations.scenario.rig.axes:
        return channel.values
    return (
        observations.recordings[channel.recording]
        .sensor(observations.scenario.named(channel.sensor))
        .values
    )


def _longest_rest(time: Array, stop: Index) -> float:
    """Duration of the longest stop, s."""
    return max(
        (float(np.ptp(time[stop == k])) for k in range(int(stop.max(initial=-1)) + 1)), default=0.0
    )


def fastest(observations: Observations) -> float:
    """The largest rate, rad/s: as gyros read it, or as the table turned."""
    scenario = observations.scenario
    if not scenario.rig.axes:  # across a FOG's axis a hand turns as quickly as along it
        sensors = [
            (r, s)
            for r in observations.recordings
            for s in scenario.sensors("gyro", "fog")
            if r.has(s)
        ]
        read = [np.linalg.norm(np.nan_to_num(r.sensor(s).values), axis=1).max() for r, s in sensors]
        return float(max(read, default=0.0))
    rates = [c.values for c in observations.channels if scenario.named(c.sensor).quantity == "rate"]
    if rates:
        return max(float(np.abs(r).max()) for r in rates)
    found = [0.0]
    for recording in observations.recordings:
        for axis in observations.scenario.rig.axis_names:
            angle = recording.table(axis)
            if angle is not None:
                known = ~np.isnan(angle)
                time, angle = recording.time[known], angle[known]
                found.append(float(np.percentile(np.abs(np.diff(angle)) / np.diff(time), 99)))
    return max(found)
