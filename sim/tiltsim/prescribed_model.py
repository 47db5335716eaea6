"""A user's own model whose joints follow a given motion, with the instrument's sensors."""

import mujoco
import numpy as np

from tiltcal.core.arrays import Array
from tiltsim.rig import ARMATURE, add_frame_sensors, quaternion


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
