"""What a learned curve may follow: what the sensor senses, the table's angles, time, temperature,
and how it moved before.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import DEG, G0, split_unit
from tiltcal.effects.hysteresis_and_lag import crossed, first_order_lag, play
from tiltcal.effects.sense import Sense
from tiltcal.setup.tables import CHANNEL, axis_of
from tiltcal.setup.trajectory import Drive, Jet, Standstills, sampled_jet

INPUTS = {
    f"{quantity}_{axis}": (quantity, "xyz".index(axis))
    for quantity in ("force", "rate", "angular_acceleration", "coning")
    for axis in "xyz"
}
TURN_RATE = "turn_rate_"
"""Begins the name of a coordinate or factor: rate of a table axis, rad/s, ``turn_rate_<axis>``."""
LAST_DIRECTION = "way_"
"""Begins the name of a factor: direction in which a table axis last moved, -1 or 1,
``way_<axis>``.
"""


@dataclass(frozen=True)
class Coordinate:
    """What a curve may follow, and how it is called.

    Args:
        words: in a sentence; ``{}`` stands for the axis of the body or of the table.
        follows: word for it in ``where.coordinate`` of a diagnosis; empty: its own name.
        unit: in which it is shown; of ``input`` that of its sensor.
        size: of the unit, SI.
        factor: words where it multiplies a curve; empty: the same.
        sensors: kinds of sensors that sense it; empty: all.
        need: what a file may ask for instead, for the error.
        of_frames: whether it says how a table moved, which frames and readouts may follow.
        extrapolates: whether a spline goes on beyond the range that was seen: the next recording
            has other temperatures.
        is_history: whether no other recording goes through it again.
    """

    words: str
    follows: str = ""
    unit: str = "s"
    size: float = 1.0
    factor: str = ""
    sensors: tuple[str, ...] = ()
    need: str = ""
    of_frames: bool = False
    extrapolates: bool = False
    is_history: bool = False


def _of_rate(words: str, unit: str = "deg_s", **more: Any) -> Coordinate:
    """One that a rate of turn tells: an angle in deg, or its change."""
    return Coordinate(words, "rate", unit, DEG, **more)


REGISTRY: Mapping[str, Coordinate] = {
    "input": Coordinate("its own input", "tilt", "g", G0),
    "force_": Coordinate("force along body {}", "tilt", "g", G0, factor="the force along body {}"),
    "rate_": _of_rate("rate along body {}", factor="the rate along body {}"),
    "angular_acceleration_": _of_rate(
        "angular acceleration along body {}",
        "deg_s2",
        factor="the angular acceleration along body {}",
    ),
    "coning_": _of_rate("coning along body {}", factor="the coning along body {}"),
    "transverse": _of_rate(
        "the rate across its axis", sensors=("fog",), need="a FOG, which has an axis of its own"
    ),
    "coning": _of_rate(
        "coning (rate times angular acceleration) along its axis",
        sensors=("fog",),
        need="a FOG, which has an axis of its own; of a gyro coning_x, _y or _z",
    ),
    "turned": Coordinate(
        "the angle that it turned about its axis",
        "tilt",
        "deg",
        DEG,
        sensors=("gyro", "fog"),
        need="a gyro or a FOG, whose rate is summed up to an angle",
    ),
    "time": Coordinate("time", factor="the time", is_history=True),
    "temperature": Coordinate(
        "temperature", unit="degC", factor="the temperature from T0", extrapolates=True
    ),
    "warming": Coordinate("the rate of warming", "temperature", "degC_s"),
    "braking": _of_rate("how quickly the turn slows down", "deg_s2"),
    "speed": _of_rate("the speed of turn", of_frames=True),
    "since_move": Coordinate("the time since the last move", "move", of_frames=True),
    "since_start": Coordinate("the time since the last move began", "move", of_frames=True),
    "moves": Coordinate("the number of moves", "move", "moves", of_frames=True, is_history=True),
    CHANNEL: Coordinate("the {} angle", unit="deg", size=DEG),
    TURN_RATE: _of_rate("the rate of the {} angle"),
    LAST_DIRECTION: Coordinate("which way the {} angle last went"),
}
"""Every coordinate by its name, or by how it begins before an axis: of the body, of the table.

