"""Curves that no name fits, and names without a form: over every coordinate, at every place of the
chain.

Curves with one number: powers of an input, products of two, coefficients that vary.

Curves that repeat in time, at the frequencies of spectral lines: thermostats, pumps, hum.

Curves of a table's axes: readout errors, bearing tilts, and what follows two angles.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations, product
from typing import Any

import numpy as np

from tiltcal.diagnosis.data.observations import Observations
from tiltcal.diagnosis.hypotheses.curve_forms import (
    curve_over,
    even_knots,
    harmonics,
    odd_curve,
    proportional,
    span_of,
)
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.hypotheses.motion_curves import (
    loads_of_mount,
    motion_of_frames,
    motion_of_readings,
)
from tiltcal.effects import CATALOGUE
from tiltcal.effects.base import Effect
from tiltcal.effects.curve_coordinates import BEGUN, LAST_DIRECTION
from tiltcal.effects.curve_products import ORDERS
from tiltcal.effects.hysteresis_and_lag import LAGS
from tiltcal.effects.learned import (
    Learned,
    LearnedDelay,
    LearnedReading,
    LearnedReadout,
    LearnedTilt,
)
from tiltcal.effects.spans import CoordinateRanges, SpectralLines, Wave
from tiltcal.laboratory.scenario import Scenario
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Rig
from tiltcal.setup.tables import PLACING, angle_channel, bearing

PACE = 2.5  # from one lag to the next beyond those, where a recording is long enough to show
SETTLING = (10.0, 30.0, 90.0, 270.0)  # s, in which a floor comes to rest
SHOWS_BEND = 0.5  # times such a time that a recording has to last
SHOWS = 7.0  # times a lag that a recording has to last


def curves(observations: Observations, span: CoordinateRanges) -> Iterator[Hypothesis]:
    """Curves over every coordinate at every place of the chain: the open world."""
    scenario = observations.scenario
    read = read_sensors(observations)
    for sensor in scenario.sensor:
        for axis in sensor.axes:
            if sensor.name in read:
                yield from _reading_curves(scenario, sensor, axis, span)
    yield from curves_of_axes(scenario.rig, span)
    yield from periodic_curves(observations, span.lines, sorted(read))
    for where in stamped(scenario, sorted(read)):
        yield curve_over(LearnedDelay, "time", even_knots("time", span, 7), **where)
    if scenario.rig.axes:
        for slot, turns in (("base", "xy"), ("mount", "xyz")):
            for turn, coordinate in product(turns, ("time", "temperature", "warming")):
                if knots := even_knots(coordinate, span, 5):
                    place = "environment" if slot == "base" else "mount"
                    tilt = curve_over(
                        LearnedTilt, coordinate, knots, slot=slot, turn=turn, place=place
                    )
                    yield replace(tilt, alias=tilt_law(slot, coordinate))
        for turn in "xy":
            yield from _settling(turn, span)
        for turn, axis in product("xyz", scenario.rig.axis_names):
            for basis in bases_over(scenario.rig, axis, span):
                yield curve_over(
                    LearnedTilt, f"table_{axis}", basis, slot="mount", turn=turn, place="mount"
                )
        yield from _late_tilts(span)
        yield from motion_of_frames(scenario.rig, span)
        yield from loads_of_mount(span)


def read_sensors(observations: Observations) -> set[str]:
    """Sensors whose errors show. By hand the gyros say where the FOG should be: what is wrong with
    them shows in it.
    """
    scenario = observations.scenario
    by_hand = () if scenario.rig.axes else scenario.sensors("gyro")
    return {c.sensor for c in observations.channels} | {s.name for s in by_hand}


def _settling(turn: str, span: CoordinateRanges) -> Iterator[Hypothesis]:
    """A tilt of the base that comes to rest, exponentially: what a late time is less than time."""
    lags = [lag for lag in SETTLING if SHOWS_BEND * lag < span.duration]
    where: dict[str, Any] = {"slot": "base", "turn": turn, "place": "environment"}
    for lag in lags if (alias := tilt_law("base", "time")) else ():
        late = curve_over(LearnedTilt, "time", 1, lag=lag, relaxing=True, **where)
        yield proportional(late, alias)


def tilt_law(slot: str, coordinate: str) -> str | None:
    """The law that a tilt has whatever its course; None: there is none."""
    laws = (c for c in CATALOGUE.values() if c.form == "any")
    return next((c.id for c in laws if c.family.has_tilt(slot, coordinate, None)), None)


def _late_tilts(span: CoordinateRanges) -> Iterator[Hypothesis]:
    """Tilts of frames that follow temperature late."""
    laws = [c for c in CATALOGUE.values() if c.lags_thermometer and c.family.tilt]
    for cls, turn, lag in product(laws, "xyz", LAGS):
        for slot, coordinate in cls.family.tilt:
            if not (knots := even_knots(coordinate, span, 3)):
                continue
            tilt = curve_over(
                LearnedTilt, coordinate, knots, lag=lag, slot=slot, turn=turn, place=cls.stage
            )
            yield _late(tilt, cls.id)
            if lag:  # without, that is the law itself
                yield proportional(tilt, cls.id)


def _reading_curves(
    scenario: Scenario, sensor: Sensor, axis: str, span: CoordinateRanges
) -> Iterator[Hypothesis]:
    where: dict[str, Any] = {"sensor": sensor.name, "axis": axis}
    yield from _angle_curves(scenario, sensor, axis, span)
    for cls, count in product(_of_any_form(sensor, "input"), (9, 17, 33)):
        if knots := even_knots(f"{sensor.name}_input", span, count):
            yield replace(curve_over(LearnedReading, "input", knots, **where), alias=cls.id)
    yield from _waves(span.lines.waves, where)
    of_body = "" if sensor.kind == "encoder" else "xyz"  # no encoder feels the body's motion
    inputs = [f"{q}_{a}" for q in ("force", "rate") for a in of_body]
    turns = [f"angular_acceleration_{a}" for a in of_body]
    own = f"{'force' if sensor.is_accelerometer else 'rate'}_{axis}"
    sideways = ["transverse"] if sensor.kind == "fog" else []
    others = [c for c in (*inputs, *turns, *sideways) if c != own]
    for coordinate in ("input", "turned", "time", "temperature", "warming", *others):
        of_sensor = coordinate in ("input", "turned")
        if knots := even_knots(f"{sensor.name}_{coordinate}" if of_sensor else coordinate, span, 7):
            yield curve_over(LearnedReading, coordinate, knots, **where)
            if coordinate in others and coordinate not in turns:
                yield from powers(coordinate, where)
    if sensor.quantity == "rate" and sum(f"rate_{a}" in span.ranges for a in "xyz") > 1:
        coning = "coning" if sensor.kind == "fog" else f"coning_{axis}"
        yield curve_over(LearnedReading, coning, 1, power=1.0, odd=True, **where)
    for coordinate in ("time", "temperature"):
        if knots := even_knots(coordinate, span, 5):
            scale = curve_over(LearnedReading, coordinate, knots, per_input=True, **where)
            yield scale
            if not sensor.is_accelerometer:  # its own law is in the catalogue
                yield proportional(scale)
    if scenario.rig.axes:
        across = [c for c in inputs if c != own and even_knots(c, span, 2)]
        for other in (c for c in across if c.startswith(own[:-2])):
            yield curve_over(
                LearnedReading, "time", even_knots("time", span, 5), times=other, **where
            )
        yield from varying_coefficients(sensor, across, span, where)
        yield from products(sensor, across, where)
    yield from _late_laws(sensor, axis, span, bool(scenario.rig.axes))
    # by hand only the length of its reading is known
    if scenario.rig.axes or not sensor.is_accelerometer:
        yield from motion_of_readings(scenario.rig, sensor, axis, inputs, span)


def _waves(waves: Iterable[Wave], where: Mapping[str, Any]) -> Iterator[Hypothesis]:
    """What repeats over the input of a channel, temperature or a table angle, at the lines found
    there.
    """
    for wave in waves:
        if (wave.sensor, wave.axis) == (where["sensor"], where["axis"]):
            scale = wave.times == "input"
            for per_input in (False, True) if wave.coordinate == "input" else (scale,):
                yield curve_over(
                    LearnedReading,
                    wave.coordinate,
                    harmonics(2),
                    period=wave.period,
                    times="" if scale else wave.times,
                    per_input=per_input,
                    **where,
                )


def _angle_curves(
    scenario: Scenario, sensor: Sensor, axis: str, span: CoordinateRanges
) -> Iterator[Hypothesis]:
    """Of the table's angles, one by one and in products of two."""
    where: dict[str, Any] = {"sensor": sensor.name, "axis": axis}
    names, turning = scenario.rig.axis_names, scenario.rig.kind.turning
    for name in names:
        for basis in bases_over(scenario.rig, name, span):
            yield curve_over(LearnedReading, f"table_{name}", basis, **where)
        if name in turning:
            yield curve_over(LearnedReading, f"table_{name}", harmonics(10), **where)
    for one, other in combinations(turning, 2):
        yield curve_over(
            LearnedReading, f"table_{one}", 4 * ORDERS**2, beside=f"table_{other}", **where
        )
    if scenario.rig.directions == PLACING.directions:  # its form is nobody's law, its place is
        angle = angle_channel(names[0])
        for cls in _of_any_form(sensor, angle, "unknown"):
            yield replace(curve_over(LearnedReading, angle, harmonics(6), **where), alias=cls.id)


