"""From motion to readings: closed form, with a hook at every place where unstated physics can
act.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from blind.laboratory import EARTH_RATE, Lab
from blind.memory import leaky, play
from blind.motion import Track
from blind.rotations import about, by_vector, unskew

H = 1e-3  # s: step of the central differences of attitude and position
Hook = Callable[..., Any] | None
# nodes and weights of int_0^inf exp(-u) y(u) du: a first-order lag of smooth signals
LAG_U, LAG_W = np.polynomial.laguerre.laggauss(6)


@dataclass(frozen=True)
class Physics:
    """What one effect adds. Every hook takes the Past (what happened until now) and t or a
    State.
    """

    readout: Hook = None  # (past, t) -> (n, axes): readout minus truth
    base: Hook = None  # (past, t) -> (n, 3): rotation vector of the base, world
    shake: Hook = None  # (past, t) -> (n, 3): acceleration of the base, world
    axis_tilt: Hook = None  # (past, axis, angle) -> (n, 3): rotation vector before that axis
    between: Hook = None  # (axis) -> (3,): rotation vector after that axis
    offset: Hook = None  # (axis) -> (3,): displacement after that axis
    # (past, t, up) -> (n, 3): rotation vector of the mount; up = static specific force / g
    mount: Hook = None
    lever: Hook = None  # () -> (3,)
    sense: Hook = None  # (past, state) -> {sensor: (n, axes)} added to the sensing form
    shape: Hook = None  # (past, state, sensor, reading) -> reading: codes, clips, gains
    delay: Hook = None  # () -> {sensor: (axes,)} s
    lag: Hook = None  # () -> {sensor: tau s}, first order
    stamps: Hook = None  # (t) -> t: when the signal was really taken

    @property
    def mechanical(self) -> bool:
        """It changes what the sensors truly feel."""
        hooks = (
            self.readout,
            self.base,
            self.shake,
            self.axis_tilt,
            self.between,
            self.offset,
            self.mount,
            self.lever,
        )
        return any(h is not None for h in (*hooks, self.delay, self.lag, self.stamps))


@dataclass(frozen=True)
class State:
    """What the sensors truly feel. f, w, dw: (n, 3) body; angles: (n, axes) readout; R: (n, 3, 3)
    body to world.
    """

    t: np.ndarray
    angles: np.ndarray
    f: np.ndarray
    w: np.ndarray
    dw: np.ndarray
    T: np.ndarray
    R: np.ndarray


class Past:
    """The recording's history on a uniform grid; memories are computed once and looked up at any
    instant.
    """

    STEP_S = 0.02

    def __init__(self, lab: Lab) -> None:
        self.lab = lab
        self.grid = np.arange(0.0, lab.track.end_s + self.STEP_S, self.STEP_S)
        self._kept: dict[Any, np.ndarray] = {}

    def kept(self, key: Any, make: Callable[[], np.ndarray]) -> np.ndarray:
        """``make()``, once."""
        if key not in self._kept:
            self._kept[key] = make()
        return self._kept[key]

    @property
    def state(self) -> State:
        """The nominal state on the grid."""
        return self.kept("state", lambda: felt(self.lab, (), self.grid, self))  # type: ignore[return-value]

    def at(self, t: np.ndarray, key: Any, make: Callable[[], np.ndarray]) -> np.ndarray:
        """A curve on the grid, looked up at t."""
        return _smoothly(t / self.STEP_S, self.kept(key, make))

    def angles(self, track: Track, t: np.ndarray) -> np.ndarray:
        """Angles of all axes as commanded; the same few instants are asked for by every column."""
        return (
            self.kept(("angles", t.tobytes()), lambda: track.angles(t))
            if track is self.lab.track
            else track.angles(t)
        )

    def play(self, t: np.ndarray, what: str, k: int, half_width: float) -> np.ndarray:
        """State in [-1, 1] of the play of a column of the state ('f', 'w', 'angles') or of 'T'."""
        return self.at(t, (what, k, half_width), lambda: play(self.column(what, k), half_width))

    def leaky(self, t: np.ndarray, what: str, k: int, tau_s: float) -> np.ndarray:
        """First-order lag of such a column."""
        return self.at(
            t, ("leaky", what, k, tau_s), lambda: leaky(self.column(what, k), tau_s, self.STEP_S)
        )

    def column(self, what: str, k: int) -> np.ndarray:
        """One column of the nominal state on the grid."""
        value = getattr(self.state, what)
        return value if value.ndim == 1 else value[:, k]


def _smoothly(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Cubic (Catmull-Rom) interpolation, so that rates are continuous. x: (n,) in steps, y:
    (m,).
    """
    k = np.clip(np.floor(x).astype(int), 1, len(y) - 3)
    u = np.clip(x, 0, len(y) - 1) - k
    a, b, c, d = y[k - 1], y[k], y[k + 1], y[k + 2]
    return b + u / 2 * (c - a + u * (2 * a - 5 * b + 4 * c - d + u * (3 * (b - c) + d - a)))


