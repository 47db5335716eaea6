"""What moves a joint of a user's own model in a run by time steps: its drive, and its servo."""

import mujoco
import numpy as np

NATURAL = 2 * np.pi * 20.0  # rad/s, of the servo of a joint that has none, critically damped


def drive_of(model: "mujoco.MjModel", joint: int) -> dict[str, float]:
    """Drive and servo of a joint, as a ``Link`` has them.

    The servo is the model's own position actuator on that joint, seen through its gear; where there
    is none, one that swings at NATURAL with the inertia of all that the joint carries at the
    model's reference.

    Args:
        model: compiled.
        joint: number of a hinge.
    """
    dof = int(model.jnt_dofadr[joint])
    servo = next(filter(None, (_servo(model, k, joint) for k in range(model.nu))), None)
    inertia = float(model.dof_M0[dof])
    stiffness, damping = servo or (inertia * NATURAL**2, 2 * inertia * NATURAL)
    return {
        "armature_kg_m2": float(model.dof_armature[dof]),
        "damping_N_m_s_rad": float(model.dof_damping[dof]),
        "friction_N_m": float(model.dof_frictionloss[dof]),
        "servo_N_m_rad": stiffness,
        "servo_N_m_s_rad": damping,
    }


def _servo(model: "mujoco.MjModel", actuator: int, joint: int) -> tuple[float, float] | None:
    """Stiffness and damping of an actuator about a joint; None where it is no position servo of
    that joint.
    """
    kinds = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    if model.actuator_trntype[actuator] not in kinds or model.actuator_trnid[actuator, 0] != joint:
        return None
    gain, bias = model.actuator_gainprm[actuator], model.actuator_biasprm[actuator]
    fixed = model.actuator_gaintype[actuator] == int(mujoco.mjtGain.mjGAIN_FIXED)
    affine = model.actuator_biastype[actuator] == int(mujoco.mjtBias.mjBIAS_AFFINE)
    prompt = model.actuator_dyntype[actuator] == int(mujoco.mjtDyn.mjDYN_NONE)
    if not (fixed and affine and prompt and gain[0] > 0 and np.isclose(bias[1], -gain[0])):
        return None
    gear = float(model.actuator_gear[actuator, 0])
    return gear**2 * float(gain[0]), gear**2 * max(float(-bias[2]), 0.0)