def lags_of(duration: float) -> tuple[float, ...]:
    """Lags of a temperature that a recording of some duration may show, s: a heavy case is late by
    many minutes.
    """
    found = list(LAGS)
    while PACE * found[-1] * SHOWS < duration:
        found.append(PACE * found[-1])
    return tuple(found)


def _of_any_form(sensor: Sensor, coordinate: str, form: str = "any") -> list[type[Effect]]:
    """The effects of a sensor that stand for a curve over a coordinate."""
    laws = (c for c in CATALOGUE.values() if c.form == form and c.senses(sensor.kind))
    return [c for c in laws if coordinate in c.family.reading]


def _felt_late(sensor: Sensor, axis: str) -> list[tuple[str, str, dict[str, Any]]]:
    """What a channel may feel late: the law, what it follows, and what it multiplies.

    An accelerometer's late rate is not among them: its temperature is late by minutes.
    """
    laws = [c for c in CATALOGUE.values() if c.lags_thermometer and c.senses(sensor.kind)]
    others: list[dict[str, Any]] = [{"times": f"force_{a}"} for a in "xyz" if a != axis]
    return [
        (cls.id, coordinate, where)
        for coordinate in ("temperature", "warming")
        for cls in laws
        for wheres, followed in (
            ([{}], cls.family.reading),
            ([{"per_input": True}], cls.family.scale),
            (others, cls.family.across),
        )
        for where in wheres
        if coordinate in followed
    ]


