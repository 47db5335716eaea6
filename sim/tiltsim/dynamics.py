"""A sequence run by time steps: the servos follow with droop, lag and friction, the structure
rings.

``run_dynamics`` steps the mechanics once, keeps a log of the joints and returns it as a Course. The
readings come from the exact reader of prescribed motion (``motion.py``) at the logged states: none
is one step old.

- The log takes positions from the integrator, rates and accelerations from differences of its own
  step
  velocities (fourth order): one curve. ``qacc`` would not do: it is explicit, the servo's damping
  implicit.
- Vibration: a base that accelerates by ``a`` is, for everything on it, a gravity ``g - a``
  (equivalence
  principle): the stepping shakes gravity, exactly and without driven slides; the reader adds the
  base's own.
- Turns of effects that move (wobble, slip, thermal tilt) are tiny and load nothing: left to the
  reader.
- Springs too stiff for the time step follow at once: the reader settles them, as in prescribed
  motion; rings too
  fast for it are left to the reader's closed form.
- Effects of the drive are mechanics (``faces.py``): the algebra leaves out those in
  ``Drive.realised``.
- Memory: a row a millisecond (a step, with springs) where something accelerates, one of CHUNK where
  nothing
  does, and ROWS at most: runs beyond half an hour have wider rows.

Errors: the implicit damping c of a joint adds c dt / 2 to its inertia: a mount of 30 arcsec/g rings
2 % too low at 0.5 ms. Friction creeps by some 0.05 arcsec/s.

The log of a run by time steps: joint states at rows of their own, read between the rows by one
smooth curve.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Protocol

import mujoco
import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.core.errors import TiltcalError
from tiltcal.effects.base import Effect
from tiltcal.forward.kinematics import true_angles, world_of
from tiltcal.forward.signal_chain import stream
from tiltcal.laboratory.scenario import Scenario
from tiltcal.laboratory.scenario_tables import Dynamics
from tiltcal.setup.trajectory import Attitude, Drive, Jet
from tiltsim.actuators import Torques
from tiltsim.build import build, mechanisms_of, readout_errors, realised, resolved
from tiltsim.motion import Progress
from tiltsim.rig import Rig


@dataclass(frozen=True)
class Log:
    """States of the joints at increasing times.

    Args:
        time: s, (n,).
        x: positions as in qpos, (n, nq).
        v, a: rates and accelerations as in qvel, (n, nv).
    """

    time: Array
    x: Array
    v: Array
    a: Array

    def _between(self, time: Array) -> tuple[Index, Array, Array]:
        """Row before each time, the interval it starts, and the time into it, (m, 1)."""
        inside = np.clip(time, self.time[0], self.time[-1])
        row = np.clip(np.searchsorted(self.time, inside, side="right") - 1, 0, len(self.time) - 2)
        start = self.time[row]
        return row, (self.time[row + 1] - start)[:, None], (inside - start)[:, None]

    def joints(self, time: Array) -> Jet:
        """All joints of a table at these times: a jet of shape (m, nq)."""
        i, h, t = self._between(time)
        k = i + 1
        return _quintic(
            Jet(self.x[i], self.v[i], self.a[i]), Jet(self.x[k], self.v[k], self.a[k]), h, t
        )

    def attitude(self, time: Array) -> Attitude:
        """Attitude of a free body at these times: that of the row before, then a small rotation
        vector u.

        Its body rate is w = u' - u x u' / 2 + u x (u x u') / 6 (Bortz), so that u' = w + u x w / 2
        + ...

        Args:
            time: s, (n,).
        """
        from scipy.spatial.transform import Rotation

        i, h, t = self._between(time)
        here, there = (
            Rotation.from_quat(self.x[rows, 3:7], scalar_first=True) for rows in (i, i + 1)
        )
        w, a = self.v[:, 3:], self.a[:, 3:]
        step, rate, cross = (here.inv() * there).as_rotvec(), w[i + 1], np.cross
        du = rate + cross(step, rate) / 2 + cross(step, cross(step, rate)) / 12
        end = Jet(step, du, a[i + 1] + (cross(du, rate) + cross(step, a[i + 1])) / 2)
        u = _quintic(Jet(np.zeros_like(step), w[i], a[i]), end, h, t)
        swing, push = cross(u.x, u.v), cross(u.x, u.a)
        return Attitude(
            (here * Rotation.from_rotvec(np.asarray(u.x))).as_matrix(),
            u.v - swing / 2 + cross(u.x, swing) / 6,
            u.a - push / 2 + (cross(u.v, swing) + cross(u.x, push)) / 6,
        )


def _quintic(start: Jet, end: Jet, h: Array, t: Array) -> Jet:
    """The quintic through two jets (m, j) that are h (m, 1) apart, at t (m, 1): itself a jet."""
    d = (end.x - start.x) - h * (start.v + h / 2 * start.a)
    e, f = h * (end.v - start.v - h * start.a), h * h * (end.a - start.a)
    c3, c4, c5 = 10 * d - 4 * e + f / 2, -15 * d + 7 * e - f, 6 * d - 3 * e + f / 2
    s = t / h
    return Jet(
        start.x + t * (start.v + t / 2 * start.a) + s**3 * (c3 + s * (c4 + s * c5)),
        start.v + t * start.a + s**2 / h * (3 * c3 + s * (4 * c4 + s * 5 * c5)),
        start.a + s / h**2 * (6 * c3 + s * (12 * c4 + s * 20 * c5)),
    )


PREROLL = 1.0  # s before the start, in which the start-up transient dies
SPACING = 1e-3  # s, of the log's rows
BLOCK = 4096  # steps planned and logged at once
ROWS = 2_000_000  # of a log, at most: 0.2 GB with four joints
CHUNK = 64  # rows of which one is kept when nothing accelerates
QUIET = 1e-7  # rad/s2
HAND = 2 * np.pi * 5.0  # rad/s, natural frequency of a hand with an instrument
TREMOR = 3.0  # Hz, corner of a hand's irregular torque


def run_dynamics(
    scenario: Scenario, seed: int | None, progress: Progress | None = None
) -> "DynamicCourse":
    """Run a scenario's sequence by time steps.

    Args:
        scenario: with ``[dynamics]`` (its defaults when it has none).
        seed: of the hand's irregular torque; None: a hand without it.
        progress: called with (steps done, steps in all).

    Raises:
        TiltcalError: the run diverges, or the sequence does not fit the table.
    """
    effects = [e for e in scenario.effects if not e.is_identity]
    driver: Driver
    if not scenario.rig.axes:
        driver = _Hand(scenario, effects, seed)
    else:
        driver = Servos(scenario, effects)
    with unprinted_warnings():
        log = _march(scenario, driver, progress)
    model = driver.rig.model
    columns = {model.joint(i).name: int(model.jnt_dofadr[i]) for i in range(model.njnt)}
    return DynamicCourse(scenario, log, columns, driver.realised)


@contextmanager
def unprinted_warnings() -> Iterator[None]:
    """MuJoCo does not print that a run diverges: it is refused in one message."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


@dataclass(frozen=True)
class DynamicCourse:
    """What the table did in a run by time steps: a Course.

    Args:
        scenario: that was run.
        log: of its joints.
        columns: joint name -> column of the log.
        realised: addresses of the effects that the log includes.
    """

    scenario: Scenario
    log: Log
    columns: Mapping[str, int]
    realised: tuple[str, ...] = ()

    @property
    def times(self) -> tuple[float, float]:
        """First and last instant of the sequence, s."""
        return self.scenario.schedule.times

    def drive(self, time: Array) -> Drive:
        """Readout, structure and (hand-held) attitude at these times, (n,). time: s."""
        asked = self.scenario.schedule.drive(time)
        if not self.scenario.rig.axes:
            return replace(asked, attitude=self.log.attitude(time))
        return observed(self.scenario, asked, self.log.joints(time), self.columns, self.realised)


def observed(
    scenario: Scenario,
    asked: Drive,
    states: Jet,
    columns: Mapping[str, int],
    realised: tuple[str, ...],
) -> Drive:
    """What encoders and structure do in joint states.

    Args:
        scenario: whose encoders err.
        asked: of the motors, and deviations of axes from their encoders that mechanics do not hold.
        states: of the joints, at the times of ``asked``, (n, joints).
        columns: joint name -> column of the states.
        realised: addresses of the effects that the states include.
    """
    parts = [np.asarray(part) for part in (states.x, states.v, states.a)]
    joints = {name: Jet(*(part[:, i] for part in parts)) for name, i in columns.items()}
    motors = {name: joints.pop(name) for name in asked.axes}
    # of the encoders: play, structure that rings about the axis, and what was asked
    beyond = dict(asked.structure)
    for name, axis in scenario.rig.axes:
        for joint in (f"{name}_gap", f"{name}_ring_{axis}"):
            if joint in joints:
                beyond[name] = joints.pop(joint) + beyond.get(name, Jet(0.0))
    errors = readout_errors(scenario.effects)
    if scenario.rig.readout == "command":
        goals = true_angles(scenario, replace(asked, structure={}), errors)
        errors_of_motors = {name: motors[name] - goals[name] for name in motors}
        beyond = {n: off + beyond.get(n, Jet(0.0)) for n, off in errors_of_motors.items()}
        structure = joints | beyond
        return replace(
            asked, structure=structure, following_error=errors_of_motors, realised=realised
        )
    axes = _readout(scenario, replace(asked, structure={}), motors, errors)
    return replace(asked, axes=axes, structure=joints | beyond, realised=realised)


def _readout(
    scenario: Scenario, asked: Drive, true: Mapping[str, Jet], errors: Sequence[Effect]
) -> dict[str, Jet]:
    """Readout of the encoders at true angles: a fixed point contracts by the errors'
    slope, < 1e-2.
    """
    readout = dict(true)
    for _ in range(6 if errors else 0):
        found = true_angles(scenario, replace(asked, axes=readout), errors)
        readout = {name: readout[name] + (true[name] - found[name]) for name in true}
    return readout


class Driver(Protocol):
    """What pushes the joints: planned a block of steps ahead, applied step by step."""

    rig: Rig
    data: mujoco.MjData
    spacing: float
    realised: tuple[str, ...]

    def plan(self, time: Array) -> None:
        """Work out what to do at the instants of the next steps. time: s, (n,)."""

    def push(self, k: int) -> None:
        """Apply it before step ``k`` of the block."""


def _march(scenario: Scenario, driver: Driver, progress: Progress | None) -> Log:
    """Step from PREROLL before the start of the sequence to its end."""
    dt = float(driver.rig.model.opt.timestep)
    start, end = scenario.schedule.times
    before = round(PREROLL / dt)
    steps = before + int(np.ceil((end - start) / dt))
    stride = max(1, int(driver.spacing / dt + 1e-9), -(-steps // ROWS))
    steps += stride + 4
    recorder = Recorder(stride)
    for first in range(0, steps, BLOCK):
        n = min(BLOCK, steps - first)
        time: Array = start + dt * np.arange(first - before, first - before + n, dtype=float)
        recorder.add(time, *stepped(scenario, driver, time), dt)
        if progress is not None:
            progress(first + n, steps)
    return recorder.log()


def stepped(scenario: Scenario, driver: Driver, time: Array) -> tuple[Array, Array]:
    """Step at these instants, s, (n,): positions before each step, (n, nq), and velocities, (n,
    nv).

    Raises:
        TiltcalError: the run diverges.
    """
    model, data = driver.rig.model, driver.data
    step, qpos, qvel, push = mujoco.mj_step, data.qpos, data.qvel, driver.push
    driver.plan(time)
    x, u = np.empty((len(time), model.nq)), np.empty((len(time), model.nv))
    for k in range(len(time)):
        push(k)
        x[k], u[k] = qpos, qvel
        step(model, data)
    if not (np.isfinite(x).all() and np.isfinite(u).all()):
        raise TiltcalError(
            f"scenario {scenario.name}",
            found=f"a motion that diverges before {time[-1]:.4g} s",
            need="a stable run by time steps",
            do="lower dynamics.timestep_s, or the servo's stiffness",
        )
    return x, u


class Recorder:
    """Turns steps into rows: rates and accelerations by differences, thinned where nothing
    accelerates.
    """

    def __init__(self, stride: int) -> None:
        self.stride, self.offset = stride, 0
        self.carry: tuple[Array, Array, Array] | None = None
        self.parts: list[tuple[Array, Array, Array, Array]] = []

    def add(self, time: Array, x: Array, u: Array, dt: float) -> None:
        """Steps at these times, s, (n,), with positions (n, nq) and the velocities that led there,
        (n, nv).
        """
        if self.carry is not None:
            time, x, u = (
                np.concatenate(pair) for pair in zip(self.carry, (time, x, u), strict=True)
            )
        self.carry = time[-3:], x[-3:], u[-3:]
        u0, u1, u2, u3 = u[:-3], u[1:-2], u[2:-1], u[3:]  # two steps before and two after each row
        v, a = (7 * (u1 + u2) - u0 - u3) / 12, (15 * (u2 - u1) - (u3 - u0)) / (12 * dt)
        rows = np.arange(self.offset, len(v), self.stride)
        self.offset = (self.offset - len(v)) % self.stride
        rows = rows[_worth_keeping(a[rows])]
        self.parts.append((time[1:-2][rows], x[1:-2][rows], v[rows], a[rows]))

    def log(self) -> Log:
        """Everything kept."""
        return Log(*(np.concatenate(arrays) for arrays in zip(*self.parts, strict=True)))


def _worth_keeping(a: Array) -> "np.ndarray[tuple[int], np.dtype[np.bool_]]":
    """Rows, (n,), of chunks in which something accelerates; else the chunk's first; and the last of
    all.
    """
    group = np.arange(len(a)) // CHUNK
    keep = (
        np.bincount(group, (np.abs(a) > QUIET).any(axis=1))[group] > 0
        if len(a)
        else np.zeros(0, bool)
    )
    keep[::CHUNK] = True
    keep[-1:] = True
    return np.asarray(keep)


class Servos:
    """The servos of a table, the shaking of its base, and the operator who remounts."""

    def __init__(self, scenario: Scenario, effects: Sequence[Effect]) -> None:
        self.scenario, self.schedule = scenario, scenario.schedule
        self.asked: Callable[[Array], Drive] = self.schedule.drive
        self.errors = readout_errors(effects)
        self.world = world_of(scenario, effects)
        mechanisms = resolved(scenario, effects, mechanisms_of(scenario, effects))
        self.realised = realised(scenario, effects, mechanisms)
        texts = list(dict.fromkeys(leg.mount for leg in self.schedule.legs))
        rigs = {text: build(scenario, effects, mechanisms, text) for text in texts}
        self.rig = rigs[texts[0]]
        self.mounts = {text: rig.model.body("mount").quat.copy() for text, rig in rigs.items()}
        self.spacing = 0.0 if self.rig.springs or self.rig.rings else SPACING
        self.data = mujoco.MjData(self.rig.model)
        self.names = [self.rig.model.actuator(i).name for i in range(self.rig.model.nu)]
        self._balance()
        self.torques = Torques(
            self.rig.model, self.data, self.schedule, self.rig.rings, self.rig.coggings
        )

    def _goal(self, time: Array) -> Array:
        """Angles asked of the motors, rad, (n, axes): loops are closed on the encoders, errors and
        all.
        """
        goals = true_angles(self.scenario, self.asked(time), self.errors)
        return np.column_stack([np.asarray(goals[name].x) for name in self.names])

    def _balance(self) -> None:
        """Start in equilibrium: servos and springs carry the weight. A fixed point contracts by m g
        l / k.
        """
        model, data, rig = self.rig.model, self.data, self.rig
        goal = self._goal(np.array(self.schedule.times[:1]))[0]
        axes, springs = (
            [rig.dof(name) for name in self.names],
            [rig.dof(name) for name in rig.springs],
        )
        data.qpos[axes] = goal
        for _ in range(6):
            mujoco.mj_forward(model, data)
            data.qpos[axes] = (
                goal - (data.qfrc_bias - data.qfrc_passive)[axes] / model.actuator_gainprm[:, 0]
            )
            data.qpos[springs] = -data.qfrc_bias[springs] / np.array(list(rig.springs.values()))

    def plan(self, time: Array) -> None:
        """Commands, gravity in the shaken base's frame, remounts. time: s, (n,)."""
        self.goal, self.ctrl = self._goal(time), self.data.ctrl
        self.torques.plan(time)
        self.gravity: Array | None = None
        if self.world.shakes:
            self.gravity = np.tile([0.0, 0.0, -self.world.gravity], (len(time), 1))
            for shake in self.world.shakes:
                self.gravity -= np.column_stack(
                    [jet.a for jet in shake.jets(time - self.schedule.times[0])]
                )
        self.remounts = dict(self.schedule.mountings(time)) if len(self.mounts) > 1 else {}

    def push(self, k: int) -> None:
        """Set the command; after a remount the mount's springs start from where they were, and
        ring.
        """
        self.ctrl[:] = self.goal[k]
        self.torques.push(k)
        if self.gravity is not None:
            self.rig.model.opt.gravity = self.gravity[k]
        if k in self.remounts:
            self.rig.model.body("mount").quat = self.mounts[self.remounts[k]]


class _Hand:
    """A hand: spring and damper toward the wanted attitude, irregular torque on the way."""

    spacing = SPACING
    realised: tuple[str, ...] = ()

    def __init__(self, scenario: Scenario, effects: Sequence[Effect], seed: int | None) -> None:
        dynamics = scenario.dynamics or Dynamics()
        self.schedule = scenario.schedule
        self.rig = build(scenario, effects, (), scenario.rig.mount)
        self.data = mujoco.MjData(self.rig.model)
        inertia = float(np.mean(self.rig.model.dof_M0[3:6]))
        self.stiffness = dynamics.stiffness_N_m_rad or inertia * HAND**2
        critical = 2 * np.sqrt(self.stiffness * inertia)
        self.damping = (
            critical if dynamics.damping_N_m_s_rad is None else dynamics.damping_N_m_s_rad
        )
        self.torque = dynamics.hand_torque_N_m
        self.rng = None if seed is None else stream(seed, "hand")
        self.tremor = _Tremor(float(self.rig.model.opt.timestep))
        self.quat, self.spin = self.data.qpos[3:7], self.data.qvel[3:6]
        self.force = self.data.qfrc_applied[3:6]
        self.error = np.zeros(3)
        self.plan(np.array(self.schedule.times[:1]))
        self.quat[:] = self.wanted[0]

    def plan(self, time: Array) -> None:
        """Wanted attitudes (w, x, y, z), (n, 4), and the torque that does not depend on the state,
        (n, 3).
        """
        from scipy.spatial.transform import Rotation

        attitude = self.schedule.drive(time).attitude
        assert attitude is not None
        self.wanted = Rotation.from_matrix(attitude.R_wb).as_quat(scalar_first=True)
        self.known = self.damping * attitude.rate
        if self.rng is not None and len(time) > 1:
            effort = self.torque * self._effort(time, attitude)[:, None]
            self.known = self.known + effort * self.tremor.draw(self.rng, len(time))

    def _effort(self, time: Array, attitude: Attitude) -> Array:
        """Rate as a share of its leg's highest, (n,): 0 at standstill, so that nothing
        moves there.
        """
        moves = [e if e.profile == "ramp" else None for e in self.schedule.legs]
        peaks = np.array(
            [1.0 if e is None else np.linalg.norm(e.dq) / (e.t1 - e.t0 - e.ramp) for e in moves]
        )
        return np.asarray(np.linalg.norm(attitude.rate, axis=1) / peaks[self.schedule.leg_of(time)])

    def push(self, k: int) -> None:
        """Torque in the body frame: stiffness x turn to go + damping x rate to gain + irregular
        part.
        """
        mujoco.mju_subQuat(self.error, self.wanted[k], self.quat)
        self.force[:] = self.stiffness * self.error + self.known[k] - self.damping * self.spin


class _Tremor:
    """White noise through two equal first-order lags of corner TREMOR, rms 1: H ~ 1 / (1 - p
    z^-1)^2.
    """

    def __init__(self, dt: float) -> None:
        p = float(np.exp(-2 * np.pi * TREMOR * dt))
        power = (1 + p * p) / (1 - p * p) ** 3  # sum of the squared impulse response (n + 1) p^n
        self.b, self.a = [1 / np.sqrt(power)], [1.0, -2 * p, p * p]
        self.state = np.zeros((2, 3))

    def draw(self, rng: np.random.Generator, n: int) -> Array:
        """The next n samples about three axes, (n, 3)."""
        from scipy.signal import lfilter

        noise, self.state = lfilter(self.b, self.a, rng.normal(size=(n, 3)), axis=0, zi=self.state)
        return np.asarray(noise)