``input``: the channel's own; ``transverse``: rate across a FOG's axis; ``coning``: rate times
angular acceleration along it; ``turned``: angle that a rate sensor turned about its own axis since
the first stamp; ``warming``: dT/dt; ``speed``: magnitude of the rate of turn; ``braking``: minus
its change per second; ``since_move``, ``since_start``: time since the last move ended, began;
``moves``: how many there were.
"""
MOTION = tuple(name for name, one in REGISTRY.items() if one.of_frames)
"""Coordinates of how a table moved."""
OF_SENSOR = tuple(name for name in REGISTRY if not name.endswith("_") and name not in MOTION)
COORDINATES = (*INPUTS, *OF_SENSOR, *MOTION)
"""What a curve may follow, in addition to the angle of a table axis, ``table_<axis>``, and its
rate, ``turn_rate_<axis>``.
"""


@cache
def coordinate_named(name: str) -> Coordinate:
    """What is known of a coordinate, its words with its axis.

    Raises:
        KeyError: there is no such coordinate.
    """
    if name in REGISTRY:
        return REGISTRY[name]
    start = next((s for s in REGISTRY if s.endswith("_") and name.startswith(s)), name)
    axis, found = name.removeprefix(start), REGISTRY[start]
    return replace(found, words=found.words.format(axis), factor=found.factor.format(axis))


BEGUN = 0.5 * DEG  # of a turn after which that is known, rad
AT_REST = 1e-3  # rad/s: less is no motion of a table, Earth's rate among it


def shown_name(name: str) -> str:
    """A coordinate with the unit in which it is shown, ``speed_deg_s``."""
    unit = coordinate_named(name).unit
    return name if name == unit else f"{name}_{unit}"


def title_of(shown: str) -> tuple[str, str]:
    """Words and unit of a coordinate with its unit, which may be another than its own."""
    own = sorted({one.unit for one in REGISTRY.values()}, key=len, reverse=True)
    unit = next((u for u in own if shown.endswith(f"_{u}")), split_unit(shown)[1]) or ""
    words = coordinate_named(shown.removesuffix(f"_{unit}")).words
    return words.removeprefix("the ").replace("its own input", "own reading"), unit


def coordinate_of(
    name: str, sense: Sense, own: Array, lag: float = 0.0, travel: float = 0.0
) -> Array:
    """A coordinate along what a sensor senses, (n,).

    A lagged temperature rate is that of the lagged temperature: both begin with sensor and
    thermometer of one temperature.

    Args:
        name: of the coordinate.
        sense: what the sensor senses.
        own: the channel's true input, SI, (n,).
        lag: s, time constant by which the coordinate is lagged.
        travel: width of a play that it moves, SI: its state, in [-1, 1], replaces it; 0: none.
    """
    if name == "warming":
        return coordinate_rate(sense.time, sense.temperature, lag)
    u = sensed(name, sense, own)
    if travel:
        return play(u, travel)
    return first_order_lag(sense.time, u, lag) if lag else u


def coordinate_rate(time: Array, u: Array, lag: float) -> Array:
    """Change per second of a coordinate that is lagged by a time constant, s, (n,); nothing of
    less than two samples.
    """
    if len(time) < 2:
        return np.zeros(len(time))
    return np.gradient(first_order_lag(time, u, lag), time)


def sensed(name: str, sense: Sense, own: Array) -> Array:
    """A coordinate of now along what a sensor senses, (n,); ``own``: the channel's true input."""
    if (own_axis := axis_of(name)) is not None:
        return sense.angles[own_axis]
    if name.startswith(LAST_DIRECTION):
        return play(sense.angles[name.removeprefix(LAST_DIRECTION)], BEGUN)
    if name.startswith(TURN_RATE):
        return sense.turn_rates[name.removeprefix(TURN_RATE)]
    if name in INPUTS:
        quantity, axis = INPUTS[name]
        return np.asarray(getattr(sense, quantity)[:, axis])
    if name == "transverse":
        return np.asarray(np.linalg.norm(np.cross(sense.rate, sense.input_vector), axis=1))
    if name == "coning":
        return np.asarray(sense.coning @ sense.input_vector)
    if name == "turned":
        return turned_by(own, sense.time)
    if name == "speed":
        return np.asarray(np.linalg.norm(sense.rate, axis=1))
    if name == "braking":
        return _braking(sense.rate, sense.angular_acceleration)
    if name in ("since_move", "since_start", "moves"):
        return np.asarray(getattr(sense, name))
    return {"input": own, "time": sense.elapsed, "temperature": sense.temperature}[name]


