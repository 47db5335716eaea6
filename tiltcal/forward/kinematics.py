"""Closed form of the tables: angles -> specific force, rate and up in the body frame.

An outward recursion through the chain base - bearing - axis - ... - mount. Each vector is carried
in the frame of the
current link; a hinge about a coordinate axis mixes two of its components. With q, v, a of the hinge
and e its axis,
u' = R(e, q)^T u,   w' = w + e v,   dw' = dw + e a + w x e v;   the proper acceleration of the
common point starts as
(0, 0, g) plus the base's own, and a lever arm r adds dw x r + w x (w x r); a slide is the lever arm
r = e q that grows, and adds e a + 2 w x e v.  Source: any text on the recursive
Newton-Euler method; checked against MuJoCo over all tables in tests/test_kinematics.py.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.effects.base import AngleEffect, Effect, FrameEffect, LinkEffect, WorldEffect
from tiltcal.effects.learned import LearnedTilt
from tiltcal.effects.loads import masses_of
from tiltcal.effects.mechanisms import Context, Ring, Turn, World
from tiltcal.effects.streams import Streams, no_streams
from tiltcal.setup.chain import LinkFrame
from tiltcal.setup.setup import Setup
from tiltcal.setup.tables import bearing
from tiltcal.setup.trajectory import Drive, Jet, Motion

Vector = list[Array]


def true_angles(
    setup: Setup,
    drive: Drive,
    effects: Sequence[Effect],
    streams: Streams = no_streams,
) -> dict[str, Jet]:
    """True angles of the table's axes: the readout plus every AngleEffect's deviation.

    Args:
        setup: site, table and sensors.
        drive: motion of the axes.
        effects: effects that act.
        streams: their random numbers.
    """
    angles = {
        name: jet + drive.structure[name] if name in drive.structure else jet
        for name, jet in drive.axes.items()
    }
    for effect in effects:
        if isinstance(effect, AngleEffect) and effect.address not in drive.realised:
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
    setup: Setup, drive: Drive, effects: Sequence[Effect] = (), streams: Streams = no_streams
) -> Motion:
    """The motion of the instrument by algebra.

    Args:
        setup: site, rig, sensors.
        drive: the readout.
        effects: what differs from the nominal table, mounting and world.
        streams: random numbers of effects that need them.
    """
    world = world_of(setup, effects)
    link = _carried(
        setup, drive, effects, streams, _Link(world, drive, _displaced(setup, world, effects))
    )
    return link.motion(world)


def force_and_rate(
    setup: Setup, drive: Drive, effects: Sequence[Effect] = ()
) -> tuple[Array, Array]:
    """Force and rate of ``closed_form`` alone, (n, 3) each: several times faster where nothing is
    off the common point.
    """
    world = world_of(setup, effects)
    if _displaced(setup, world, effects):
        motion = closed_form(setup, drive, effects)
        return motion.force, motion.rate
    link = _carried(setup, drive, effects, no_streams, _Link(world, drive, False, whole=False))
    return link.force(), np.column_stack(link.rate)


def _displaced(setup: Setup, world: World, effects: Sequence[Effect]) -> bool:
    """Whether the sensors are off the axes' common point, or that point is shaken."""
    off_axis = setup.rig.kind.chain is not None or any(
        np.any(link_offset(setup, effects, bearing(name))) for name in setup.rig.axis_names
    )
    return bool(np.any(world.lever)) or bool(world.shakes) or off_axis


def _carried(
    setup: Setup, drive: Drive, effects: Sequence[Effect], streams: Streams, link: "_Link"
) -> "_Link":
    """The link after the whole chain, base to mount."""
    angles = true_angles(setup, drive, effects, streams)
    frames = frames_of(effects)
    masses = masses_of(effects, setup.rig)
    whole = Context.along(drive, angles, setup.rig, link.gravity, masses)

    def slot(name: str) -> None:
        for effect in frames:
            # only what bends under load asks for it
            force = link.force() if effect.mechanised else None
            context = replace(whole, force=force, rng=streams(effect))
            for turn in turns_at(effect, name, context):
                link.turn(turn)

    slot("base")
    chain = setup.rig.kind.chain
    for name, axis in setup.rig.kind.moving:
        if chain is not None:
            link.fixed(chain.links[name])
        link.offset(link_offset(setup, effects, bearing(name)))
        slot(bearing(name))
        if name in setup.rig.kind.sliding:
            link.slide(angles[name])
        else:
            link.turn(Turn(axis, angles[name]))
        if chain is not None:
            slot(name)
    if drive.attitude is not None:
        link.take(drive.attitude.R_wb, drive.attitude.rate, drive.attitude.acceleration)
    if chain is not None:
        link.fixed(chain.instrument)
    link.mount(drive)
    slot("mount")
    return link


def frames_of(effects: Sequence[Effect]) -> list[FrameEffect]:
    """Effects that turn a frame, in the order in which they do: laws as they are given, then curves
    by the axis about which they turn, as those of one axis are one turn.
    """
    frames = [e for e in effects if isinstance(e, FrameEffect)]
    return sorted(frames, key=lambda e: e.turn if isinstance(e, LearnedTilt) else "")


def turns_at(effect: FrameEffect, slot: str, context: Context) -> Sequence[Turn]:
    """The turns of an effect at a slot; those a run by time steps found, where it has realised the
    effect.
    """
    if effect.address not in context.drive.realised:
        return effect.turns(slot, context)
    rings = [
        m
        for m in effect.dynamics(context.rig, context.gravity)
        if isinstance(m, Ring) and m.body == slot
    ]
    return [Turn(m.axis, context.drive.structure[m.joint]) for m in rings]


