"""The rig: an MjSpec from models/ with the mechanisms of the effects built into it.

Slots are bodies: ``base``, ``<axis>_bearing``, ``<axis>``, ``mount``. A constant turn is multiplied
into the slot's quat; one that moves becomes a hinge of its own, prescribed like the table's axes.

The links of a user's own model become MJCF with the frames that effects turn, like the tables of
``models/``.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import mujoco
import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.assets import folder
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import rotation, unit
from tiltcal.effects.base import Effect
from tiltcal.effects.loads import masses_of
from tiltcal.effects.mechanisms import Cogging, Context, Gap, Mechanism, Ring, Spring, Turn, World
from tiltcal.effects.streams import Streams, no_streams
from tiltcal.forward.kinematics import frames_of, link_offset, turns_at
from tiltcal.laboratory.scenario_tables import Dynamics
from tiltcal.setup.chain import BASE, Chain, Link, LinkFrame
from tiltcal.setup.setup import Setup
from tiltcal.setup.tables import Table, bearing
from tiltcal.setup.trajectory import Drive, Jet
from tiltsim.actuators import install_drives, install_rings

LIGHT = 1e-4  # kg, and ten times the kg m2, of frames without geometry
SMALLEST = 1e-6  # kg and kg m2: MuJoCo refuses a body that moves and has none


def mjcf_of(chain: Chain) -> str:
    """MJCF of the links: a body ``<axis>`` with a hinge or slide of that name behind a frame
    ``<axis>_bearing``, and the instrument behind ``mount``.
    """
    root = Element("mujoco", model="links")
    SubElement(root, "compiler", angle="radian", autolimits="true")
    SubElement(root, "option", gravity="0 0 -9.80665", timestep="0.0005", integrator="implicitfast")
    defaults = SubElement(root, "default")
    SubElement(defaults, "geom", contype="0", conaffinity="0", mass="0", group="1")
    SubElement(defaults, "site", group="2")
    base = _body(_body(SubElement(root, "worldbody"), "pier", 200.0), "base", 80.0)
    bodies = {BASE: base}
    for link in chain.link:
        bodies[link.axis] = _link(bodies[link.on], link)
    _instrument(bodies[chain.instrument.on], chain.instrument)
    servos = SubElement(root, "actuator")
    for link in chain.link:
        if not link.servo_N_m_rad:
            continue
        servo = SubElement(servos, "position", name=link.axis, joint=link.axis)
        servo.set("kp", repr(link.servo_N_m_rad))
        servo.set("kv", repr(link.servo_N_m_s_rad))
    sensors = SubElement(root, "sensor")
    SubElement(sensors, "accelerometer", name="accel", site="accel")
    for name in ("gyro", "fog"):
        SubElement(sensors, "gyro", name=name, site=name)
    return ElementTree.tostring(root, encoding="unicode")


def _link(parent: Element, link: Link) -> Element:
    """A link on its parent: its frame, its bearing, and what moves."""
    position = _body(parent, f"{link.axis}_place", SMALLEST, link)
    body = SubElement(_body(position, bearing(link.axis), SMALLEST), "body", name=link.axis)
    kind = "slide" if link.slides else "hinge"
    joint = SubElement(body, "joint", name=link.axis, type=kind, axis="0 0 1")
    joint.set("armature", repr(link.armature_kg_m2))
    joint.set("damping", repr(link.damping_N_m_s_rad))
    joint.set("frictionloss", repr(link.friction_N_m))
    inertial = SubElement(body, "inertial", pos=_numbers(link.centre_m))
    inertial.set("mass", repr(max(link.mass_kg, SMALLEST)))
    moments = [i + SMALLEST for i in link.inertia_kg_m2[:3]]
    inertial.set("fullinertia", _numbers([*moments, *link.inertia_kg_m2[3:]]))
    return body


def _instrument(parent: Element, position: LinkFrame) -> None:
    """The mount behind the frame of the instrument, with the hinges of its compliance."""
    inner = _body(_body(parent, "instrument_place", LIGHT, position), "mount", LIGHT)
    for axis, along in zip("xyz", ("1 0 0", "0 1 0", "0 0 1"), strict=True):
        name = f"bend_{axis}"
        inner = _body(inner, name, LIGHT)
        SubElement(inner, "joint", name=name, axis=along, stiffness="2000", damping=".4")
    SubElement(inner, "include", file="instrument.xml")


def _body(parent: Element, name: str, mass: float, position: LinkFrame | None = None) -> Element:
    """A body without geometry, parent of others. position: its frame, at the origin if None."""
    body = SubElement(parent, "body", name=name)
    if position is not None:
        body.set("pos", _numbers(position.offset_m))
        body.set("quat", _numbers(position.rotation))
    inertia = _numbers([mass * 0.1] * 3)
    SubElement(body, "inertial", pos="0 0 0", mass=repr(mass), diaginertia=inertia)
    return body


def _numbers(values: "tuple[float, ...] | list[float]") -> str:
    return " ".join(map(repr, values))


# kg m2: inertia against which every other torque vanishes, so that qacc = applied / ARMATURE
ARMATURE = 1e15
GAP_FRICTION = 2.0  # N m on a load with play: stops it against its own inertia up to some 5 rad/s2
_VECTOR = {"x": [1.0, 0.0, 0.0], "y": [0.0, 1.0, 0.0], "z": [0.0, 0.0, 1.0]}


@dataclass(frozen=True)
class Rig:
    """A compiled model and what drives each of its joints.

    Args:
        model: with accelerometer, gyro, framequat, angular acceleration and velocimeter on the
            instrument.
        prescribed: joint name -> jet, of the joints that follow a given motion.
        springs: joint name -> stiffness, N m/rad, of the joints whose equilibrium MuJoCo finds.
        rings, coggings: what a run by time steps still has to tune, to wind up and to drive.
        free: whether the instrument is a free body.
        displaced: whether the sensors are off the axes' common point, or that point is shaken.
        centre: the common point at standstill, world, m, (3,).
        inertial: whether the springs give way to inertia too, and not to weight alone.
    """

    model: mujoco.MjModel
    prescribed: Mapping[str, Jet]
    springs: Mapping[str, float] = field(default_factory=dict)
    rings: tuple[Ring, ...] = ()
    coggings: tuple[Cogging, ...] = ()
    free: bool = False
    displaced: bool = False
    centre: Array = field(default_factory=lambda: np.zeros(3))
    inertial: bool = False

    def dof(self, joint: str) -> int:
        """Address of a joint's (first) degree of freedom; of its qpos too, but for a free body."""
        return int(self.model.joint(joint).dofadr[0])

    def position(self, joint: str) -> int:
        """Address of a joint's (first) coordinate in qpos."""
        return int(self.model.joint(joint).qposadr[0])


