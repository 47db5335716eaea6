"""A user's own model by plain MuJoCo, with nothing of the product but a unit: poses, moves and
readings, springs in its joints and under its base, and payloads.
"""

import warnings
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np

from tiltcal.core.units import ARCSEC

RATE = 50.0  # Hz
GRAVITY = 9.80123
SLIDE = mujoco.mjtJoint.mjJNT_SLIDE


@dataclass(frozen=True)
class Mapped:
    """A joint with the sense and the zero of its readout, rad, or m where it slides."""

    joint: str
    sign: int = 1
    offset: float = 0.0
    slides: bool = False

    @property
    def written_zero(self):
        """The zero as a scenario states it."""
        if self.slides:
            return f"offset_mm = {1e3 * self.offset}"
        return f"offset_deg = {np.degrees(self.offset)}"

    def column(self, axis, place):
        """The readout's column and what stands in it."""
        if self.slides:
            return {f"table_{axis}_mm": 1e3 * place}
        return {f"table_{axis}_deg": np.degrees(place)}


class PlainModel:
    """A model file with springs built into it.

    Args:
        path: MJCF or URDF.
        axes: the readouts, by name.
        site: where the sensors sit: a site, or a body.
        joint_stiffness: N m/rad of a spring in series with a joint, by joint.
        link_stiffness: N m/rad of two springs behind a joint, about the axes across it, by joint.
        base_stiffness: N m/rad under the root body about East and North, whose origin is the
            world's.
        axis_tilt: rad, of a joint's axis about the two axes across it, by joint; a slide stands
            as before where its readout says zero.
        payload: kg, and where in the frame of the joint's body, m, (3,), by joint.
    """

    def __init__(
        self,
        path,
        axes,
        site,
        joint_stiffness=(),
        base_stiffness=None,
        axis_tilt=(),
        payload=(),
        link_stiffness=(),
    ):
        self.axes, self.springs = axes, {}
        spec = mujoco.MjSpec.from_file(str(path))
        spec.option.gravity = [0, 0, -GRAVITY]
        for name, stiffness in dict(joint_stiffness).items():
            joint = spec.joint(name)
            joint.parent.add_joint(
                name=f"{name}_spring",
                type=joint.type,
                axis=joint.axis,
                pos=joint.pos,
                limited=mujoco.mjtLimited.mjLIMITED_FALSE,
            )
            self.springs[f"{name}_spring"] = stiffness
        for name, stiffness in dict(link_stiffness).items():
            joint = spec.joint(name)
            for k, (axis, size) in enumerate(zip(across(joint.axis), stiffness, strict=True)):
                joint.parent.add_joint(
                    name=f"{name}_link_{k}",
                    type=joint.type,
                    axis=axis,
                    pos=joint.pos,
                    limited=mujoco.mjtLimited.mjLIMITED_FALSE,
                )
                self.springs[f"{name}_link_{k}"] = size
        if base_stiffness is not None:
            root, compiled = spec.worldbody.first_body(), spec.compile()
            R = _matrix(compiled.body(root.name).quat)  # its file may say it in other words
            for name, axis, stiffness in zip("xy", np.eye(3)[:2], base_stiffness, strict=True):
                root.add_joint(
                    name=f"base_{name}",
                    type=mujoco.mjtJoint.mjJNT_HINGE,
                    axis=R.T @ axis,
                    pos=R.T @ -np.array(root.pos),
                )
                self.springs[f"base_{name}"] = stiffness
        for name, (a, b) in dict(axis_tilt).items():
            joint = spec.joint(name)
            axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
            x, y = across(axis)
            tilted = axis + a * np.cross(x, axis) + b * np.cross(y, axis)
            joint.axis = tilted / np.linalg.norm(tilted)
            zeros = [m.offset for m in axes.values() if m.joint == name and m.slides]
            for zero in zeros:  # where the readout says zero it stands as before
                R = _matrix(joint.parent.quat)
                moved = R @ (axis - np.array(joint.axis)) * (zero - joint.ref)
                joint.parent.pos = np.array(joint.parent.pos) + moved
        for name, (mass, place) in dict(payload).items():
            spec.joint(name).parent.add_body(
                pos=place, ipos=[0] * 3, mass=mass, inertia=[1e-9] * 3, explicitinertial=True
            )
        if spec.site(site) is None:
            spec.body(site).add_site(name=site)
        for kind in (mujoco.mjtSensor.mjSENS_ACCELEROMETER, mujoco.mjtSensor.mjSENS_GYRO):
            spec.add_sensor(
                name=f"out_{int(kind)}", type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=site
            )
        for sensor in list(spec.sensors):
            if not sensor.name.startswith("out_"):
                spec.delete(sensor)
        with warnings.catch_warnings():  # springs in series share their inertia
            warnings.simplefilter("ignore")
            self.model = spec.compile()
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        self.data = mujoco.MjData(self.model)
        self._zero = self.data.qpos.copy()

    def dof(self, name):
        return int(self.model.joint(name).dofadr[0])

    def position(self, name):
        return int(self.model.joint(name).qposadr[0])

    def readings(self, time, angles):
        """Force and rate at the site, (n, 3) each, for readouts of the axes: rad, rad/s, rad/s2,
        (3, n) each.
        """
        bends = self._bends(len(time), angles)
        bend_rates = np.gradient(bends, time, axis=0)
        bend_accelerations = np.gradient(bend_rates, time, axis=0)
        found = np.zeros((len(time), 6))
        names = list(self.springs)
        model, data = self.model, self.data
        for k in range(len(time)):
            self._move(angles, k, bends[k])
            for j, name in enumerate(names):
                data.qvel[self.dof(name)] = bend_rates[k, j]
                data.qacc[self.dof(name)] = bend_accelerations[k, j]
            wanted = data.qacc.copy()
            mujoco.mj_sensorPos(model, data)
            mujoco.mj_fwdVelocity(model, data)
            mujoco.mj_sensorVel(model, data)
            data.qacc[:] = wanted
            mujoco.mj_rnePostConstraint(model, data)
            mujoco.mj_sensorAcc(model, data)
            found[k] = data.sensordata
        return found[:, :3], found[:, 3:]

    def load(self, angles, name):
        """Torque of weight and inertia about a joint, N m, (n,), on a motion as in ``readings``."""
        return self.moments(angles, name)[0]

    def moments(self, angles, name, about=None):
        """Of weight and inertia of all that a joint carries, N m: about its axis, (n,), and the
        vector about its anchor, or a point of the world, world, (n, 3).
        """
        n = angles[next(iter(angles))].shape[1]
        along, vector = np.zeros(n), np.zeros((n, 3))
        model, data = self.model, self.data
        joint, torque = model.joint(name), np.zeros(model.nv)
        for k in range(n):
            self._move(angles, k)
            mujoco.mj_rne(model, data, 1, torque)
            along[k] = -torque[self.dof(name)]
            mujoco.mj_rnePostConstraint(model, data)
            wrench = data.cfrc_int[joint.bodyid[0]]
            reference = data.subtree_com[model.body_rootid[joint.bodyid[0]]]
            arm = reference - (self._anchor(joint) if about is None else about)
            vector[k] = -(wrench[:3] + np.cross(arm, wrench[3:]))
        return along, vector

    def _anchor(self, joint):
        """Of a joint; where it slides, the one of the body that it moves."""
        data, place = self.data, joint.qposadr[0]
        slid = (data.qpos - self.model.qpos0)[place] * (joint.type[0] == SLIDE)
        return data.xanchor[joint.id] + slid * data.xaxis[joint.id]

    def _bends(self, n, angles):
        """Deflections of the springs under the loads, rad, (n, springs); their own motion is left
        out of these.
        """
        found = np.zeros((n, len(self.springs)))
        torque = np.zeros(self.model.nv)
        for k in range(n if self.springs else 0):
            for _ in range(4):  # contracts by m g l / k
                self._move(angles, k, found[k])
                mujoco.mj_rne(self.model, self.data, 1, torque)
                for j, (name, stiffness) in enumerate(self.springs.items()):
                    found[k, j] = -torque[self.dof(name)] / stiffness
        return found

    def _move(self, angles, k, bends=()):
        """Positions, velocities and accelerations of one row, and what follows from them."""
        model, data = self.model, self.data
        data.qpos[:], data.qvel[:], data.qacc[:] = self._zero, 0, 0
        for name, bend in zip(self.springs, bends, strict=False):
            data.qpos[self.position(name)] = bend
        for axis, mapped in self.axes.items():
            x, v, a = angles[axis][:, k]
            i = self.dof(mapped.joint)
            data.qpos[self.position(mapped.joint)] = mapped.sign * x + mapped.offset
            data.qvel[i], data.qacc[i] = mapped.sign * v, mapped.sign * a
        wanted = data.qacc.copy()
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        data.qacc[:] = wanted


