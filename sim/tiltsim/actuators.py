"""Mechanics of the drive and of ringing structures, for runs by time steps.

Effects state what the servo of stiffness kp lets through, as angles; here they become torques on
the joint:

- Friction: dry friction kp short; the axis stops ``short`` of the command.
- Lag: damping kp tau, the bearing's in it; a ramp is followed with the lag ``tau``.
- Ballast: weight x arm = kp droop; the servo gives way by droop sin(angle).
- Cable: stiffness -kp pull / (1 + pull); kp (c - q) = k q gives q = c (1 + pull).
- Cogging: kp size sin(n q); q = c + size sin(n q), where the servo follows: n rate tau << 1.
- Ring: a hinge with the inertia behind it; released at the end of a move, it rings.

A ring is the mechanics of one hinge. Each move winds it up, slowly at first, to the stated size,
and lets go as it stops: A exp(-t/tau) (cos wt + sin(wt) / (w tau)), the closed form but for the
release from standstill. Like any structure it also bends by -acceleration / w^2 while the table
speeds up; its weight is trimmed, sag is an effect of its own.
"""

from collections.abc import Sequence

import mujoco
import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.effects.mechanisms import Ballast, Cable, Cogging, Friction, Lag, Mechanism, Ring
from tiltcal.setup.schedule import Schedule

ARM = 0.1  # m, of a ballast
INNER = 1e-5  # kg m2, of a ring's hinge itself, which keeps two hinges of one body apart


def install_drives(spec: "mujoco.MjSpec", mechanisms: Sequence[Mechanism], gravity: float) -> None:
    """Friction, damping, ballasts and cables of the servos, whose stiffness is already final.

    Args:
        spec: model to change.
        mechanisms: drives and what bears them.
        gravity: m/s2.
    """
    for servo in spec.actuators:
        joint, kp = spec.joint(servo.name), float(servo.gainprm[0])
        mine = [
            m
            for m in mechanisms
            if isinstance(m, Friction | Lag | Ballast | Cable) and m.axis == servo.name
        ]
        joint.frictionloss += kp * sum(m.short for m in mine if isinstance(m, Friction))
        pull = sum(m.pull for m in mine if isinstance(m, Cable))
        joint.stiffness = [-kp * pull / (1 + pull), 0.0, 0.0]
        tau = sum(m.tau for m in mine if isinstance(m, Lag))
        if tau:
            bearing = min(float(joint.damping[0]), kp * tau)
            joint.damping = [bearing, 0.0, 0.0]
            servo.set_to_position(kp, kv=kp * tau - bearing)
        droop = sum(m.droop for m in mine if isinstance(m, Ballast))
        if droop:
            spec.body(servo.name).add_body(
                name=f"{servo.name}_load",
                pos=[0.0, 0.0, float(np.copysign(ARM, droop))],
                ipos=[0.0, 0.0, 0.0],
                mass=kp * abs(droop) / (gravity * ARM),
                inertia=[1e-6] * 3,
                explicitinertial=True,
            )


def install_rings(spec: "mujoco.MjSpec", mechanisms: Sequence[Mechanism]) -> None:
    """A hinge a ring, still without stiffness.

    Raises:
        TiltcalError: two of them are one hinge.
    """
    for ring in (m for m in mechanisms if isinstance(m, Ring)):
        if spec.joint(ring.joint) is not None:
            raise TiltcalError(
                f"rig, {ring.body}",
                found="two effects that ring about the same axis",
                need="one, in a run by time steps",
                do="leave one out, or leave out [dynamics]",
            )
        axis = np.eye(3)["xyz".index(ring.axis)]
        spec.body(ring.body).add_joint(
            name=ring.joint, type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis, armature=INNER
        )