def _late_laws(
    sensor: Sensor, axis: str, span: CoordinateRanges, on_table: bool
) -> Iterator[Hypothesis]:
    """Laws of temperature and of its rate where the thermometer and the sensor are not of one
    temperature.

    A rate that is late by more than a recording shows, (T - late T) / lag, is the temperature
    itself. By hand the force along an axis is not known.
    """
    where: dict[str, Any] = {"sensor": sensor.name, "axis": axis}
    felt, lags = _felt_late(sensor, axis), lags_of(span.duration)
    for (name, coordinate, factor), lag in product(felt, lags):
        knots = even_knots(coordinate, span, 3)
        shows = coordinate != "warming" or lag * SHOWS < span.duration
        if knots and shows and (on_table or "times" not in factor):
            late = curve_over(LearnedReading, coordinate, knots, lag=lag, **factor, **where)
            yield _late(late, name)
            if lag and on_table:  # by hand, in few poses, every law of temperature bends
                yield proportional(late, name)


def _late(curve: Hypothesis, alias: str) -> Hypothesis:
    """A law of temperature that is felt late and may bend: nothing at the middle of the range, as
    the law has nothing at T0.
    """
    return replace(odd_curve(curve), alias=alias)


# of a force or a rate; whether odd
POWERS = (
    (0.5, False),
    (0.5, True),
    (1.0, False),
    (2.0, False),
    (2.0, True),
    (3.0, True),
)
VARYING = ("temperature", "time", "speed")
"""What a coefficient may be in proportion to. Not the rate of warming: where a temperature swings
evenly, that is the same as a temperature that is felt late, which has laws of its own.
"""