def across(axis):
    """Two axes across one, (3,) each."""
    z = np.array(axis) / np.linalg.norm(axis)
    x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    x /= np.linalg.norm(x)
    return x, np.cross(z, x)


def poses_and_moves(rng, axes, poses, dwell=1.5, move=2.5, reach=2.0):
    """Stamps, s, (n,), and readouts with their derivatives, (3, n) each: quintic moves between
    random poses.
    """
    stops = rng.uniform(-reach, reach, (poses, len(axes)))
    rest, steps = int(dwell * RATE), int(move * RATE)
    s = np.linspace(0, 1, steps, endpoint=False)
    smooth = np.array(
        [
            s**3 * (10 - 15 * s + 6 * s**2),
            (30 * s**2 - 60 * s**3 + 30 * s**4) / move,
            (60 * s - 180 * s**2 + 120 * s**3) / move**2,
        ]
    )
    still = np.zeros((3, rest))
    parts = []
    for before, after in pairwise(stops):
        for part in (still, smooth):
            jets = part[:, :, None] * (after - before)
            jets[0] += before
            parts.append(jets)
    path = np.concatenate(
        [*parts, parts[0] * 0 + [[stops[-1]], [0 * stops[-1]], [0 * stops[-1]]]], 1
    )
    return np.arange(path.shape[1]) / RATE, {a: path[:, :, i] for i, a in enumerate(axes)}


