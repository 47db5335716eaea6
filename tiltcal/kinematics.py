"""Closed form of the tables: angles -> specific force, rate and up in the body frame.

An outward recursion through the chain base - bearing - axis - ... - mount. Each vector is carried in the frame of the
current link; a hinge about a coordinate axis mixes two of its components. With q, v, a of the hinge and e its axis,
u' = R(e, q)^T u,   w' = w + e v,   dw' = dw + e a + w x e v;   the proper acceleration of the common point starts as
(0, 0, g) plus the base's own, and a lever arm r adds dw x r + w x (w x r).  Source: any text on the recursive
Newton-Euler method; checked against MuJoCo over all tables in tests/test_kinematics.py.
"""

from collections.abc import Sequence

import numpy as np

from tiltcal.effects.base import AngleEffect, Effect, FrameEffect, LinkEffect, Streams, WorldEffect, no_streams
from tiltcal.effects.mechanisms import Context, Turn, World
from tiltcal.frames import Array
from tiltcal.motion import Drive, Jet, Motion
from tiltcal.setup import Setup

Vector = list[Array]


def true_angles(
    setup: Setup,
    drive: Drive,
    effects: Sequence[Effect],
    streams: Streams = no_streams,
) -> dict[str, Jet]:
    """True angles of the table's axes: the readout plus every AngleEffect's deviation. streams: their random numbers."""
    angles = {name: jet + drive.structure[name] if name in drive.structure else jet for name, jet in drive.axes.items()}
    for effect in effects:
        if isinstance(effect, AngleEffect) and effect.id not in drive.realised:
            for name in setup.rig.axis_names:
                if effect.acts_on(name, setup.rig):
                    angles[name] = angles[name] + effect.deviation(drive, name, streams(effect))
    return angles


def world_of(setup: Setup, effects: Sequence[Effect]) -> World:
    """The nominal world with every WorldEffect in it."""
    world = World.of(setup)
    for effect in effects:
        if isinstance(effect, WorldEffect):
            world = effect.world(world)
    return world


def closed_form(
    setup: Setup,
    drive: Drive,
    effects: Sequence[Effect] = (),
    streams: Streams = no_streams,
) -> Motion:
    """The motion of the instrument by algebra.

    Args:
        setup: site, rig, sensors.
        drive: the readout.
        effects: what differs from the nominal table, mounting and world.
        streams: random numbers of effects that need them.
    """
    world = world_of(setup, effects)
    angles = true_angles(setup, drive, effects, streams)
    frames = [e for e in effects if isinstance(e, FrameEffect)]
    link = _Link(world, drive)

    def slot(name: str) -> None:
        for effect in frames:
            context = Context(drive, angles, setup.rig, world.gravity, np.column_stack(link.force), streams(effect))
            for turn in effect.turns(name, context):
                link.turn(turn)

    slot("base")
    for name, axis in setup.rig.axes:
        link.offset(link_offset(setup, effects, f"{name}_bearing"))
        slot(f"{name}_bearing")
        link.turn(Turn(axis, angles[name]))
    if drive.attitude is not None:
        link.take(drive.attitude.R_wb, drive.attitude.rate, drive.attitude.acceleration)
    link.mount(drive)
    slot("mount")
    return link.motion(world)


def link_offset(setup: Setup, effects: Sequence[Effect], slot: str) -> Array:
    """Displacement of the frame behind a slot by all LinkEffects, m, (3,)."""
    return sum((e.offset(slot, setup.rig) for e in effects if isinstance(e, LinkEffect)), np.zeros(3))