def varying_coefficients(
    sensor: Sensor, across: Sequence[str], span: CoordinateRanges, where: Mapping[str, Any]
) -> Iterator[Hypothesis]:
    """Powers of the own input and of others whose coefficient is in proportion to what varies: a
    temperature, the time, the speed. Not those that the catalogue or a scale factor over the same
    coordinate holds.

    Args:
        sensor: whose reading; where: its channel.
        across: the other inputs; span: what the recordings span.
    """
    for times in (t for t in VARYING if even_knots(t, span, 2)):
        linear, forms = list(across), []
        if times == "temperature":
            forms += [("input", power, odd) for power, odd in POWERS if power > 1 or not odd]
            forms += [(c, 2.0, False) for c in across]
            if sensor.is_accelerometer:  # a misalignment
                linear = [c for c in across if not c.startswith("force")]
        forms += [(c, 1.0, True) for c in linear]
        for coordinate, power, odd in forms:
            yield curve_over(
                LearnedReading,
                coordinate,
                1,
                power=power,
                odd=odd,
                times=times,
                **where,
            )


def products(
    sensor: Sensor, across: Sequence[str], where: Mapping[str, Any]
) -> Iterator[Hypothesis]:
    """Products of two inputs, but for those of the catalogue; what stands for others by name.

    Args:
        sensor: whose reading; where: its channel.
        across: the inputs beside its own.
    """
    for one, other in combinations(("input", *across), 2):
        own = "force" if sensor.is_accelerometer else "rate"
        kinds = {(own if c == "input" else c).split("_")[0] for c in (one, other)}
        if kinds == {"force"} and sensor.is_accelerometer:
            continue
        laws = [c for c in CATALOGUE.values() if {c.products_of} == kinds and c.senses(sensor.kind)]
        curve = curve_over(LearnedReading, one, 1, power=1.0, odd=True, times=other, **where)
        yield replace(curve, alias=laws[0].id if laws else None)


def powers(coordinate: str, where: Mapping[str, Any]) -> Iterator[Hypothesis]:
    """Laws with one number: a root, a modulus, a square, a cube."""
    for power, odd in POWERS:
        if not (odd and coordinate == "transverse"):
            yield curve_over(LearnedReading, coordinate, 1, power=power, odd=odd, **where)


Place = tuple[type[Learned], dict[str, Any]]
HARMONICS = (1, 4)  # of a tone or a cycle: a sine, and a form of its own


def periodic_curves(
    observations: Observations, lines: SpectralLines, sensors: Sequence[str]
) -> Iterator[Hypothesis]:
    """At every place, one for each spectral line in time.

    Args:
        observations: whose table and sensors; lines: that stand out of their residual.
        sensors: that are read.
    """
    scenario = observations.scenario
    # of a line in a coefficient, each as probable as another
    frequencies = max(len(r) for r in observations.recordings) / 2
    for cls, where in _places(scenario, sensors) if lines.tones else ():
        for frequency, count in product(lines.tones, HARMONICS):
            yield curve_over(cls, "time", harmonics(count), period=1 / frequency, **where)
    modulated: list[tuple[type[Learned], dict[str, Any], tuple[float, ...]]] = [
        *((LearnedDelay, where, lines.late) for where in stamped(scenario, sensors)),
        *((LearnedTilt, where, lines.base_tilts) for where in frames(scenario, "base")),
        *((LearnedReading, where, lines.scales) for where in gains(scenario, sensors)),
    ]
    for cls, where, own in modulated:
        for frequency, count in product(own, HARMONICS):
            curve = curve_over(cls, "time", harmonics(count), period=1 / frequency, **where)
            yield replace(curve, log_odds=-float(np.log(frequencies)))


def stamped(scenario: Scenario, sensors: Sequence[str]) -> list[dict[str, Any]]:
    """Whose stamps may be late against those of a table: each sensor's, and all; none by hand,
    where there is no other clock.
    """
    each: list[str | None] = [s for s in sensors if scenario.rig.axes]
    every: list[str | None] = [*each, None] if len(each) > 1 else each
    return [{"sensor": sensor, "place": "timing"} for sensor in every]


def _places(scenario: Scenario, sensors: Sequence[str]) -> Iterator[Place]:
    for sensor in scenario.sensor:
        for axis in sensor.axes if sensor.name in sensors else ():
            yield LearnedReading, {"sensor": sensor.name, "axis": axis}
    for axis in scenario.rig.kind.turning:
        yield LearnedReadout, {"axis": axis, "place": "table"}
    for where in frames(scenario, "base", "mount"):
        yield LearnedTilt, where


