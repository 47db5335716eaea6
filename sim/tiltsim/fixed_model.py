"""Effects built into a user's own model file: frames that stand elsewhere, joints that give way.

The model stays the user's: bodies, actuators and contacts are as they were. Everything that the
effects turn is worked out at the model's reference, where it does not depend on the pose.

``prescribed_model`` gives a user's own model joints that follow a given motion, and the sensors of
the instrument.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import rotation
from tiltcal.effects.base import AngleEffect, Effect, FrameEffect
from tiltcal.effects.mechanisms import Compliance
from tiltcal.forward.kinematics import world_of
from tiltcal.laboratory.own_model import ModelAxis, ModelReference, fixed_error, fixed_turn
from tiltcal.setup.setup import Setup
from tiltcal.setup.tables import bearing
from tiltsim.model_reader import ModelJoint, ModelReader
from tiltsim.rig import ARMATURE, add_frame_sensors, quaternion

STIFFEST = 1e12  # N m/rad: a spring that does not give way
ROTOR = 1e-3  # kg m2 of a spring: else it shares the inertia of the joint about the same axis


@dataclass(frozen=True)
class Reference:
    """A user's model as it is without effects.

    Args:
        model: compiled; its joints stand at their reference.
        joints: those that are read, each after what carries it.
        site: of the instrument.
        base_moment: of the mass that no joint moves, about the world's East and North, kg m, (2,).
    """

    model: "mujoco.MjModel"
    joints: tuple[ModelJoint, ...]
    site: str
    base_moment: Array

    @classmethod
    def of(cls, spec: "mujoco.MjSpec", setup: Setup) -> "Reference":
        """The reference of a model that the rig of a set-up was read from.

        Raises:
            TiltcalError: the rig has no model of its own, or not this one.
        """
        rig = setup.rig
        if not rig.link or not rig.site:
            raise TiltcalError(
                "scenario",
                found=f"the table {rig.table}" if not rig.link else "links without their site",
                need="a model of your own: [rig] mjcf, axes and site",
                do="state it, and diagnose again",
            )
        stated = ("joint", "sign", "offset_deg", "offset_mm")
        axes = {link.axis: ModelAxis(**{k: getattr(link, k) for k in stated}) for link in rig.link}
        text = ModelReference(mjcf=rig.model, axes=axes, site=rig.site)
        reader = ModelReader(spec.compile(), text, f"model {rig.model}")
        reader.frame_of(rig.site)
        return cls(reader.model, tuple(reader.axes), rig.site, reader.base_moment())

    def pose(self, body: int) -> tuple[Array, Array]:
        """Frame and origin of a body in the world, (3, 3) and (3,), m."""
        data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, data)
        return data.xmat[body].reshape(3, 3).copy(), data.xpos[body].copy()


def build_in(
    spec: "mujoco.MjSpec", reference: Reference, setup: Setup, effects: Sequence[Effect]
) -> dict[str, float]:
    """Build effects into a model.

    Args:
        spec: the user's model, as ``reference`` was compiled from it.
        reference: of that model.
        setup: site and rig.
        effects: gravity, constant turns of the base, of joints and of the mount, constant errors
            of a readout, and compliances are built in; others are left alone.

    Returns:
        Stiffness, N m/rad, of each spring joint that was added, by its name.

    Raises:
        TiltcalError: the base has to bend, and a root body stands free.
    """
    down = np.array([0.0, 0.0, -world_of(setup, effects).gravity])
    spec.option.gravity = fixed_turn(setup, effects, "base").T @ down
    for joint in reversed(reference.joints):
        before = _bearing_turn(setup, effects, joint.name)
        behind = fixed_turn(setup, effects, joint.name)
        if not all(np.array_equal(turn, np.eye(3)) for turn in (before, behind)):
            turns = joint.bearing @ before @ joint.bearing.T, joint.R @ behind @ joint.R.T
            _turn_joint(spec, reference, joint, *turns)
    _turn_site(spec, reference, setup, effects)
    bends = [c for e in effects if isinstance(e, FrameEffect) for c in e.compliances(setup.rig)]
    return _install_springs(spec, reference, bends, setup.site.gravity)


def _bearing_turn(setup: Setup, effects: Sequence[Effect], axis: str) -> Array:
    """Turn before a joint, with the constant error of its readout, in its frame, (3, 3)."""
    errors = [fixed_error(e, setup, axis) for e in effects if isinstance(e, AngleEffect)]
    zero = sum(error for error in errors if error is not None)  # a slide has none
    return fixed_turn(setup, effects, bearing(axis)) @ rotation("z", zero)


def _turn_joint(
    spec: "mujoco.MjSpec", reference: Reference, joint: ModelJoint, before: Array, behind: Array
) -> None:
    """Turn a body about the anchor of one of its joints, from that joint on.

    Args:
        before, behind: the turns before that joint and behind it at the model's reference, in the
            world, (3, 3) each.
    """
    turn, own = before @ behind, spec.joint(reference.model.joint(joint.joint).name)
    model, body = reference.model, spec.bodies[joint.body]  # compiled in the order of the spec
    parent, base = reference.pose(int(model.body_parentid[joint.body]))
    frame = parent @ _matrix(_orientation(body, model.body_quat[joint.body]))
    position = base + parent @ np.array(body.pos)
    slid = joint.origin - joint.start  # at the model's reference, from readout zero
    turned, moved = (
        turn @ frame,
        joint.start + turn @ (position - joint.start - slid) + before @ slid,
    )
    for other in body.joints:
        if other.name == own.name:
            other.axis = turned.T @ before @ frame @ np.array(other.axis)
            break
        other.axis = turned.T @ frame @ np.array(other.axis)
        other.pos = turned.T @ (position + frame @ np.array(other.pos) - moved)
    body.pos = parent.T @ (moved - base)
    _orient(body, parent.T @ turned)


def _turn_site(
    spec: "mujoco.MjSpec", reference: Reference, setup: Setup, effects: Sequence[Effect]
) -> None:
    """Turn the instrument's site as its mounting is turned; a body has a site put on it."""
    site = spec.site(reference.site)
    if site is None:
        site = spec.body(reference.site).add_site(name=reference.site)
    mount, turn = setup.rig.mount_rotation, fixed_turn(setup, effects, "mount")
    if not np.array_equal(turn, np.eye(3)):
        nominal = _matrix(reference.model.site(reference.site).quat)
        _orient(site, nominal @ mount @ turn @ mount.T)


