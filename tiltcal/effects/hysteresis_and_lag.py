"""Effects with memory: play, direction of the last motion, stops."""

from functools import lru_cache

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import G0
from tiltcal.setup.trajectory import Jet


def play(u: Array, width: float) -> Array:
    """State of a play (backlash) operator of half-width ``width / 2``, in [-1, 1], (n,). width: in
    the unit of the input.

    The output follows the input only where it is pushed; (input - output) / (width / 2) is
    returned, 0 before the first motion. Each sample clips the output to what the play allows, and
    clips one after the other are a clip: all of them are worked out by doubling (a prefix scan:
    Hillis and Steele, Commun. ACM 29, 1986).
    """
    if width <= 0 or len(u) == 0:
        return np.asarray(np.sign(last_direction(u)))
    return _play(np.asarray(u, float).tobytes(), width)


@lru_cache(maxsize=24)
def _play(values: bytes, width: float) -> Array:
    """``play`` of the contents of an array: many curves follow one state; not to be written to."""
    u, half = np.frombuffer(values), width / 2
    low, high, span = u - half, u + half, 1
    while span < len(u):
        least, most = low[span:], high[span:]
        low = np.concatenate([low[:span], np.clip(low[:-span], least, most)])
        high = np.concatenate([high[:span], np.clip(high[:-span], least, most)])
        span *= 2
    state = (u - np.clip(u[0], low, high)) / half
    state.flags.writeable = False
    return state


def rounded_play(u: Array, width: float, start: float = 0.0) -> Array:
    """State of a memory that gives way gradually, in [-1, 1], (n,): dz = (sign(du) - z) |du| /
    width (Dahl 1968), ``start`` at first. width: in the unit of the input; start: of the state,
    without unit.
    """
    if width <= 0 or len(u) == 0:
        return play(u, width)
    step = np.diff(u)
    decay = np.exp(-np.abs(step) / width)
    return recursion(decay, np.concatenate([[start], np.sign(step) * (1 - decay)]))


def last_direction(u: Array) -> Array:
    """Sign of the last change at or before each sample, (n,): +1, -1, or 0 before the first
    motion.
    """
    return _held(np.sign(np.diff(u, prepend=u[:1])))


def _held(sign: Array) -> Array:
    """The last value that was not zero, 0 before the first, (n,)."""
    last = np.maximum.accumulate(np.where(sign != 0, np.arange(len(sign)), -1))
    return np.where(last >= 0, sign[np.maximum(last, 0)], 0.0)


LAGS = (0.0, 8.0, 16.0, 30.0, 60.0)  # s, of a temperature
ARRIVED = 1e-9  # of half a play: nearer to a side than this it is pushed
RINGING = 0.05  # of the largest rate of a motion: what a local polynomial makes of its ends


def motion_direction(angle: Jet) -> Array:
    """Sign of the last motion of an axis at each sample, (n,): from its rate, which is zero at
    standstill where a readout is noisy; from its steps when only poses are known."""
    rate = np.broadcast_to(angle.v, np.shape(angle.x))
    if not rate.any():
        return last_direction(np.asarray(angle.x))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], rate != 0, [False]]).astype(int)))
    # of each motion by itself: a readout differentiated rings where a fast one stops
    limit = np.zeros_like(rate)
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        limit[start:end] = RINGING * np.abs(rate[start:end]).max()
    limit = np.maximum(limit, 1e-4 * np.abs(rate).max())
    sign = np.sign(rate)
    # where each direction begins: a soft start is part of it, however slow
    runs = np.flatnonzero(np.diff(sign, prepend=2.0))
    lengths = np.diff(runs, append=len(rate))
    fastest = np.repeat(np.maximum.reduceat(np.abs(rate), runs), lengths)
    return _held(np.where(fastest > limit, sign, 0.0))


def crossed(angle: Jet, travel: float) -> Jet:
    """On which side of its play an axis is pushed, in [-1, 1], with its derivatives, (n,).

    Args:
        angle: of what pushes, rad.
        travel: from one side to the other, rad; 0: at once.
    """
    if travel <= 0:
        side = motion_direction(angle)
        return Jet(side, np.zeros_like(side), np.zeros_like(side))
    side = play(np.asarray(angle.x), travel)
    slope = np.where(np.abs(side) < 1 - ARRIVED, 2 / travel, 0.0)
    return Jet(side, slope * angle.v, slope * angle.a)


def onset(elapsed: Array, time: float, creep: float) -> Array:
    """A step at ``time``, or, with a time constant ``creep`` (s), what sets in there and tends to
    one, (n,).
    """
    since = np.maximum(elapsed - time, 0.0)
    return np.where(elapsed >= time, 1 - np.exp(-since / creep) if creep > 0 else 1.0, 0.0)


def first_order_lag(time: Array, u: Array, tau: float) -> Array:
    """Output of 1/(1 + tau s) for an input that is linear between samples, starting in equilibrium.
    time, u: (n,).

    Exact for irregular stamps.
    """
    if tau <= 0 or len(u) < 2:
        return u
    return _lagged(np.asarray(time, float).tobytes(), np.asarray(u, float).tobytes(), tau)