def quaternion(R: Array) -> Array:
    """(w, x, y, z) of a rotation matrix."""
    q = np.zeros(4)
    mujoco.mju_mat2Quat(q, np.ascontiguousarray(R).ravel())
    return q


def open_model(table: Table) -> "mujoco.MjSpec":
    """The model of a table. It includes ``instrument.xml``, which need not lie next to it.

    Raises:
        TiltcalError: the file does not open, or lacks a body or joint that the table needs.
    """
    instrument = folder("models") / "instrument.xml"
    included = {instrument.name: instrument.read_bytes()}
    if table.chain is not None:
        spec = mujoco.MjSpec.from_string(mjcf_of(table.chain), include=included)
        body = spec.body("instrument")  # its mass is in the model already
        body.mass, body.inertia = SMALLEST, [SMALLEST] * 3
        return spec
    try:
        spec = mujoco.MjSpec.from_file(str(table.mjcf), include=included)
    except ValueError as error:
        raise TiltcalError(
            f"table {table.name}",
            found=str(error),
            need=f"its MJCF at {table.mjcf}",
            do="correct the path or the file",
        ) from error
    bodies = ("pier", *table.slots, *table.axis_names) if table.axes else ("hand", "mount")
    missing = [f"body {name}" for name in bodies if spec.body(name) is None]
    missing += [f"joint {name}" for name in table.axis_names if spec.joint(name) is None]
    if missing:
        raise TiltcalError(
            f"table {table.name}, {table.mjcf.name}",
            found=f"no {', no '.join(missing)}",
            need="a body and a joint for each axis, and the frames around them",
            do="name them as in models/dual.xml",
        )
    return spec


