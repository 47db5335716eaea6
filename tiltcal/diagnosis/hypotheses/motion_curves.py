"""Curves over how a table moved before: the direction of the last motion, plays, forces and rates
that leak away, the heat of motion, the number of moves, the time since the last one.

Memories that tell the rate of change are lags, those that do not are plays: from both and a curve
every fading memory is approximated (Boyd and Chua 1985; Brokate and Sprekels 1996).
"""

from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any

import numpy as np

from tiltcal.core.units import DEG, G0
from tiltcal.diagnosis.hypotheses.coordinate_ranges import MEMORIES, late_key
from tiltcal.diagnosis.hypotheses.curve_forms import (
    curve_over,
    even_knots,
    harmonics,
    odd_curve,
    proportional,
    span_of,
    spread_knots,
)
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.effects.curve_coordinates import BEGUN, LAST_DIRECTION, TURN_RATE
from tiltcal.effects.learned import Learned, LearnedReading, LearnedReadout, LearnedTilt
from tiltcal.effects.sensor.environmental import AccHysteresis
from tiltcal.effects.spans import CoordinateRanges
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Rig
from tiltcal.setup.tables import angle_channel, bearing

COOLING = (10.0, 30.0, 100.0, 300.0)  # s, of what motion warms
STRUCTURE_LAGS_S = (4.0, 15.0, 60.0)  # s, of a structure that gives way late to what it carries
SHOWN = 2.0  # times a time constant of cooling that a recording has to last
TURNS = (BEGUN, 10 * DEG, 45 * DEG)  # rad, of a play; the first tells the direction
WOUND = (10 * DEG, 45 * DEG)  # rad, of what winds up before it slips
PLAYED = tuple(np.linspace(-1.0, 1.0, 5))  # knots over the state of a play
EVEN = (-1.0, 0.0, 1.0)  # the least knots of a curve over it that may be even
LOADS = (0.05 * G0, 0.2 * G0, 0.7 * G0)  # m/s2, of a play: widths between are refined
COUNTS = (2, 3, 4, 5)  # of moves after which a law begins anew


def motion_of_readings(
    rig: Rig, sensor: Sensor, axis: str, inputs: Sequence[str], span: CoordinateRanges
) -> Iterator[Hypothesis]:
    """Additions to the reading of a channel that follow what went before.

    Args:
        rig: whose axes move; span: what the recordings span.
        sensor, axis: of the channel.
        inputs: forces and rates that the sensor may feel.
    """
    where: dict[str, Any] = {"sensor": sensor.name, "axis": axis}
    yield from _motion(LearnedReading, rig.kind.turning, rig.axis_names, span, where)
    if spread_knots("since_move", span):
        for frequency in span.lines.echoes:
            yield curve_over(
                LearnedReading, "since_move", harmonics(3), period=1 / frequency, **where
            )
    for coordinate, lag in product(inputs, MEMORIES):
        if knots := even_knots(felt := late_key(coordinate, lag), span, 3):
            late = curve_over(LearnedReading, coordinate, knots, lag=lag, **where)
            yield odd_curve(late)
            yield proportional(late)
            bent = even_knots(felt, span, 5)
            yield curve_over(LearnedReading, coordinate, bent, lag=lag, **where)
    yield from _scales(rig, span, where)
    yield from _scales_by_inputs(sensor, inputs, span, where)
    yield from _squares(sensor, inputs, span, where)
    for name, lag in product(rig.kind.turning, MEMORIES):
        if even_knots(angle_channel(name), span, 2):
            yield curve_over(LearnedReading, angle_channel(name), harmonics(3), lag=lag, **where)
    # by its own force an accelerometer's play is a listed law: one signal has one name
    own = {f"force_{where['axis']}"} if sensor.kind in AccHysteresis.kinds else set()
    forces = [c for c in inputs if c.startswith("force") and c not in own]
    for coordinate, travel in product(forces, LOADS):
        yield _played(LearnedReading, coordinate, travel, where)
    for name, per_input in product(rig.kind.turning, (False, True)):
        if span_of(name, span) > BEGUN:
            one_way = {"times": f"{LAST_DIRECTION}{name}", "per_input": per_input, **where}
            yield curve_over(LearnedReading, angle_channel(name), harmonics(3), **one_way)
    if knots := even_knots("braking", span, 7):
        yield curve_over(LearnedReading, "braking", knots, **where)


def _scales(rig: Rig, span: CoordinateRanges, where: dict[str, Any]) -> Iterator[Hypothesis]:
    """Scale factors of a channel that follow the motion: what loads its supply, what wears."""
    for lag in (0.0, *MEMORIES) if even_knots("speed", span, 2) else ():
        scale = curve_over(LearnedReading, "speed", 1, lag=lag, per_input=True, **where)
        yield proportional(scale)
    if knots := even_knots("moves", span, 5):
        yield curve_over(LearnedReading, "moves", knots, per_input=True, **where)
    if knots := spread_knots("since_move", span):
        yield curve_over(LearnedReading, "since_move", knots, per_input=True, **where)
    for name in rig.kind.turning:
        if even_knots(angle := angle_channel(name), span, 2):
            yield curve_over(LearnedReading, angle, harmonics(3), per_input=True, **where)