def scenario_text(path, axes, site, sensors=("accelerometer",), adjustable=("bias", "scale")):
    """The scenario of an honest user of this model."""
    lines = ["schema = 1", 'name = "own model"', "[site]", f"gravity_m_s2 = {GRAVITY}", "[rig]"]
    lines += [f'mjcf = "{Path(path).name}"', f'site = "{site}"', "[rig.axes]"]
    for name, m in axes.items():
        lines.append(f'{name} = {{joint = "{m.joint}", sign = {m.sign}, {m.written_zero}}}')
    for kind in sensors:
        terms = ", ".join(f'"{a}"' for a in adjustable)
        lines += ["[[sensor]]", f'name = "{kind}"', f'kind = "{kind}"', f"rate_hz = {RATE}"]
        lines.append(f"adjustable = [{terms}]")
    return "\n".join(lines) + "\n"


def stated(id, axis=None, **bends):
    """The `[[effect]]` table of a compliance of known size, rad/(N m)."""
    lines = [f'id = "{id}"', *([f'axis = "{axis}"'] if axis else [])]
    lines += [f"{name}_arcsec_N_m = {value / ARCSEC}" for name, value in bends.items()]
    return "\n".join(["[[effect]]", *lines, ""])


def _matrix(quaternion):
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, np.array(quaternion, float))
    return R.reshape(3, 3)


