"""What recordings span, for the shapes and curves of hypotheses."""

from dataclasses import replace

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.core.frames import force_of_tilt
from tiltcal.diagnosis.data.observations import Channel, Observations
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.effects.curve_coordinates import INPUTS, TURN_RATE, turned_by
from tiltcal.effects.hysteresis_and_lag import first_order_lag
from tiltcal.effects.learned import Learned
from tiltcal.effects.spans import CoordinateRanges, SpectralLines
from tiltcal.setup.tables import angle_channel

MEMORIES = (3.0, 8.0, 20.0)  # s, of a force or a rate
TURNED = 0.05  # share of the largest rate above which an axis turned: the Earth's is no turn
Ranges = dict[str, tuple[float, float]]
"""Least and largest value of each coordinate, SI."""


def ranges_of(observations: Observations, lines: SpectralLines) -> CoordinateRanges:
    """What some recordings span."""
    duration = max(float(r.time[-1] - r.time[0]) for r in observations.recordings)
    g = observations.scenario.site.gravity
    ranges = {"time": (0.0, duration)}
    ranges |= _thermal(observations) | _angular(observations) | _inputs(observations)
    ranges |= _between_moves(observations) | {f"force_{a}": (-g, g) for a in "xyz"}
    if (top := fastest(observations)) > 0:
        ranges |= {f"rate_{a}": (-top, top) for a in _turned(observations)}
        ranges |= {"transverse": (0.0, top), "speed": (0.0, top)}
    ranges |= _turn_rates(observations)
    for a, most in (quickest := _quickest(observations)).items():
        ranges[f"angular_acceleration_{a}"] = (-most, most)
    if most := max(quickest.values(), default=0.0):
        ranges["braking"] = (-most, most)
    ranges |= _by_hand(observations)
    ranges |= {
        late_key(name, lag): range_felt_late(name, lag, observations) or ranges[name]
        for name in INPUTS
        if name in ranges
        for lag in MEMORIES
    }
    rate = max(_sampling_rate(r.time) for r in observations.recordings)
    chain = observations.scenario.rig.kind.chain
    gears = () if chain is None else chain.gears
    return CoordinateRanges(duration, rate, lines, ranges, gears)


def late_key(coordinate: str, lag: float) -> str:
    """Where the range of an input is that is felt late by one of MEMORIES."""
    return f"{coordinate}, {lag:g} s late"


def range_felt_late(
    coordinate: str, lag: float, observations: Observations
) -> tuple[float, float] | None:
    """How far one of INPUTS was felt that is late by a time constant, s, to both sides, SI;
    None by hand, where no table tells the motion. Moves that are short beside it are felt little.
    """
    watches = observations.watches(observations.known)
    quantity, axis = INPUTS[coordinate]
    most = max(
        (
            float(np.abs(first_order_lag(sense.time, getattr(sense, quantity)[:, axis], lag)).max())
            for watch in watches
            for sense in watch.sense.values()
        ),
        default=0.0,
    )
    return (-most, most) if watches else None


def over_felt(hypothesis: Hypothesis, observations: Observations) -> Hypothesis:
    """A curve over a late input with its knots over what was felt; others as they are."""
    effect = hypothesis.effect
    if not isinstance(effect, Learned) or not effect.lag or not effect.knots:
        return hypothesis
    felt = None
    if effect.coordinate in INPUTS:
        felt = range_felt_late(effect.coordinate, effect.lag, observations)
    if felt is None:
        return hypothesis
    knots = np.interp(effect.knots, (effect.knots[0], effect.knots[-1]), felt)
    return replace(hypothesis, effect=replace(effect, knots=tuple(float(k) for k in knots)))


def _sampling_rate(time: Array) -> float:
    """Samples a second, also where rows are lost."""
    gaps = np.diff(time)
    return float(np.rint(gaps / np.median(gaps)).sum() / (time[-1] - time[0]))


def _thermal(observations: Observations) -> Ranges:
    """Temperature about its mean, K, and its rate, K/s."""
    known = [(r, t) for r in observations.recordings if (t := r.temperature()) is not None]
    if not known:
        return {}
    temperature = np.concatenate([t - t.mean() for _, t in known])
    slopes = np.concatenate([np.gradient(t - t.mean(), r.time) for r, t in known])
    return {
        "temperature": (float(temperature.min()), float(temperature.max())),
        "warming": (float(slopes.min()), float(slopes.max())),
    }


