"""Prescribed motion through MuJoCo: exact readings on all threads.

Every joint gets an inertia of 1e15 and the force 1e15 x qacc, so that ``mj_forward`` returns the
prescribed acceleration and its accelerometer the exact specific force (a plain ``mj_forward`` lets
the gimbals fall). MuJoCo's world is the Earth-fixed laboratory; Earth's rate and the Coriolis
acceleration are added in the body frame afterwards.
"""

from collections.abc import Callable, Iterator, Sequence

import mujoco
import mujoco.batch
import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.effects.base import AngleEffect, Effect, FrameEffect
from tiltcal.effects.mechanisms import Spring, World
from tiltcal.effects.streams import Streams, no_streams
from tiltcal.forward.kinematics import true_angles, world_of
from tiltcal.setup.loads import load_jet
from tiltcal.setup.setup import Setup
from tiltcal.setup.trajectory import Drive, Motion, sampled_jet
from tiltsim.rig import ARMATURE, Rig, RigBuilder

BLOCK = 4096  # states of a batch: 20 MiB
Progress = Callable[[int, int], None]


def mujoco_motion(
    setup: Setup,
    drive: Drive,
    effects: Sequence[Effect] = (),
    streams: Streams = no_streams,
) -> Motion:
    """The motion of the instrument by MuJoCo's mechanics; the same arguments as
    ``kinematics.closed_form``.
    """
    world = world_of(setup, effects)
    starts = [row for row, _ in drive.mounts] + [len(drive.time)]
    parts = []
    for (first, mount), last in zip(drive.mounts, starts[1:], strict=True):
        if last > first:
            parts.append(
                _one_mounting(setup, drive, effects, streams, world, mount, slice(first, last))
            )
    return Motion(drive.time, *(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def _one_mounting(
    setup: Setup,
    drive: Drive,
    effects: Sequence[Effect],
    streams: Streams,
    world: World,
    mount: Array,
    rows: slice,
) -> tuple[Array, ...]:
    movers = [
        e
        for e in effects
        if isinstance(e, AngleEffect | FrameEffect) and e.address not in drive.realised
    ]
    springs = [e for e in movers if e.mechanised and _has_spring(e, setup)]
    standstill = [e for e in effects if e not in springs]
    angles = true_angles(setup, drive, standstill, streams)
    builder = RigBuilder(setup, world, mount)
    builder.install_shakes(drive)
    builder.install_frames(standstill, drive, angles, streams)
    builder.install_offsets(standstill)
    builder.install_mechanisms([m for e in springs for m in e.mechanisms(setup.rig, world.gravity)])
    builder.prescribed.update(angles)
    for name, deflection in drive.structure.items():
        if name in builder.springs:
            builder.prescribed[name] = deflection
            del builder.springs[name]
    rig = builder.compile()
    return read_states(rig, *joint_states(rig, drive, rows), world, drive.time[rows])


def _has_spring(effect: AngleEffect | FrameEffect, setup: Setup) -> bool:
    return any(isinstance(m, Spring) for m in effect.mechanisms(setup.rig, setup.site.gravity))


def joint_states(rig: Rig, drive: Drive, rows: slice) -> tuple[Array, Array, Array]:
    """qpos (n, nq), qvel (n, nv), qacc (n, nv) of the prescribed joints."""
    n = len(drive.time[rows])
    q, v, a = np.zeros((n, rig.model.nq)), np.zeros((n, rig.model.nv)), np.zeros((n, rig.model.nv))
    for name, jet in rig.prescribed.items():
        i = rig.dof(name)
        for target, part in ((q, jet.x), (v, jet.v), (a, jet.a)):
            target[:, i] = np.asarray(part)[rows] if np.ndim(part) else part
    if rig.free and drive.attitude is not None:
        from scipy.spatial.transform import Rotation

        xyzw = Rotation.from_matrix(drive.attitude.R_wb[rows]).as_quat()
        q[:, :3] = rig.model.body("hand").pos
        q[:, 3:7] = xyzw[:, [3, 0, 1, 2]]
        v[:, 3:6], a[:, 3:6] = drive.attitude.rate[rows], drive.attitude.acceleration[rows]
    return q, v, a


def read_states(
    rig: Rig, q: Array, v: Array, a: Array, world: World, time: Array
) -> tuple[Array, ...]:
    """Force, rate, up, north and angular acceleration in the body frame at given joint states, (n,
    3) each.

    States that repeat (a dwell) are computed once.

    Args:
        rig: the rig.
        q, v, a: rad, rad/s and rad/s2, (n, joints).
        world: site of the rig.
        time: s, (n,).
    """
    new = np.ones(len(q), bool)
    new[1:] = (
        (np.diff(q, axis=0) != 0).any(axis=1)
        | (np.diff(v, axis=0) != 0).any(axis=1)
        | (np.diff(a, axis=0) != 0).any(axis=1)
    )
    if rig.springs:  # the rate of a deflection reaches two rows into a dwell
        new = np.convolve(new, np.ones(5), "same")[: len(new)] > 0
        new[0] = True
    first = np.flatnonzero(new)
    which = np.cumsum(new) - 1
    if len(first) < len(q):
        q, v, a = q[first], v[first], a[first]
    runner = _Runner(rig, len(first))
    correction = _settle(rig, runner, q, v, a, which, first, time) if rig.springs else None
    found = tuple(np.empty((len(q), 3)) for _ in range(5))
    for part, data in runner.blocks(q, v, a, correction, "sensordata"):
        for target, values in zip(found, _body_frame(rig, data, world), strict=True):
            target[part] = values
    return found if len(first) == len(new) else tuple(values[which] for values in found)


class _Runner:
    """A batch of states on all threads, block by block."""

    def __init__(self, rig: Rig, n: int) -> None:
        self.rig = rig
        self.size = min(BLOCK, max(n, 1))
        try:
            self.batch = mujoco.batch.Batch(rig.model, self.size)
            self.fields = {name: self.batch.bind(name) for name in ("qpos", "qvel", "qfrc_applied")}
        except mujoco.FatalError as error:  # MuJoCo's only fatal error here: no memory
            raise MemoryError(str(error)) from error

    def blocks(
        self, q: Array, v: Array, a: Array, correction: Array | None, output: str
    ) -> Iterator[tuple[slice, Array]]:
        """An output field of mj_forward at each state, as (rows, values); the values are valid
        until the next block.
        """
        bound = self.batch.bind(output)
        for i in range(0, len(q), self.size):
            part = slice(i, min(i + self.size, len(q)))
            k = part.stop - part.start
            self.fields["qpos"][:k], self.fields["qvel"][:k] = q[part], v[part]
            np.multiply(a[part], ARMATURE, out=self.fields["qfrc_applied"][:k])
            if correction is not None:
                self.fields["qfrc_applied"][:k] += correction[part]
            self.batch.forward(None if k == self.size else np.arange(k))
            yield part, bound[:k]

    def load(self, q: Array, v: Array, a: Array, dofs: Sequence[int]) -> Array:
        """Torque of weight and inertia on some joints, N m, (n, dofs): the wrench that their bodies
        pass on, along their axes. The accelerometer asks MuJoCo for it.
        """
        model, axes = self.rig.model, self.batch.bind("cdof")
        bodies = model.dof_bodyid[list(dofs)]
        found = np.empty((len(q), len(dofs)))
        for part, wrench in self.blocks(q, v, a, None, "cfrc_int"):
            by_body = wrench.reshape(len(wrench), -1, 6)[:, bodies]
            along = axes[: len(wrench)].reshape(len(wrench), -1, 6)[:, list(dofs)]
            found[part] = -(by_body * along).sum(axis=2)
        return found

    def still(self, q: Array, v: Array, output: str) -> Array:
        """An output field at each state with no acceleration prescribed."""
        return np.concatenate(
            [data.copy() for _, data in self.blocks(q, v, np.zeros_like(v), None, output)]
        )


def _settle(
    rig: Rig,
    runner: _Runner,
    q: Array,
    v: Array,
    a: Array,
    which: "np.ndarray[tuple[int], np.dtype[np.intp]]",
    first: "np.ndarray[tuple[int], np.dtype[np.intp]]",
    time: Array,
) -> Array:
    """Move the compliant joints to equilibrium: k (q - q_relaxed) = torque of their load, by fixed
    point (contracts by m g l / k).

    Returns the generalised force that keeps everything else still.
    """
    dofs = [rig.dof(name) for name in rig.springs]
    positions = [rig.position(name) for name in rig.springs]
    stiffness = np.array(list(rig.springs.values()))
    relaxed = rig.model.qpos_spring[positions]
    for _ in range(5):
        weight = -runner.still(q, np.zeros_like(v), "qfrc_bias")[:, dofs]
        load = weight
        if rig.inertial:  # to the last digit the weight where nothing moves
            moving = (v != 0).any(axis=1) | (a != 0).any(axis=1)
            load = np.where(moving[:, None], runner.load(q, v, a, dofs), weight)
        q[:, positions] = relaxed + load / stiffness
    if np.any(v):
        # a deflection that changes turns the instrument: its rate, from the load against time
        other = load
        if rig.inertial:
            other = runner.load(q, v, _second_differences(rig, q, a, which, first, time), dofs)
        for k, dof in enumerate(dofs):
            parts = (weight[:, k], (load - weight)[:, k], (load - other)[:, k])
            jet = load_jet(time, *(part[which] for part in parts)).scaled(1 / stiffness[k])
            v[:, dof], a[:, dof] = np.asarray(jet.v)[first], np.asarray(jet.a)[first]
    return runner.still(q, v, "qfrc_bias") - runner.still(q, v, "qfrc_passive")


def _second_differences(
    rig: Rig,
    q: Array,
    a: Array,
    which: "np.ndarray[tuple[int], np.dtype[np.intp]]",
    first: "np.ndarray[tuple[int], np.dtype[np.intp]]",
    time: Array,
) -> Array:
    """Accelerations by the angles alone, (n, nv), where there are any."""
    found = a.copy()
    for dof in np.flatnonzero(a.any(axis=0)):
        position = rig.model.jnt_qposadr[rig.model.dof_jntid[dof]]
        found[:, dof] = np.asarray(sampled_jet(time, q[which, position]).a)[first]
    return found


def _body_frame(rig: Rig, data: Array, world: World) -> tuple[Array, ...]:
    """Sensor data to force, rate, up, north, angular acceleration; adds Earth's rate and
    Coriolis.
    """

    def sensor(name: str) -> Array:
        s = rig.model.sensor(name)
        return data[:, s.adr[0] : s.adr[0] + s.dim[0]]

    force, rate = sensor("accel").copy(), sensor("gyro").copy()
    to_body = _Rotations(sensor("attitude"))
    up = to_body.of(np.array([0.0, 0.0, 1.0]))
    if np.any(world.earth):
        rate += to_body.of(world.earth)
    if np.any(world.coriolis) and rig.displaced:
        earth = to_body.of(world.coriolis)
        position = to_body.of(sensor("place") - rig.centre)
        force += 2 * np.cross(earth, sensor("speed")) + np.cross(earth, np.cross(earth, position))
    return force, rate, up, to_body.of(np.array([0.0, 1.0, 0.0])), to_body.of(sensor("spin"))


class _Rotations:
    """Rotations world to body from quaternions (w, x, y, z), (n, 4)."""

    def __init__(self, quaternion: Array) -> None:
        w, x, y, z = quaternion.T
        self.rows = np.empty((3, len(w), 3))  # rows of R_wb: R_bw v = sum_i v_i row_i
        self.rows[0] = np.column_stack(
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]
        )
        self.rows[1] = np.column_stack(
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]
        )
        self.rows[2] = np.column_stack(
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]
        )

    def of(self, v: Array) -> Array:
        """Body components of world vectors: one, (3,), or one a row, (n, 3)."""
        if v.ndim == 1:
            total = np.zeros_like(self.rows[0])
            for value, row in zip(v, self.rows, strict=True):
                if value:
                    total += value * row
            return total
        return np.einsum("ni,inj->nj", v, self.rows)