def _install_springs(
    spec: "mujoco.MjSpec", reference: Reference, bends: Sequence[Compliance], gravity: float
) -> dict[str, float]:
    """Put a hinge with a spring before a joint, behind it, or under the root of the first."""
    found: dict[str, float] = {}
    for key in list(spec.keys) if bends else ():  # they state every joint, the new ones not
        spec.delete(key)
    bearings = {bearing(j.name): j for j in reference.joints}
    links = {j.name: j for j in reference.joints}
    for bend in bends:
        name = f"{bend.slot}_bend_{bend.axis}"
        direction, relaxed = "xyz".index(bend.axis), 0.0
        found[name] = 1 / bend.value if abs(bend.value) * STIFFEST > 1 else STIFFEST
        if bend.slot in bearings:
            joint = bearings[bend.slot]
            carrier, origin, along = joint.body, joint.start, joint.bearing[:, direction]
            before = spec.joint(reference.model.joint(joint.joint).name)
        elif bend.slot in links:
            joint = links[bend.slot]
            carrier, origin, along = joint.body, joint.origin, joint.R[:, direction]
            before = _next_joint(spec, reference, joint)
        else:
            carrier, origin, along = _root(reference), np.zeros(3), np.eye(3)[direction]
            before = next(iter(spec.bodies[carrier].joints), None)
            # it stands as the model has it under what does not move
            relaxed = -reference.base_moment[direction] * gravity / found[name]
        R, position = reference.pose(carrier)
        spring = _hinge_before(spec.bodies[carrier], before, name)
        spring.axis, spring.pos = R.T @ along, R.T @ (origin - position)
        spring.springref = np.degrees(relaxed) if spec.compiler.degree else relaxed
        spring.stiffness, spring.armature = [found[name], 0.0, 0.0], ROTOR
    return found


def _next_joint(spec: "mujoco.MjSpec", reference: Reference, joint: ModelJoint) -> Any:
    """The joint of the same body that follows one in the model, None where it is the last."""
    model, after = reference.model, joint.joint + 1
    if after < model.njnt and model.jnt_bodyid[after] == joint.body:
        return spec.joint(model.joint(after).name)
    return None