def gains(scenario: Scenario, sensors: Sequence[str]) -> list[dict[str, Any]]:
    """The scale factors of the sensors that are read."""
    return [
        {"sensor": s.name, "axis": axis, "per_input": True}
        for s in scenario.sensor
        for axis in (s.axes if s.name in sensors else ())
    ]


def frames(scenario: Scenario, *slots: str) -> list[dict[str, Any]]:
    """The tilts of frames, base or mount; none by hand."""
    known = {"base": ("xy", "environment"), "mount": ("xyz", "mount")}
    return [
        {"slot": slot, "turn": turn, "place": known[slot][1]}
        for slot in (slots if scenario.rig.axes else ())
        for turn in known[slot][0]
    ]


def curves_of_axes(rig: Rig, span: CoordinateRanges) -> Iterator[Hypothesis]:
    """What no name fits of a table's axes."""
    yield from _of_axes(rig, span)
    yield from _of_two_angles(rig)
    yield from _varying_errors_of_axes(rig, span)


def _of_axes(rig: Rig, span: CoordinateRanges) -> Iterator[Hypothesis]:
    """Errors of a readout and tilts of a bearing over the table's angles."""
    for axis in rig.axis_names:
        for other in rig.axis_names:
            for basis in bases_over(rig, other, span):
                if axis in rig.kind.turning:
                    where: dict[str, Any] = {"axis": axis, "place": "table"}
                    yield curve_over(LearnedReadout, f"table_{other}", basis, **where)
                for turn in _across(dict(rig.axes)[axis]):
                    yield curve_over(
                        LearnedTilt,
                        f"table_{other}",
                        basis,
                        slot=bearing(axis),
                        turn=turn,
                        place="table",
                    )


def _varying_errors_of_axes(rig: Rig, span: CoordinateRanges) -> Iterator[Hypothesis]:
    """Errors of a readout over time, temperature and its rate; and over its own angle, as tilts of
    its bearing, those that grow with time, temperature, speed or an angle, or differ by which way
    it last went (Hastie and Tibshirani, J. R. Stat. Soc. B 55, 1993: coefficients that vary).
    """
    turning = rig.kind.turning
    for axis, coordinate in product(turning, ("time", "temperature", "warming")):
        if knots := even_knots(coordinate, span, 5):
            yield curve_over(LearnedReadout, coordinate, knots, axis=axis, place="table")
    factors = ["temperature", "time", "speed", *(angle_channel(axis) for axis in rig.axis_names)]
    known = [(axis, f, 2) for axis, f in product(turning, factors) if even_knots(f, span, 2)]
    known += [
        (axis, f"{LAST_DIRECTION}{axis}", 4) for axis in turning if span_of(axis, span) > BEGUN
    ]
    for axis, factor, orders in known:
        over: dict[str, Any] = {"place": "table", "times": factor}
        coordinate, count = angle_channel(axis), harmonics(orders)
        yield curve_over(LearnedReadout, coordinate, count, axis=axis, **over)
        for turn in _across(dict(rig.axes)[axis]):
            yield curve_over(LearnedTilt, coordinate, count, slot=bearing(axis), turn=turn, **over)


def _of_two_angles(rig: Rig) -> Iterator[Hypothesis]:
    """Errors of a readout and tilts of the base and the mount over products of two angles: with the
    curves over one angle any smooth law of the pose.
    """
    places = [("base", turn, "environment") for turn in "xy"]
    places += [("mount", turn, "mount") for turn in "xyz"]
    turning = rig.kind.turning
    for one, other in combinations(turning, 2):
        over: dict[str, Any] = {"beside": angle_channel(other)}
        coordinate, count = angle_channel(one), 4 * ORDERS**2
        for axis in turning:
            yield curve_over(LearnedReadout, coordinate, count, axis=axis, place="table", **over)
        for slot, turn, place in places:
            yield curve_over(
                LearnedTilt, coordinate, count, slot=slot, turn=turn, place=place, **over
            )


def bases_over(rig: Rig, axis: str, span: CoordinateRanges) -> Iterator[int | tuple[float, ...]]:
    """Bases of a curve over an axis: harmonics of an angle, knots over what is spanned."""
    if axis in rig.kind.turning:
        yield harmonics(4)
    if knots := even_knots(angle_channel(axis), span, 10):
        yield knots


def _across(axis: str) -> tuple[str, str]:
    i = "xyz".index(axis)
    return "xyz"[(i + 1) % 3], "xyz"[(i + 2) % 3]
