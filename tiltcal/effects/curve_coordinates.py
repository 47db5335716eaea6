"""What a learned curve may follow: what the sensor senses, the table's angles, time, temperature,
and how it moved before.
"""

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import DEG
from tiltcal.effects.hysteresis_and_lag import crossed, first_order_lag, play
from tiltcal.effects.sense import Sense
from tiltcal.setup.tables import axis_of
from tiltcal.setup.trajectory import Drive, Jet, Standstills, sampled_jet

INPUTS = {
    f"{quantity}_{axis}": (quantity, "xyz".index(axis))
    for quantity in ("force", "rate", "angular_acceleration", "coning")
    for axis in "xyz"
}
MOTION = ("speed", "since_move", "since_start", "moves")
"""Coordinates of how a table moved."""
OF_SENSOR = (
    "input",
    "transverse",
    "coning",
    "turned",
    "time",
    "temperature",
    "warming",
    "braking",
)
COORDINATES = (*INPUTS, *OF_SENSOR, *MOTION)
"""What a curve may follow, in addition to the angle of a table axis, ``table_<axis>``, and its
rate, ``turn_rate_<axis>``.

``input``: the channel's own; ``transverse``: rate across a FOG's axis; ``coning``: rate times
angular acceleration along it; ``turned``: angle that a rate sensor turned about its own axis since
the first stamp; ``warming``: dT/dt;
``speed``: magnitude of the rate of turn; ``braking``: minus its change per second; ``since_move``,
``since_start``: time since the last move ended, began; ``moves``: how many there were.
"""
LAST_DIRECTION = "way_"
"""Begins the name of a factor: direction in which a table axis last moved, -1 or 1,
``way_<axis>``.
"""
TURN_RATE = "turn_rate_"
"""Begins the name of a coordinate or factor: rate of a table axis, rad/s, ``turn_rate_<axis>``."""
BEGUN = 0.5 * DEG  # of a turn after which that is known, rad
AT_REST = 1e-3  # rad/s: less is no motion of a table, Earth's rate among it


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