def turned_by(rate: Array, time: Array) -> Array:
    """Angle since the first stamp, rad, (n, ...): the trapezoids of a rate, rad/s, (n, ...)."""
    steps = np.diff(time).reshape(-1, *[1] * (rate.ndim - 1)) * (rate[1:] + rate[:-1]) / 2
    return np.concatenate([np.zeros_like(rate[:1]), np.cumsum(steps, axis=0)])


def _braking(rate: Array, acceleration: Array) -> Array:
    """Minus the change of the magnitude of a rate, rad/s2, (n, 3) -> (n,)."""
    speed = np.maximum(np.linalg.norm(rate, axis=1), AT_REST)
    return -np.asarray(np.einsum("ij,ij->i", rate, acceleration)) / speed


def motion_jet(name: str, drive: Drive, travel: float = 0.0) -> Jet:
    """A coordinate of the table's motion along a drive with its time derivatives, (n,): an angle,
    its rate, its last direction, time, or one of MOTION.

    Counts and directions jump while the table moves; their derivatives are left out.

    Args:
        name: of the coordinate.
        drive: along which.
        travel: width of a play that an angle moves, rad: its state is felt instead; 0: none.
    """
    if (axis := axis_of(name)) is not None:
        angle = drive.axes[axis]
        return crossed(angle, travel) if travel else angle
    if name.startswith(LAST_DIRECTION):
        return crossed(drive.axes[name.removeprefix(LAST_DIRECTION)], BEGUN)
    one = np.ones_like(drive.time)
    if name.startswith(TURN_RATE):
        turning = drive.axes[name.removeprefix(TURN_RATE)]
        return Jet(turning.v * one, turning.a * one, 0 * one)
    if name == "time":
        return Jet(drive.elapsed, one, 0 * one)
    if name == "speed":
        return _speed(drive)
    standstills = Standstills.at(drive.standstills, drive.time, drive.stop)
    if name == "moves":
        return Jet(standstills.moves(drive.time), 0 * one, 0 * one)
    since = standstills.since if name == "since_move" else standstills.since_start
    return Jet(since(drive.time), one, 0 * one)


def force_jet(name: str, drive: Drive, force: Array, travel: float = 0.0) -> Jet:
    """A component of a force along a drive with its time derivatives, (n,).

    Args:
        name: ``force_x``, ...
        drive: along which.
        force: m/s2, (n, 3).
        travel: as in ``motion_jet``, m/s2.
    """
    u = sampled_jet(drive.time, force[:, INPUTS[name][1]])
    return crossed(u, travel) if travel else u


def _speed(drive: Drive) -> Jet:
    """Magnitude of the axes' rates, rad/s."""
    rates, changes = (
        np.column_stack([np.broadcast_to(part, drive.time.shape) for part in parts])
        for parts in zip(*((jet.v, jet.a) for jet in drive.axes.values()), strict=True)
    )
    speed = np.asarray(np.linalg.norm(rates, axis=1))
    return Jet(speed, -_braking(rates, changes), np.zeros_like(speed))


def lagged_jet(each: Jet, time: Array, lag: float) -> Jet:
    """Columns that are lagged by a time constant ``lag``, s, with their time derivatives, (n,
    p).
    """
    columns, slopes = np.asarray(each.x), np.asarray(each.v)
    lagged = np.column_stack([first_order_lag(time, u, lag) for u in columns.T])
    rise = (columns - lagged) / lag
    return Jet(lagged, rise, (slopes - rise) / lag)