def link_offset(setup: Setup, effects: Sequence[Effect], slot: str) -> Array:
    """Displacement of the frame behind a slot by all LinkEffects, m, (3,)."""
    return sum(
        (e.offset(slot, setup.rig) for e in effects if isinstance(e, LinkEffect)), np.zeros(3)
    )


def _cross(one: Vector, other: Vector | Array) -> Vector:
    """The vector product, of which one factor may be alike in all rows, (3,)."""
    pairs = ((1, 2), (2, 0), (0, 1))
    return [np.asarray(one[j] * other[k] - one[k] * other[j]) for j, k in pairs]


class _Link:
    """The vectors carried outward, each a list of three arrays of shape (n,).

    Gravity and Earth's rate follow from up and north, which are carried instead. ``displaced``
    carries the acceleration, speed and position of the sensors' point as well; without ``whole``
    only up and the inertial rate are.
    """

    def __init__(self, world: World, drive: Drive, displaced: bool, whole: bool = True) -> None:
        n = len(drive.time)
        self.time, self.gravity, self.whole = drive.time, world.gravity, whole
        one, zero = np.ones(n), np.zeros(n)
        self.nothing: Vector = [zero, zero, zero]
        self.up: Vector = [zero, zero, one]
        self.rate: Vector = (
            [zero, zero, zero] if whole else [component * one for component in world.earth]
        )
        self.north: Vector = [zero, one, zero]
        self.spin: Vector = [zero, zero, zero]
        self.acceleration: Vector = [zero, zero, zero]
        self.speed: Vector = [zero, zero, zero]
        self.position: Vector = [zero, zero, zero]  # from the axes' common point at standstill
        for shake in world.shakes:
            for i, jet in enumerate(shake.jets(drive.elapsed)):
                self.acceleration[i] = self.acceleration[i] + jet.a
                self.speed[i] = self.speed[i] + jet.v
                self.position[i] = self.position[i] + jet.x
        self.carried: tuple[Vector, ...] = (self.up, self.rate)
        if whole:
            self.carried = (*self.carried, self.north, self.spin)
        if displaced:
            self.carried = (*self.carried, self.acceleration, self.speed, self.position)

    def force(self) -> Array:
        """Specific force at the point that is carried, (n, 3)."""
        return np.column_stack(
            [self.gravity * u + a for u, a in zip(self.up, self.acceleration, strict=True)]
        )

    def world(self, v: Array) -> Array:
        """A constant world vector in this frame, (n, 3): east is north x up."""
        each = zip(_cross(self.north, self.up), self.north, self.up, strict=True)
        return np.column_stack([v[0] * east + v[1] * n + v[2] * up for east, n, up in each])

    def offset(self, r: Array) -> None:
        """Pass a displacement: the point behind it moves on with the link."""
        if not np.any(r):
            return
        speed = _cross(self.rate, r)
        turned = zip(_cross(self.spin, r), _cross(self.rate, speed), strict=True)
        for target, change in (
            (self.acceleration, [s + w for s, w in turned]),
            (self.speed, speed),
            (self.position, list(r)),
        ):
            target[:] = [part + more for part, more in zip(target, change, strict=True)]

    def slide(self, along: Jet) -> None:
        """Pass a slide along z: the point behind it moves on as the link does, and on its own."""
        r = [*self.nothing[:2], np.asarray(along.x)]
        speed = _cross(self.rate, r)
        twice = [*speed[:2], speed[2] + 2 * along.v]
        turned = zip(_cross(self.spin, r), _cross(self.rate, twice), strict=True)
        for target, change, own in (
            (self.acceleration, [s + w for s, w in turned], along.a),
            (self.speed, speed, along.v),
            (self.position, self.nothing, along.x),
        ):
            target[:] = [part + more for part, more in zip(target, change, strict=True)]
            target[2] = target[2] + own

    def fixed(self, position: LinkFrame) -> None:
        """Pass to a frame that is fixed on this link."""
        self.offset(position.offset)
        for u in self.carried:
            u[:] = list(position.R.T @ np.array(u))

    def turn(self, turn: Turn) -> None:
        """Pass a hinge: all vectors into the frame behind it."""
        i = "xyz".index(turn.axis)
        j, k = (i + 1) % 3, (i + 2) % 3
        c, s = turn.angle.cos_sin
        for u in self.carried:
            u[j], u[k] = c * u[j] + s * u[k], c * u[k] - s * u[j]
        v = turn.angle.v
        if self.whole:
            # w x e v has components (w_k v, -w_j v) along j, k
            self.spin[i] = self.spin[i] + turn.angle.a
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
        for u in self.carried:
            u[:] = list(np.einsum("nji,jn->in", R, np.array(u)))

    def motion(self, world: World) -> Motion:
        """Add the lever arm, Earth's rate and Coriolis; stack."""
        self.offset(world.lever)
        force, position = self.force(), np.column_stack(self.position)
        if np.any(world.coriolis) and (np.any(position) or world.shakes):
            earth, speed = self.world(world.coriolis), np.column_stack(self.speed)
            force = force + 2 * np.cross(earth, speed) + np.cross(earth, np.cross(earth, position))
        rate, up, north, spin = (
            np.column_stack(v) for v in (self.rate, self.up, self.north, self.spin)
        )
        if np.any(world.earth):
            rate = rate + self.world(world.earth)
        return Motion(self.time, force, rate, up, north, spin)