PAN_TILT = """<mujoco model="pan-tilt head"><worldbody><body name="foot">
<geom type="cylinder" size=".12 .1" mass="8" pos="0 0 .1"/>
<body name="yoke" pos="0 0 .2"><joint name="pan" axis="0 0 1"/>
<geom type="box" size=".02 .12 .15" mass="3" pos=".03 0 .15"/>
<body name="cradle" pos="0 0 .25"><joint name="tilt" axis="0 1 0"/>
<geom type="box" size=".15 .08 .05" mass="4" pos=".12 .01 .03"/>
<body name="barrel" pos=".1 0 .02"><joint name="roll" axis="1 0 0"/>
<geom type="cylinder" size=".06 .1" mass="2" pos=".05 .04 0" euler="0 90 0"/>
<site name="imu" pos=".1 0 .04" euler="5 -10 20"/>
</body></body></body></body></worldbody></mujoco>"""
FOUR_AXES = """<mujoco model="four-axis table"><worldbody><body name="pier">
<geom type="box" size=".3 .3 .4" mass="200" pos="0 0 .4"/>
<body name="outer" pos="0 0 .9"><joint name="outer" axis="0 0 1"/>
<geom type="box" size=".05 .3 .2" mass="12" pos="0 0 -.1"/>
<body name="middle"><joint name="middle" axis="0 1 0"/>
<geom type="box" size=".22 .25 .03" mass="9" pos=".05 0 0"/>
<body name="inner"><joint name="inner" axis="1 0 0"/>
<geom type="box" size=".2 .13 .02" mass="6" pos="0 .05 -.03"/>
<body name="head"><joint name="head" axis="0 0 1"/>
<geom type="cylinder" size=".1 .02" mass="3" pos=".03 0 0"/>
<site name="imu" pos="0 0 .05" euler="0 5 30"/>
</body></body></body></body></body></worldbody></mujoco>"""
_LEG = """<body name="leg_{k}" pos="{x:.3f} {y:.3f} 0" euler="0 0 {turn}">
<joint name="coxa_{k}" axis="0 0 1"/><geom type="box" size=".03 .02 .02" mass=".3" pos=".03 0 0"/>
<body name="thigh_{k}" pos=".06 0 0"><joint name="femur_{k}" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 .15 .01 .02" size=".02" mass=".4"/>
<body name="shin_{k}" pos=".15 0 0"><joint name="tibia_{k}" axis="0 1 .1"/>
<geom type="capsule" fromto="0 0 0 .05 .02 -.2" size=".015" mass=".3"/>{site}
</body></body></body>"""
LIFT = """<mujoco model="pan-tilt head on a lift"><worldbody><body name="foot">
<geom type="cylinder" size=".3 .05" mass="30"/><site name="floor_imu" pos=".1 0 .05"/>
<body name="carriage" pos="0 .02 .3"><joint name="lift" type="slide" axis=".02 0 1" ref=".05"/>
<geom type="box" size=".1 .1 .05" mass="6" pos=".05 0 0"/>
<body name="yoke" pos=".1 0 .2"><joint name="pan" axis="0 0 1" pos=".01 0 0"/>
<geom type="box" size=".02 .12 .15" mass="3" pos=".03 0 .15"/>
<body name="cradle" pos="0 0 .25"><joint name="tilt" axis="0 1 0"/>
<geom type="box" size=".15 .08 .05" mass="4" pos=".12 .01 .03"/>
<body name="boom" pos=".1 0 .02"><joint name="boom" type="slide" axis="1 .1 0" range="-.2 .6"/>
<geom type="cylinder" size=".06 .1" mass="2" pos=".05 .04 0" euler="0 90 0"/>
<site name="imu" pos=".1 0 .04" euler="5 -10 20"/>
</body></body></body></body></body></worldbody></mujoco>"""
HEXAPOD = (
    '<mujoco model="hexapod"><worldbody><body name="trunk" pos="0 0 1" euler="3 -2 0"><freejoint/>'
    '<geom type="cylinder" size=".2 .05" mass="5"/>'
    + "".join(
        _LEG.format(
            k=k,
            x=0.2 * np.cos(k * np.pi / 3),
            y=0.2 * np.sin(k * np.pi / 3),
            turn=60 * k,
            site="" if k else '<site name="shin" pos=".03 0 -.1" euler="20 -30 10"/>',
        )
        for k in range(6)
    )
    + "</body></worldbody></mujoco>"
)
"""Rigs written for the tests, in which MuJoCo turns what hangs on a joint off its balance."""