def tune(model: "mujoco.MjModel", data: "mujoco.MjData", rings: Sequence[Ring]) -> None:
    """Give each ring the stiffness and damping with which the stepped model, servos and all, has
    its frequency and decay.

    A mode z^n of the integrator, whose damping is implicit, obeys D(z) q = 0 with D = M (z - 1)^2 /
    (z dt^2) + C (z - 1) / dt + K; so the ring's own k + c (z - 1) / dt is minus the Schur
    complement of the other coordinates. A ring that its servo damps faster than stated keeps no
    damping of its own.

    Raises:
        TiltcalError: the servo is too soft to let it ring like that.
    """
    inertia = np.empty((model.nv, model.nv))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, inertia)
    axes = [int(model.joint(model.actuator(i).name).dofadr[0]) for i in range(model.nu)]
    dt = float(model.opt.timestep)
    # a load with play, at standstill
    held = {i for i in range(model.nv) if model.joint(i).name.endswith("_gap")}
    # each by itself: equal ones would be one mode
    held |= {int(model.joint(ring.joint).dofadr[0]) for ring in rings}
    others = [i for i in range(model.nv) if i not in held]
    for ring in rings:
        joint = model.joint(ring.joint)
        r = int(joint.dofadr[0])
        K, C = np.diag(model.jnt_stiffness), np.diag(model.dof_damping)
        K[axes, axes] += model.actuator_gainprm[:, 0]
        C[axes, axes] -= model.actuator_biasprm[:, 2]
        z = np.exp((-1 / ring.tau + 2j * np.pi * ring.frequency) * dt)
        s = (z - 1) / dt
        D = inertia * (s * s / z) + C * s + K
        D[r, r] -= K[r, r] + C[r, r] * s
        own = D[r, others] @ np.linalg.solve(D[np.ix_(others, others)], D[others, r]) - D[r, r]
        c = max(own.imag / s.imag, 0.0)
        k = own.real - c * s.real
        if k <= 0:
            raise TiltcalError(
                f"rig, {ring.body}",
                found=f"a servo too soft for a structure that rings at {ring.frequency:.4g} Hz",
                need="a stiffer servo",
                do="raise dynamics.stiffness_N_m_rad",
            )
        model.jnt_stiffness[joint.id], model.dof_damping[r] = k, c


class Torques:
    """What moves wind up, and what motors cog: planned a block of steps ahead, applied step by
    step.
    """

    def __init__(
        self,
        model: "mujoco.MjModel",
        data: "mujoco.MjData",
        schedule: Schedule,
        rings: Sequence[Ring],
        coggings: Sequence[Cogging],
    ) -> None:
        tune(model, data, rings)
        self.angles, self.applied, self.bias, self.schedule = (
            data.qpos,
            data.qfrc_applied,
            data.qfrc_bias,
            schedule,
        )
        self.rings = [int(model.joint(ring.joint).dofadr[0]) for ring in rings]
        self.hold = np.array(
            [model.jnt_stiffness[model.joint(ring.joint).id] * ring.size for ring in rings]
        )
        stiffness = {
            model.actuator(i).name: float(model.actuator_gainprm[i, 0]) for i in range(model.nu)
        }
        self.coggings = [
            (int(model.joint(c.axis).dofadr[0]), c.poles, stiffness[c.axis] * c.size)
            for c in coggings
        ]

    def plan(self, time: Array) -> None:
        """The torques that do not depend on the state, at the instants of the next steps, (n,).

        Args:
            time: s.
        """
        if self.rings:
            self.wound = winding(self.schedule, time)[:, None] * self.hold

    def push(self, k: int) -> None:
        """Apply them before step ``k`` of the block."""
        if self.rings:
            self.applied[self.rings] = self.wound[k] + self.bias[self.rings]
        for dof, _, _ in self.coggings:
            self.applied[dof] = 0.0
        for dof, poles, size in self.coggings:
            self.applied[dof] += size * np.sin(poles * self.angles[dof])


def winding(schedule: Schedule, time: Array) -> Array:
    """0 at standstill; 0 to 1 in the course of each motion between two stops, with continuous
    acceleration, (n,).

    Args:
        schedule: motion of the axes.
        time: s.
    """
    legs = schedule.legs
    which = np.asarray(schedule.leg_of(time))
    start, end = np.array([leg.t0 for leg in legs]), np.array([leg.t1 for leg in legs])
    for i in range(1, len(legs)):
        if legs[i].stop < 0 and legs[i - 1].stop < 0:
            start[i] = start[i - 1]
    for i in range(len(legs) - 2, -1, -1):
        if legs[i].stop < 0 and legs[i + 1].stop < 0:
            end[i] = end[i + 1]
    moving = np.array([leg.stop < 0 for leg in legs])
    u = np.clip((time - start[which]) / np.maximum(end - start, 1e-12)[which], 0.0, 1.0)
    return np.asarray(moving[which] * u**3 * (10 - 15 * u + 6 * u * u))