def _angular(observations: Observations) -> Ranges:
    """Angles of the table's axes, rad."""
    found = {}
    for axis in observations.scenario.rig.axis_names:
        tables = [a for r in observations.recordings if (a := r.table(axis)) is not None]
        turned = np.concatenate([a[~np.isnan(a)] for a in tables])
        found[angle_channel(axis)] = (float(turned.min()), float(turned.max()))
    return found


def _inputs(observations: Observations) -> Ranges:
    """Inputs of each sensor, SI."""
    found: Ranges = {}
    for channel in observations.channels:
        values, key = _readings(channel, observations), f"{channel.sensor}_input"
        if observations.scenario.named(channel.sensor).kind == "inclinometer":
            values = force_of_tilt(values, observations.scenario.site.gravity)
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
        known = found.get(key, (low, high))
        found[key] = (min(low, known[0]), max(high, known[1]))
    return found


def _by_hand(observations: Observations) -> Ranges:
    """Angles that rate sensors turned by hand about their own axes, rad: no table tells them."""
    found: Ranges = {}
    scenario = observations.scenario
    for sensor in () if scenario.rig.axes else scenario.sensors("gyro", "fog"):
        read = [r.sensor(sensor) for r in observations.recordings if r.has(sensor)]
        turned = [turned_by(np.nan_to_num(each.values), each.time) for each in read]
        if turned:
            low, high = min(float(a.min()) for a in turned), max(float(a.max()) for a in turned)
            found[f"{sensor.name}_turned"] = (low, high)
    return found


def _between_moves(observations: Observations) -> Ranges:
    """Time since the last move, s, and number of moves, where there are moves and rests."""
    stops = observations.stops
    if not any((stop >= 0).any() and (stop < 0).any() for stop in stops):
        return {}
    pairs = list(zip(observations.recordings, stops, strict=True))
    longest = max(_longest_rest(r.time, s) for r, s in pairs)
    count = float(max(stop.max() for stop in stops))
    cycle = max(_longest_cycle(r.time, s) for r, s in pairs)
    return {
        "since_move": (0.0, longest),
        "since_start": (0.0, cycle),
        "moves": (0.0, count + 1),
    }


def _readings(channel: Channel, observations: Observations) -> Array:
    """Readings of a channel's sensor; by hand on all rows and axes, because the channel holds only
    a part of them.
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


def _longest_cycle(time: Array, stop: Index) -> float:
    """Longest time from the beginning of a move to that of the next, s."""
    begin = time[1:][(stop[1:] < 0) & (stop[:-1] >= 0)]
    return float(np.diff([*begin, time[-1]]).max(initial=0.0))


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


def _turned(observations: Observations) -> str:
    """The body axes about which a table turned the sensors; all of them by hand."""
    if not observations.courses:
        return "xyz"
    top = np.zeros(3)
    for watch in observations.watches(observations.known):
        for sense in watch.sense.values():
            top = np.maximum(top, np.abs(sense.rate).max(axis=0))
    return "".join(a for a, most in zip("xyz", top, strict=True) if most > TURNED * top.max())


def _turn_rates(observations: Observations) -> Ranges:
    """Rates of the table's axes that turned, rad/s."""
    senses = [s for watch in observations.watches(observations.known) for s in watch.sense.values()]
    turning = observations.scenario.rig.kind.turning
    found = {}
    for name in turning if senses else ():
        rates = [sense.turn_rates[name] for sense in senses]
        found[f"{TURN_RATE}{name}"] = (min(map(np.min, rates)), max(map(np.max, rates)))
    most = max((max(-low, high) for low, high in found.values()), default=0.0)
    return {
        k: (float(low), float(high))
        for k, (low, high) in found.items()
        if max(-low, high) > TURNED * most
    }


def _quickest(observations: Observations) -> dict[str, float]:
    """The largest angular acceleration of a table about each body axis that it turned, rad/s2."""
    found = dict.fromkeys(_turned(observations), 0.0)
    for watch in observations.watches(observations.known):
        for sense in watch.sense.values():
            most = np.abs(sense.angular_acceleration).max(axis=0)
            found = {a: max(old, float(most["xyz".index(a)])) for a, old in found.items()}
    return {a: most for a, most in found.items() if most > 0}