class RigBuilder:
    """Builds one rig: open the model, install effects in it, compile."""

    def __init__(self, setup: Setup, world: World, mount: Array) -> None:
        self.setup, self.world = setup, world
        self.spec = open_model(setup.rig.kind)
        self.spec.option.gravity = [0.0, 0.0, -world.gravity]
        self.spec.body("mount").quat = quaternion(mount)
        for site in ("accel", "accel_x", "accel_y", "accel_z", "inclinometer", "gyro", "fog"):
            self.spec.site(site).pos = world.lever
        fogs = setup.sensors("fog")
        if fogs:
            self.spec.site("fog").quat = quaternion(_frame_along(fogs[0].input_vector))
        self.prescribed: dict[str, Jet] = {}
        self.springs: dict[str, float] = {}
        self.stepped: tuple[Mechanism, ...] = ()
        off_centre = setup.rig.kind.chain is not None or bool(np.any(world.lever))
        self.displaced = off_centre or bool(world.shakes)

    def install_frames(
        self,
        effects: Sequence[Effect],
        drive: Drive,
        angles: Mapping[str, Jet],
        streams: Streams = no_streams,
    ) -> None:
        """Build the turns of frame effects into their slots."""
        frames, rig = frames_of(effects), self.setup.rig
        masses = masses_of(effects, rig)
        whole = Context.along(drive, angles, rig, self.world.gravity, masses)
        for slot in rig.kind.slots:
            each = (t for e in frames for t in turns_at(e, slot, replace(whole, rng=streams(e))))
            turns = _together(each)
            body: Any = self.spec.body(slot) if turns else None
            # behind a joint of the same body a constant turn is a hinge too
            while turns and turns[0].angle.constant and slot not in rig.axis_names:
                R = rotation(turns[0].axis, float(turns.pop(0).angle.x))
                q = np.zeros(4)
                mujoco.mju_mulQuat(q, np.array(body.quat), quaternion(R))
                body.quat = q
            for k, turn in enumerate(turns):
                self._hinge(f"{slot}_turn{k}", self._body_of_turn(slot, k), turn)

    def _body_of_turn(self, slot: str, k: int) -> "mujoco.MjsBody":
        """The body for the k-th moving turn of a slot: a body has at most six joints, the
        mount's bend bodies take the others.

        Raises:
            TiltcalError: there are too many of them.
        """
        chain = [slot, "bend_x", "bend_y", "bend_z"] if slot == "mount" else [slot]
        if k // 6 >= len(chain):
            raise TiltcalError(
                f"rig, {slot}",
                found=f"more than {6 * len(chain)} moving turns",
                need="fewer effects that turn this frame",
                do="leave some out",
            )
        return self.spec.body(chain[k // 6])

    def _hinge(self, name: str, body: "mujoco.MjsBody", turn: Turn) -> None:
        body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=_VECTOR[turn.axis])
        self.prescribed[name] = turn.angle

    def install_offsets(self, effects: Sequence[Effect]) -> None:
        """Displace the frames behind bearings whose axes do not intersect."""
        for name in self.setup.rig.axis_names:
            r = link_offset(self.setup, effects, bearing(name))
            if np.any(r):
                self.spec.body(bearing(name)).pos = r  # of a bearing it is zero before
                self.displaced = True

    def install_shakes(self, drive: Drive) -> None:
        """Slide joints under the base for its vibration (a mocap body would not shake the
        sensors).
        """
        if not self.world.shakes:
            return
        pier = self.spec.body("pier")  # outside the levelling: its axes are the world's
        totals = [Jet(0.0), Jet(0.0), Jet(0.0)]
        for shake in self.world.shakes:
            totals = [
                total + jet for total, jet in zip(totals, shake.jets(drive.elapsed), strict=True)
            ]
        for axis, jet in zip("xyz", totals, strict=True):
            pier.add_joint(
                name=f"base_{axis}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=_VECTOR[axis]
            )
            self.prescribed[f"base_{axis}"] = jet

    def install_dynamics(self, dynamics: Dynamics, mechanisms: Sequence[Mechanism]) -> None:
        """Make the model ready for a run by time steps: mechanisms with true masses, servos, dry
        friction.
        """
        spec = self.spec
        spec.option.timestep = dynamics.timestep_s
        self.install_mechanisms(mechanisms, light=False)
        for servo in spec.actuators:
            kp = (
                servo.gainprm[0]
                if dynamics.stiffness_N_m_rad is None
                else dynamics.stiffness_N_m_rad
            )
            kv = (
                -servo.biasprm[2]
                if dynamics.damping_N_m_s_rad is None
                else dynamics.damping_N_m_s_rad
            )
            servo.set_to_position(kp, kv=kv)
        for name in self.setup.rig.axis_names:
            joint = spec.joint(name)
            joint.frictionloss += dynamics.friction_N_m
            harden(joint)
        install_drives(spec, mechanisms, self.world.gravity)
        install_rings(spec, mechanisms)
        self.stepped = tuple(mechanisms)

    def install_mechanisms(self, mechanisms: Sequence[Mechanism], light: bool = True) -> None:
        """Springs and gaps.

        Either way the mount's ballasts are no load for the table: ``light`` makes them tiny, else
        counterweights balance them, as a table is trimmed for its payload.
        """
        springs = combined([m for m in mechanisms if isinstance(m, Spring)])
        self.lock_mount({spring.body for spring in springs})
        for spring in springs:
            self._spring(spring, 1e-4 if light and spring.body.startswith("bend") else 1.0)
        for m in mechanisms:
            if isinstance(m, Gap):
                self._gap(m)

    def _spring(self, spring: Spring, scale: float) -> None:
        name = spring.body if spring.body.startswith("bend") else f"{spring.body}_sag"
        body = self.spec.body(spring.body)
        joint = self.spec.joint(name)
        if joint is None:
            joint = body.add_joint(
                name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=_VECTOR[spring.axis]
            )
            joint.damping = [2.0, 0.0, 0.0]
        joint.stiffness = [spring.stiffness * scale, 0.0, 0.0]
        mass = spring.mass * scale
        body.add_body(
            name=f"{name}_ballast",
            pos=spring.arm,
            ipos=[0.0, 0.0, 0.0],
            mass=mass,
            inertia=[1e-6 * scale] * 3,
            explicitinertial=True,
        )
        self.springs[name] = spring.stiffness * scale
        if scale == 1.0 and name.startswith("bend"):
            behind = tuple(-r for r in spring.arm)
            self.spec.body("mount").add_body(
                name=f"{name}_counterweight",
                pos=behind,
                ipos=[0.0, 0.0, 0.0],
                mass=mass,
                inertia=[1e-6] * 3,
                explicitinertial=True,
            )

    def _gap(self, gap: Gap) -> None:
        """Lost motion: a second hinge between hard limits.

        The friction that keeps the load back is the bearing's, against the stator, so it acts on
        the sum of the two angles: a tendon (friction inside the gap would carry the load along).
        """
        joint = self.spec.body(gap.axis).add_joint(
            name=f"{gap.axis}_gap",
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=_VECTOR[dict(self.setup.rig.axes)[gap.axis]],
            limited=True,
            range=[-gap.width / 2, gap.width / 2],
            armature=0.01,
        )
        joint.solimp_limit = [0.9999, 0.9999, 1e-6, 0.5, 2.0]
        stop = 8 * self.spec.option.timestep  # s; with 2 steps the load rattles between its stops
        joint.solref_limit = [stop, 1.0]
        joint.damping = [1.0, 0.0, 0.0]
        load = self.spec.add_tendon(name=f"{gap.axis}_load", frictionloss=GAP_FRICTION)
        for name in (gap.axis, f"{gap.axis}_gap"):
            load.wrap_joint(name, 1.0)
        harden(load)

    def lock_mount(self, free: set[str]) -> None:
        """Delete the mount's compliant hinges, but for the freed ones."""
        for axis in "xyz":
            joint = self.spec.joint(f"bend_{axis}")
            if joint is not None and f"bend_{axis}" not in free:
                self.spec.delete(joint)

    def compile(self) -> Rig:
        """The rig for prescribed motion: no actuators, no constraints, inertia that nothing else
        can move.
        """
        spec, free = self.spec, not self.setup.rig.axes
        flags = mujoco.mjtDisableBit
        spec.option.disableflags |= (
            int(flags.mjDSBL_ACTUATION) | int(flags.mjDSBL_CONTACT) | int(flags.mjDSBL_CONSTRAINT)
        )
        for joint in spec.joints:
            joint.armature = ARMATURE
            joint.damping = [0.0, 0.0, 0.0]
        for body in spec.bodies:
            if body.name != "world" and not body.name.endswith("_ballast"):
                body.gravcomp = 1.0
        spec.delete(spec.sensor("fog"))
        add_frame_sensors(spec)
        centre = np.array(spec.body("hand" if free else "pier").pos)
        return Rig(
            spec.compile(),
            dict(self.prescribed),
            dict(self.springs),
            free=free,
            displaced=self.displaced,
            centre=centre,
        )

    def compile_dynamic(self) -> Rig:
        """The rig for a run by time steps: everything moves as its inertia lets it; a hand carries
        the weight.
        """
        spec, free = self.spec, not self.setup.rig.axes
        flags = mujoco.mjtDisableBit
        for flag in (flags.mjDSBL_CONTACT, flags.mjDSBL_SENSOR, flags.mjDSBL_AUTORESET):
            spec.option.disableflags |= int(flag)
        if free:
            spec.option.gravity = [0.0, 0.0, 0.0]
        rings = tuple(m for m in self.stepped if isinstance(m, Ring))
        coggings = tuple(m for m in self.stepped if isinstance(m, Cogging))
        return Rig(spec.compile(), {}, dict(self.springs), rings, coggings, free)


def add_frame_sensors(spec: "mujoco.MjSpec") -> None:
    """Attitude, angular acceleration, position and velocity of the site ``accel``."""
    kinds = mujoco.mjtSensor
    frames = {
        "attitude": kinds.mjSENS_FRAMEQUAT,
        "spin": kinds.mjSENS_FRAMEANGACC,
        "place": kinds.mjSENS_FRAMEPOS,
        "speed": kinds.mjSENS_VELOCIMETER,
    }
    for name, kind in frames.items():
        spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="accel")