def _attitude(
    lab: Lab, hooks: Sequence[Physics], t: np.ndarray, past: Past
) -> tuple[np.ndarray, np.ndarray]:
    """R_wb and position of the sensors in the world. t: (n,) -> (n, 3, 3), (n, 3)."""
    angles = past.angles(lab.track, t)
    true = angles - sum(h.readout(past, t) for h in hooks if h.readout)
    R, p = np.broadcast_to(np.eye(3), (len(t), 3, 3)), np.zeros((len(t), 3))
    for h in hooks:
        if h.base:
            R = R @ by_vector(h.base(past, t))
    for k, axis in enumerate(lab.axes):
        for h in hooks:
            if h.axis_tilt and (psi := h.axis_tilt(past, k, true[:, k])) is not None:
                R = R @ by_vector(psi)
        R = R @ about(axis, true[:, k])
        for h in hooks:
            R = R @ by_vector(h.between(k)) if h.between else R
            p = p + R @ h.offset(k) if h.offset else p
    R = R @ np.array(lab.mount)
    for h in hooks:
        R = R @ by_vector(h.mount(past, t, R[:, 2, :])) if h.mount else R
    lever = lab.lever + sum(h.lever() for h in hooks if h.lever)
    return R, p + R @ lever


def felt(lab: Lab, hooks: Sequence[Physics], t: np.ndarray, past: Past) -> State:
    """Specific force and rate at the sensors, with Earth's rate."""
    (Ra, pa), (R, p), (Rb, pb) = (_attitude(lab, hooks, t + step, past) for step in (-H, 0.0, H))
    a = (pb - 2 * p + pa) / H**2 + sum(h.shake(past, t) for h in hooks if h.shake)
    f = _into_body(R, a + np.array([0.0, 0.0, lab.gravity]))
    earth = EARTH_RATE * np.array(
        [0.0, np.cos(np.deg2rad(lab.latitude)), np.sin(np.deg2rad(lab.latitude))]
    )
    turn = unskew(np.swapaxes(R, 1, 2) @ (Rb - Ra)) / (2 * H)
    dw = unskew(np.swapaxes(R, 1, 2) @ (Rb - 2 * R + Ra)) / H**2
    return State(
        t, past.angles(lab.track, t), f, turn + _into_body(R, earth), dw, lab.room.at(t), R
    )


def _into_body(R: np.ndarray, v: np.ndarray) -> np.ndarray:
    return np.einsum("nij,ni->nj", R, np.broadcast_to(v, (len(R), 3)))


def truth_of(lab: Lab, s: int, state: State) -> np.ndarray:
    """What a faultless sensor would sense: (n, axes)."""
    sensor = lab.sensors[s]
    if sensor.kind == "fog":
        return (state.w @ sensor.input_axis)[:, None]
    return state.w if sensor.kind == "gyro" else state.f[:, : len(sensor.axes)]


def readings(
    lab: Lab, hooks: Sequence[Physics], t: np.ndarray, past: Past, state: State | None = None
) -> np.ndarray:
    """Noise-free readings in SI of all channels: (n, channels). ``state``: what is felt, where it
    is known already.
    """
    t_signal = t
    for h in hooks:
        t_signal = h.stamps(t_signal) if h.stamps else t_signal
    if not any(h.delay or h.lag for h in hooks):
        state = state if state is not None and t_signal is t else felt(lab, hooks, t_signal, past)
        return np.hstack([_reading(lab, hooks, s, state, past) for s in range(len(lab.sensors))])
    return np.hstack([_late(lab, hooks, s, t_signal, past) for s in range(len(lab.sensors))])


def _late(lab: Lab, hooks: Sequence[Physics], s: int, t: np.ndarray, past: Past) -> np.ndarray:
    """One sensor behind pure delays of its channels and a first-order lag."""
    sensor = lab.sensors[s]
    delay = sum(
        (
            np.broadcast_to(h.delay().get(sensor.name, 0.0), len(sensor.axes))
            for h in hooks
            if h.delay
        ),
        np.zeros(len(sensor.axes)),
    )
    tau = sum(h.lag().get(sensor.name, 0.0) for h in hooks if h.lag)
    nodes = list(zip(LAG_U * tau, LAG_W, strict=True)) if tau else [(0.0, 1.0)]
    out = np.zeros((len(t), len(sensor.axes)))
    for later in np.unique(delay):
        here = delay == later
        for u, weight in nodes:
            state = felt(lab, hooks, t - later - u, past)
            out[:, here] += weight * _reading(lab, hooks, s, state, past)[:, here]
    return out


def _reading(lab: Lab, hooks: Sequence[Physics], s: int, state: State, past: Past) -> np.ndarray:
    """One sensor's reading of a state: linear model, additive physics, then the electronics."""
    sensor = lab.sensors[s]
    y = truth_of(lab, s, state) @ sensor.M.T + sensor.b
    for h in hooks:
        if h.sense:
            y = y + h.sense(past, state).get(sensor.name, 0.0)
    for h in hooks:
        if h.shape:
            y = h.shape(past, state, sensor, y)
    return np.arcsin(np.clip(y / lab.gravity, -1, 1)) if sensor.kind == "inclinometer" else y