@lru_cache(maxsize=24)
def _lagged(times: bytes, values: bytes, tau: float) -> Array:
    """``first_order_lag`` of the contents of arrays: many curves follow one lagged coordinate; not
    to be written to.
    """
    time, u = np.frombuffer(times), np.frombuffer(values)
    dt = np.diff(time)
    decay = np.exp(-dt / tau)
    slope = np.diff(u) / dt
    # y1 = decay y0 + (u1 - slope tau) - decay (u0 - slope tau)
    drive = np.concatenate([u[:1], (u[1:] - slope * tau) - decay * (u[:-1] - slope * tau)])
    lagged = recursion(decay, drive)
    lagged.flags.writeable = False
    return lagged


def smooth_lag(time: Array, u: Array, tau: float) -> Array:
    """Output of 1/(1 + tau s) for an input that is smooth between samples, starting in equilibrium;
    NaN where the instants do not increase, as by a delay that grows faster than time: no such
    reading exists. time, u: (n,).

    On each interval of the cubic spline through the samples y = p + (y0 - p0) exp(-t / tau), where
    p is u less tau times its slope and so on to the third derivative. A lag much shorter than the
    interval needs the slope at the sample, which an input that is linear between samples has half
    an interval too early.
    """
    if tau <= 0 or len(u) < 4:
        return first_order_lag(time, u, tau)
    if not (np.diff(time) > 0).all():
        return np.full(len(u), np.nan)
    from scipy.interpolate import CubicSpline

    third, second, slope, _ = CubicSpline(time, u).c  # of u = slope h + second h^2 + third h^3
    h = np.diff(time)
    start = u[:-1] - tau * slope + 2 * tau**2 * second - 6 * tau**3 * third
    end = (
        u[1:]
        - tau * (slope + (2 * second + 3 * third * h) * h)
        + tau**2 * (2 * second + 6 * third * h)
        - 6 * tau**3 * third
    )
    decay = np.exp(-h / tau)
    return recursion(decay, np.concatenate([u[:1], end - decay * start]))


def recursion(decay: Array | float, drive: Array) -> Array:
    """y_0 = drive_0, y_k = decay_k y_(k-1) + drive_k, (n,), as a bidiagonal system. decay: (n - 1,)
    or a number.
    """
    from scipy.linalg import solve_banded

    bands = np.ones((2, len(drive)))
    bands[1, :-1] = -np.asarray(decay)
    return np.asarray(solve_banded((1, 0), bands, drive, overwrite_ab=True, check_finite=False))


def steady_recursion(decay: float, drive: Array) -> Array:
    """``recursion`` with one decay in (0, 1) for all samples, much faster: cumulative sums in
    blocks short enough to be exact.
    """
    n = len(drive)
    length = _block_length(decay, n)
    if length < 8:
        return recursion(decay, drive)
    blocks = -(-n // length)
    powers = decay ** np.arange(length)
    local = np.zeros((blocks, length))
    local.ravel()[:n] = drive
    local /= powers
    np.cumsum(local, axis=1, out=local)
    local *= powers
    carry = 0.0
    onward = decay * powers
    for row in local:
        row += carry * onward
        carry = row[-1]
    return local.ravel()[:n]


def _block_length(decay: float, n: int) -> int:
    """Samples of a block: its weights span e^18, six digits from overflow."""
    return min(max(int(-18 / np.log(decay)), 1), n)


class SteadyRecursion:
    """``steady_recursion`` of n samples piece by piece, to the bit; not with blocks below 8.

    Args:
        decay: in (0, 1).
        n: samples of all pieces.
    """

    def __init__(self, decay: float, n: int) -> None:
        self.decay, self.length, self.done = decay, _block_length(decay, n), 0
        self._powers = decay ** np.arange(self.length)
        self._sum, self._last, self._carry = 0.0, 0.0, 0.0

    def __call__(self, drive: Array) -> Array:
        """The next samples, (n,)."""
        found = np.empty(len(drive))
        first = 0
        while first < len(drive):
            at = self.done % self.length
            if at == 0:
                self._sum, self._carry = 0.0, self._last
            last = min(first + self.length - at, len(drive))
            powers = self._powers[at : at + last - first]
            sums = drive[first:last] / powers
            if at:
                sums[0] += self._sum
            np.cumsum(sums, out=sums)
            self._sum = float(sums[-1])
            sums *= powers
            sums += self._carry * (self.decay * powers)
            found[first:last], self._last = sums, float(sums[-1])
            self.done, first = self.done + last - first, last
        return found


def vibration_power(force: Array, rate_hz: float) -> Array:
    """Mean square over 1 s of what is faster than 0.25 s, in g^2, (n,). force: m/s2."""
    fast = force / G0
    fast = fast - moving_mean(fast, rate_hz * 0.25)
    return moving_mean(fast * fast, rate_hz)


def moving_mean(u: Array, width: float) -> Array:
    """Centred mean over ``width`` samples, ends held, (n,). width: without unit."""
    from scipy.ndimage import uniform_filter1d

    return np.asarray(uniform_filter1d(u, max(round(width), 1), axis=0, mode="nearest"))