def _scales_by_inputs(
    sensor: Sensor, inputs: Sequence[str], span: CoordinateRanges, where: dict[str, Any]
) -> Iterator[Hypothesis]:
    """Scale factors of a channel that follow what the sensor felt before: late, or by the state of
    a play, whose curve may be even.
    """
    kind = "force" if sensor.is_accelerometer else "rate"
    felt = [c for c in inputs if c.startswith(kind) and even_knots(c, span, 2)]
    for coordinate, lag in product(felt, MEMORIES):
        late = curve_over(LearnedReading, coordinate, 1, lag=lag, per_input=True, **where)
        yield proportional(late)
    # a narrow play tells which way a force last went, and an angle does that
    for coordinate, travel in product(felt if kind == "force" else (), LOADS[1:]):
        state = {"play": travel, "per_input": True, **where}
        yield curve_over(LearnedReading, coordinate, EVEN, **state)


def _squares(
    sensor: Sensor, inputs: Sequence[str], span: CoordinateRanges, where: dict[str, Any]
) -> Iterator[Hypothesis]:
    """What follows the late square of an input, as power warms: the diagonal of a second-order
    Volterra kernel that fades exponentially; and scale factors that follow another input's square.
    """
    kind = "force" if sensor.is_accelerometer else "rate"
    felt = [c for c in inputs if c.startswith(kind) and even_knots(c, span, 2)]
    lags = [lag for lag in COOLING if SHOWN * lag < span.duration]
    forms = [(c, lag, scale) for c in felt for lag in lags for scale in (False, True)]
    forms += [(c, 0.0, True) for c in felt if c != f"{kind}_{where['axis']}"]
    if sensor.kind == "fog":  # its axis is none of the body's
        forms += [("input", lag, scale) for lag in lags for scale in (False, True)]
    for coordinate, lag, per_input in forms:
        square = {"power": 2.0, "lag": lag, "per_input": per_input, **where}
        yield curve_over(LearnedReading, coordinate, 1, **square)


def motion_of_frames(rig: Rig, span: CoordinateRanges) -> Iterator[Hypothesis]:
    """Tilts of frames and errors of readouts that follow what went before."""
    for axis in rig.kind.turning:
        where: dict[str, Any] = {"axis": axis, "place": "table"}
        for travel in WOUND:  # a play of some arcsec is a backlash, which is listed
            if span_of(axis, span) > travel:
                yield curve_over(LearnedReadout, angle_channel(axis), PLAYED, play=travel, **where)
        yield from _motion(LearnedReadout, rig.kind.turning, (), span, where)
        knots = even_knots(angle_channel(axis), span, 2)
        for lag in STRUCTURE_LAGS_S if knots else ():
            late = {"lag": lag, "relaxing": True, **where}
            curve = curve_over(LearnedReadout, angle_channel(axis), knots, **late)
            yield proportional(curve)
    every = rig.axis_names
    places = [("base", turn, "environment", every) for turn in "xy"]
    places += [("mount", turn, "mount", every) for turn in "xyz"]
    for name, body in rig.axes:
        places += [(bearing(name), turn, "table", (name,)) for turn in "xyz" if turn != body]
    for slot, turn, place, axes in places:
        where = {"slot": slot, "turn": turn, "place": place}
        yield from _motion(LearnedTilt, rig.kind.turning, axes, span, where)
        turning = [name for name in axes if name in rig.kind.turning]
        for name, lag, relaxing in product(turning, STRUCTURE_LAGS_S, (False, True)):
            late = {"lag": lag, "relaxing": relaxing, **where}
            yield curve_over(LearnedTilt, angle_channel(name), harmonics(1), **late)


def loads_of_mount(span: CoordinateRanges) -> Iterator[Hypothesis]:
    """Tilts of the mount over the weight that it carries: of now, late, what is left of it, and the
    state of a play.
    """
    for turn, axis in product("xyz", "xyz"):
        coordinate = f"force_{axis}"
        where = {"slot": "mount", "turn": turn, "place": "mount"}
        knots = even_knots(coordinate, span, 5)
        yield curve_over(LearnedTilt, coordinate, knots, **where)
        for lag, relaxing in product(STRUCTURE_LAGS_S, (False, True)):
            late = curve_over(LearnedTilt, coordinate, knots, lag=lag, relaxing=relaxing, **where)
            yield proportional(late)
        for travel in LOADS:
            yield _played(LearnedTilt, coordinate, travel, where)


def _motion(
    cls: type[Learned],
    turning: Sequence[str],
    axes: Sequence[str],
    span: CoordinateRanges,
    where: dict[str, Any],
) -> Iterator[Hypothesis]:
    """What every place may follow of the motion of the table and of the axes that turn, and of the
    way that some axes last went.
    """
    for coordinate in ("since_move", "since_start"):
        if knots := spread_knots(coordinate, span):
            yield curve_over(cls, coordinate, knots, **where)
    if knots := even_knots("moves", span, 7):
        yield curve_over(cls, "moves", knots, **where)
        for period in COUNTS:
            waves = 2 * (period // 2) - (period % 2 == 0)
            yield curve_over(cls, "moves", waves, period=float(period), **where)
    for name, travel in product(axes, TURNS):
        if span_of(name, span) > travel:
            yield _played(cls, angle_channel(name), travel, where)
    for name in turning:
        if knots := even_knots(rate := f"{TURN_RATE}{name}", span, 7):
            yield curve_over(cls, rate, knots, **where)
    if knots := even_knots("speed", span, 7):
        yield curve_over(cls, "speed", knots, **where)
        for lag in COOLING:
            if SHOWN * lag < span.duration:
                late = curve_over(cls, "speed", knots, lag=lag, **where)
                yield proportional(late)


def _played(
    cls: type[Learned], coordinate: str, travel: float, where: dict[str, Any]
) -> Hypothesis:
    """What is in proportion to the state of a play."""
    state = curve_over(cls, coordinate, (-1.0, 1.0), play=travel, **where)
    return proportional(state)