def _root(reference: Reference) -> int:
    """The body on the world that carries the first joint.

    Raises:
        TiltcalError: it stands free.
    """
    model, body = reference.model, reference.joints[0].body
    while model.body_parentid[body]:
        body = int(model.body_parentid[body])
    first = model.body_jntadr[body]
    if first >= 0 and model.jnt_type[first] == mujoco.mjtJoint.mjJNT_FREE:
        raise TiltcalError(
            f"model, body {model.body(body).name}",
            found="a free joint",
            need="a base that stands on the world",
            do="remove that joint, or leave out what bends the base",
        )
    return body


def _hinge_before(body: Any, before: Any, name: str) -> Any:
    """A new hinge of a body, before one of its joints (None: it has none).

    MjSpec appends: the new joint takes the position of that one, and each later one moves up.
    """
    kind, free = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtLimited.mjLIMITED_FALSE
    new = body.add_joint(name=name, type=kind, limited=free)
    joints = list(body.joints)
    if before is None:
        return new
    start = next(k for k, j in enumerate(joints) if j.name == before.name)
    states = [_state(j) for j in joints]
    order = [*range(start), len(joints) - 1, *range(start, len(joints) - 1)]
    for k, joint in enumerate(joints):
        joint.name = f"{name}_{k}"
    for joint, k in zip(joints, order, strict=True):
        for key, value in states[k].items():
            setattr(joint, key, value)
    return joints[start]


_STATE = (
    *("name", "type", "pos", "axis", "align", "ref", "group"),
    *("springref", "springyield", "stiffness", "springdamper", "damping"),
    *("armature", "frictionloss", "limited", "range", "margin"),
    *("actfrclimited", "actfrcrange", "actgravcomp"),
    *("solref_limit", "solimp_limit", "solref_friction", "solimp_friction"),
)
"""Properties of a joint in MjSpec."""


def _state(joint: Any) -> dict[str, Any]:
    """All properties of a joint, copied."""
    found = {key: getattr(joint, key) for key in _STATE}
    return {k: v.copy() if isinstance(v, np.ndarray) else v for k, v in found.items()}


def _orientation(item: Any, compiled: Array) -> Array:
    """Quaternion of a body, in its parent: as compiled where the file states it otherwise."""
    stated = item.alt.type == mujoco.mjtOrientation.mjORIENTATION_QUAT
    return np.array(item.quat) if stated else np.array(compiled)


def _orient(item: Any, R: Array) -> None:
    """Give a body or site a frame in its parent, whatever orientation its file states."""
    item.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    item.quat = quaternion(R)


def _matrix(quat: Array) -> Array:
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, np.array(quat, float))
    return R.reshape(3, 3)


def prescribed_model(
    spec: "mujoco.MjSpec", site: str, mount: Array, lever: Array
) -> "mujoco.MjModel":
    """Compile a model for prescribed motion: no actuators, contacts or constraints, inertia that
    nothing else can move.

    Args:
        spec: it is changed.
        site: where the instrument sits.
        mount: components in the instrument's frame to the site's, (3, 3).
        lever: from the site to the sensors, instrument's frame, m, (3,).
    """
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    for joint in spec.joints:
        joint.armature, joint.damping = ARMATURE, [0.0, 0.0, 0.0]
    _place_instrument(spec, site, mount, lever)
    flags = mujoco.mjtDisableBit
    spec.option.disableflags |= (
        int(flags.mjDSBL_ACTUATION) | int(flags.mjDSBL_CONTACT) | int(flags.mjDSBL_CONSTRAINT)
    )
    return spec.compile()


def _place_instrument(spec: "mujoco.MjSpec", site: str, mount: Array, lever: Array) -> None:
    """A site ``accel`` on the instrument's site, turned by the mounting, and its sensors."""
    compiled = spec.compile().site(site)
    R, q = np.zeros(9), np.zeros(4)
    mujoco.mju_mulQuat(q, compiled.quat, quaternion(mount))
    mujoco.mju_quat2Mat(R, q)
    carrier = spec.site(site).parent
    if site == "accel":  # the name that the sensors look for
        spec.delete(spec.site(site))
    carrier.add_site(name="accel", pos=compiled.pos + R.reshape(3, 3) @ lever, quat=q)
    kinds = mujoco.mjtSensor
    for name, kind in (("accel", kinds.mjSENS_ACCELEROMETER), ("gyro", kinds.mjSENS_GYRO)):
        spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="accel")
    add_frame_sensors(spec)