class _Link:
    """The vectors carried outward, each a list of three arrays of shape (n,)."""

    def __init__(self, world: World, drive: Drive) -> None:
        n = len(drive.time)
        self.time = drive.time
        one = np.ones(n)
        self.force: Vector = [np.zeros(n), np.zeros(n), world.gravity * one]
        self.speed: Vector = [np.zeros(n) for _ in range(3)]
        self.place: Vector = [np.zeros(n) for _ in range(3)]  # from where the axes' common point rests
        for shake in world.shakes:
            for i, jet in enumerate(shake.jets(drive.elapsed)):
                self.force[i] = self.force[i] + jet.a
                self.speed[i] = self.speed[i] + jet.v
                self.place[i] = self.place[i] + jet.x
        self.rate: Vector = [np.zeros(n) for _ in range(3)]
        self.spin: Vector = [np.zeros(n) for _ in range(3)]
        self.up: Vector = [np.zeros(n), np.zeros(n), one]
        self.north: Vector = [np.zeros(n), one, np.zeros(n)]
        self.earth: Vector = [component * one for component in world.earth]
        self.coriolis: Vector = [component * one for component in world.coriolis]

    def _vectors(self) -> tuple[Vector, ...]:
        moving = (self.force, self.speed, self.rate, self.spin, self.place)
        return (*moving, self.up, self.north, self.earth, self.coriolis)

    def offset(self, r: Array) -> None:
        """Pass a displacement: the point behind it moves on with the link."""
        if not np.any(r):
            return
        rate, spin = np.column_stack(self.rate), np.column_stack(self.spin)
        for target, change in (
            (self.force, np.cross(spin, r) + np.cross(rate, np.cross(rate, r))),
            (self.speed, np.cross(rate, r)),
            (self.place, np.broadcast_to(r, rate.shape)),
        ):
            target[:] = [component + change[:, i] for i, component in enumerate(target)]

    def turn(self, turn: Turn) -> None:
        """Pass a hinge: all vectors into the frame behind it."""
        i = "xyz".index(turn.axis)
        j, k = (i + 1) % 3, (i + 2) % 3
        c, s = np.cos(turn.angle.x), np.sin(turn.angle.x)
        for u in self._vectors():
            u[j], u[k] = c * u[j] + s * u[k], c * u[k] - s * u[j]
        v = turn.angle.v
        self.spin[i] = self.spin[i] + turn.angle.a  # w x e v has components (w_k v, -w_j v) along j, k
        self.spin[j] = self.spin[j] + self.rate[k] * v
        self.spin[k] = self.spin[k] - self.rate[j] * v
        self.rate[i] = self.rate[i] + v

    def take(self, R: Array, rate: Array, acceleration: Array) -> None:
        """Pass a prescribed attitude R (n, 3, 3) of a body that turns freely."""
        self._rotate(R)
        for i in range(3):
            self.rate[i] = self.rate[i] + rate[:, i]
            self.spin[i] = self.spin[i] + acceleration[:, i]

    def mount(self, drive: Drive) -> None:
        """Pass the nominal mounting, which may change at remounts."""
        if all(np.array_equal(R, np.eye(3)) for _, R in drive.mounts):
            return
        starts = np.array([row for row, _ in drive.mounts])
        which = np.searchsorted(starts, np.arange(len(self.time)), side="right") - 1
        self._rotate(np.array([R for _, R in drive.mounts])[which])

    def _rotate(self, R: Array) -> None:
        for u in self._vectors():
            u[:] = list(np.einsum("nji,jn->in", R, np.array(u)))

    def motion(self, world: World) -> Motion:
        """Add the lever arm and Coriolis; stack."""
        self.offset(world.lever)
        force, rate, coriolis, place = (np.column_stack(v) for v in (self.force, self.rate, self.coriolis, self.place))
        if np.any(world.coriolis) and (np.any(place) or world.shakes):
            speed = np.column_stack(self.speed)
            force = force + 2 * np.cross(coriolis, speed) + np.cross(coriolis, np.cross(coriolis, place))
        up, north, spin = (np.column_stack(v) for v in (self.up, self.north, self.spin))
        return Motion(self.time, force, rate + np.column_stack(self.earth), up, north, spin)