def combined(springs: Sequence[Spring]) -> list[Spring]:
    """One spring for all that bend the same body about the same axis: the deflections m g arm / k
    add up as vectors.
    """
    groups: dict[tuple[str, str], list[Spring]] = {}
    for spring in springs:
        groups.setdefault((spring.body, spring.axis), []).append(spring)
    found = []
    for first, *more in groups.values():
        arm = sum(
            (first.stiffness / first.mass * s.mass / s.stiffness * np.array(s.arm) for s in more),
            np.array(first.arm),
        )
        found.append(replace(first, arm=(float(arm[0]), float(arm[1]), float(arm[2]))))
    return found


def harden(joint: "mujoco.MjsJoint | mujoco.MjsTendon") -> None:
    """Dry friction without creep: with MuJoCo's default a loaded joint creeps 1970 arcsec/s, so
    0.09.
    """
    joint.solref_friction, joint.solimp_friction = [0.001, 1.0], [0.9999, 0.9999, 0.001, 0.5, 2.0]


def _together(turns: Iterable[Turn]) -> list[Turn]:
    """Turns, moving ones in a row about one axis as one: a body has six joints."""
    found: list[Turn] = []
    for turn in turns:
        last = found[-1] if found else None
        moving = last and not last.angle.constant and not turn.angle.constant
        if last and moving and last.axis == turn.axis:
            found[-1] = Turn(turn.axis, last.angle + turn.angle)
        else:
            found.append(turn)
    return found


def _frame_along(z: Array) -> Array:
    """A rotation whose z axis is ``z``."""
    x = unit(np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z))
    return np.column_stack([x, np.cross(z, x), z])
