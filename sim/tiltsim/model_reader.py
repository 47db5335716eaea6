"""A user's own MJCF or URDF as links: joint axes, fixed frames, masses, and the position of the
instrument.

MuJoCo compiles the file, so that whatever it loads is read. Joints that no readout is mapped to
stay at the model's reference.

All files that a model names lie in the scenario's folder.

MuJoCo looks for a file from the main model's folder and from that of the file that names it, in the
folders that any part of the model states for its assets.

In a run by time steps a joint has the drive and the servo that the model gives it.
"""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import mujoco
import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError, nearest
from tiltcal.core.frames import rotation
from tiltcal.core.units import MM
from tiltcal.laboratory.own_model import ModelAxis, ModelReference
from tiltcal.setup.chain import BASE, Chain, Link, LinkFrame
from tiltsim.couplings import require_tied_joints_read
from tiltsim.model_sizes import MOST_BODIES, require_few

LARGEST = 64 * 2**20  # bytes
FOLDERS = ("meshdir", "texturedir", "assetdir")
PARTS = ("include", "model")  # elements that name further XML
SCHEMES = ("file://", "package://")  # of URDF


def require_inside(folder: Path, path: Path, text: str) -> Path:
    """A file inside a folder, with its links resolved.

    Raises:
        TiltcalError: it lies elsewhere, is no file, or is too large.
    """
    found = Path(os.path.realpath(path))  # links in a circle are no file
    if not found.is_relative_to(folder.resolve()):
        raise _error(text, "a path outside the scenario's folder", "files inside it")
    if not found.is_file():
        raise _error(text, "no such file", "a file in the scenario's folder")
    if found.stat().st_size > LARGEST:
        raise _error(text, f"{found.stat().st_size} bytes", f"at most {LARGEST}")
    return found


def check_files(main: Path, folder: Path) -> None:
    """Every file that a model and its parts name lies in a folder; MuJoCo reports one that is
    missing.

    Raises:
        TiltcalError: one does not, or a part is no XML.
    """
    roots: dict[Path, Element] = {}
    waiting = [main]
    while waiting:
        path = waiting.pop()
        if path in roots:
            continue
        roots[path] = _parsed(path)
        require_few(roots[path], path.name)
        for name, tag in _named(roots[path]):
            for position in (main.parent, path.parent) if tag in PARTS else ():
                target = (position / name).resolve()
                if target.is_file():
                    waiting.append(require_inside(folder, target, name))
    stated = {e.get(k) or "" for r in roots.values() for e in r.iter("compiler") for k in FOLDERS}
    for path, root in roots.items():
        for name, _ in _named(root):
            for position in (main.parent, path.parent):
                for assets in stated | {""}:
                    target = (position / assets / name).resolve()
                    if not target.is_relative_to(folder.resolve()):
                        require_inside(folder, target, name)


def _named(root: Element) -> Iterator[tuple[str, str]]:
    """Each file that a part names, with the element that does."""
    for element in root.iter():
        for key, value in element.attrib.items():
            if key.startswith("file") and value:  # file, filename, fileright ...
                for scheme in SCHEMES:
                    value = value.removeprefix(scheme)
                yield value, element.tag


def _parsed(path: Path) -> Element:
    try:
        return ElementTree.fromstring(path.read_bytes())
    except ElementTree.ParseError as error:
        raise _error(path.name, f"no XML: {error}", "MJCF or URDF") from error


def _error(text: str, found: str, need: str) -> TiltcalError:
    return TiltcalError(
        f"model file {text}",
        found=found,
        need=need,
        do="correct it, or copy it into the scenario's folder",
    )


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


def read_model(
    text: ModelReference, folder: Path, sites: Sequence[str] = ()
) -> tuple[Chain, dict[str, LinkFrame]]:
    """The links of a model whose joints a scenario maps to table axes, and sites on them.

    Args:
        text: the file, the axes and the site, as the scenario states them.
        folder: of the scenario; the model and all that it includes lie in it.
        sites: of sensors that sit elsewhere than the instrument.

    Raises:
        TiltcalError: a file outside the folder, a model that MuJoCo does not load or that is far
            too large, or a joint or site that it does not have.
    """
    path = require_inside(folder, folder / text.mjcf, text.mjcf)
    check_files(path, folder)
    subject = f"model {text.mjcf}"
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)  # which MuJoCo writes to a file in the folder
    try:
        model = spec_of(path).compile()
    except (ValueError, RuntimeError) as error:
        raise TiltcalError(
            subject,
            found=str(error).splitlines()[0],
            need="a model that MuJoCo loads",
            do="correct the file; `python -m mujoco.viewer` shows it",
        ) from error
    finally:
        mujoco.set_mju_user_warning(before)
    if model.nbody > MOST_BODIES:
        raise TiltcalError(
            subject,
            found=f"{model.nbody} bodies",
            need=f"at most {MOST_BODIES}",
            do="leave out what does not carry the instrument",
        )
    reader = ModelReader(model, text, subject)
    return reader.chain(), {name: reader.frame_of(name) for name in sites}


def spec_of(path: Path) -> "mujoco.MjSpec":
    """A model with all of its bodies: links of a URDF that a fixed joint holds are bodies too,
    which MuJoCo would fuse, frames of instruments among them.
    """
    spec = mujoco.MjSpec.from_file(str(path))
    spec.compiler.fusestatic = False
    return spec


@dataclass(frozen=True)
class ModelJoint:
    """A mapped joint at the model's reference: its frame in the world, origin on the axis, z along
    it.
    """

    name: str
    joint: int
    body: int
    origin: Array
    R: Array
    zero: float  # of the link at readout zero, from the reference, rad or m
    slides: bool = False

    @property
    def bearing(self) -> Array:
        """The frame before it turns: as ``R`` at readout zero, (3, 3)."""
        return self.R if self.slides else self.R @ rotation("z", self.zero)

    @property
    def start(self) -> Array:
        """Where the origin is at readout zero, m, (3,)."""
        return self.origin + self.R[:, 2] * self.zero if self.slides else self.origin


class ModelReader:
    """The links of one compiled model."""

    def __init__(self, model: "mujoco.MjModel", text: ModelReference, subject: str) -> None:
        self.model, self.table, self.subject = model, text, subject
        self.data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, self.data)
        mapped = {self._joint(name, axis): (name, axis) for name, axis in text.axes.items()}
        if len(mapped) < len(text.axes):
            raise self._error("one joint mapped to two axes", "a joint for each axis")
        require_tied_joints_read(model, set(mapped), subject)
        self.axes = [self._axis(joint, *mapped[joint]) for joint in sorted(mapped)]

    def chain(self) -> Chain:
        """The links, and the instrument among them."""
        links = [self._link(k) for k in range(len(self.axes))]
        return Chain(link=tuple(links), instrument=self.frame_of(self.table.site))

    def frame_of(self, site: str) -> LinkFrame:
        """Frame of a site, or a body, among the links."""
        body, origin, R = self._site(site)
        return LinkFrame(**self._placed(self._on(body), origin, R))

    def base_moment(self) -> Array:
        """Moment of the mass that no axis moves, about the world's East and North, kg m, (2,): of
        r x (0, 0, -m).
        """
        fixed = [b for b in range(1, self.model.nbody) if self._on(b) < 0]
        x, y, _ = (self.model.body_mass[fixed, None] * self.data.xipos[fixed]).sum(0)
        return np.array([-y, x])

    def _joint(self, name: str, axis: ModelAxis) -> int:
        model = self.model
        number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, axis.joint)
        names = [model.joint(k).name for k in range(model.njnt)]
        if number < 0:
            raise self._error(
                f"no joint '{axis.joint}' for axis {name}",
                "the name of a joint",
                nearest(axis.joint, [n for n in names if n] or ["no joint has a name"]),
            )
        kind = mujoco.mjtJoint(model.jnt_type[number])
        text = kind.name.removeprefix("mjJNT_").lower()
        if kind not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            raise self._error(
                f"joint '{axis.joint}' for axis {name}, a {text} joint",
                "joints that turn about one axis, or slide along it",
                "leave it out of [rig.axes]: it stays at the model's reference",
            )
        other = "offset_deg" if kind == mujoco.mjtJoint.mjJNT_SLIDE else "offset_mm"
        if getattr(axis, other):
            raise self._error(
                f"{other} of axis {name}, whose joint is a {text}",
                "offset_mm of a slide, offset_deg of a hinge",
            )
        return int(number)

    def _axis(self, joint: int, name: str, axis: ModelAxis) -> ModelJoint:
        along = axis.sign * self.data.xaxis[joint]
        body = int(self.model.jnt_bodyid[joint])
        R = _frame_along(along, self.data.xmat[body].reshape(3, 3))
        reference = float(self.model.qpos0[self.model.jnt_qposadr[joint]])
        slides = bool(self.model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE)
        offset = axis.offset_mm * MM if slides else np.radians(axis.offset_deg)
        zero, origin = axis.sign * (offset - reference), np.array(self.data.xanchor[joint])
        return ModelJoint(name, joint, body, origin, R, float(zero), slides)

    def _link(self, k: int) -> Link:
        axis = self.axes[k]
        on = self._before(k)
        position = self._placed(on, axis.start, axis.bearing)
        text = self.table.axes[axis.name]
        return Link(
            axis=axis.name,
            joint=text.joint,
            slides=axis.slides,
            sign=text.sign,
            offset_deg=text.offset_deg,
            offset_mm=text.offset_mm,
            gear_ratio=text.gear_ratio,
            reference_deg=0.0 if axis.slides else float(-np.degrees(axis.zero)),
            **self._range(axis, text),
            **self._mass(k),
            **drive_of(self.model, axis.joint),
            **position,
        )

    def _range(self, axis: ModelJoint, text: ModelAxis) -> dict[str, tuple[float, float]]:
        """Lowest and highest readout within a joint's range, as a ``Link`` has them."""
        if not self.model.jnt_limited[axis.joint]:
            return {}
        ends = self.model.jnt_range[axis.joint]
        if axis.slides:
            name, readout = "range_mm", text.sign * (ends / MM - text.offset_mm)
        else:
            name, readout = "range_deg", text.sign * (np.degrees(ends) - text.offset_deg)
        return {name: (float(readout.min()), float(readout.max()))}

    def _placed(self, on: int, origin: Array, R: Array) -> dict[str, Any]:
        """A frame of the world as a ``LinkFrame`` on a link, by its number; -1: the base."""
        if on >= 0:
            link = self.axes[on]
            origin, R = link.R.T @ (origin - link.origin), link.R.T @ R
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(R).ravel())
        return {
            "on": self.axes[on].name if on >= 0 else BASE,
            "offset_m": tuple(map(float, origin)),
            "rotation": tuple(map(float, quaternion)),
        }

    def _on(self, body: int) -> int:
        """Number of the innermost axis that carries a body; -1: the base does."""
        while body > 0:
            own = [k for k, axis in enumerate(self.axes) if axis.body == body]
            if own:
                return own[-1]
            body = int(self.model.body_parentid[body])
        return -1

    def _before(self, k: int) -> int:
        """Number of the axis that carries one."""
        if k and self.axes[k - 1].body == self.axes[k].body:
            return k - 1
        return self._on(int(self.model.body_parentid[self.axes[k].body]))

    def _mass(self, k: int) -> dict[str, Any]:
        """Mass, centre and inertia, as a ``Link`` has them, of all bodies that move with an axis
        and with no axis inside it.
        """
        own = [b for b in range(1, self.model.nbody) if self._on(b) == k]
        masses = self.model.body_mass[own]
        total, axis = float(masses.sum()), self.axes[k]
        if total == 0:
            return {}
        centre = masses @ self.data.xipos[own] / total
        inertia = np.zeros((3, 3))
        for body, mass in zip(own, masses, strict=True):
            frame, arm = self.data.ximat[body].reshape(3, 3), self.data.xipos[body] - centre
            inertia += frame @ np.diag(self.model.body_inertia[body]) @ frame.T
            inertia += mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        turned = axis.R.T @ inertia @ axis.R
        positions = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
        return {
            "mass_kg": total,
            "centre_m": tuple(map(float, axis.R.T @ (centre - axis.origin))),
            "inertia_kg_m2": tuple(float(turned[position]) for position in positions),
        }

    def _site(self, name: str) -> tuple[int, Array, Array]:
        """Body, origin and frame of the instrument: a site of that name, or a body."""
        kinds = ((mujoco.mjtObj.mjOBJ_SITE, "site"), (mujoco.mjtObj.mjOBJ_BODY, "body"))
        model, data = self.model, self.data
        site, body = (mujoco.mj_name2id(model, kind, name) for kind, _ in kinds)
        if site >= 0:
            R = data.site_xmat[site].reshape(3, 3)
            return int(model.site_bodyid[site]), np.array(data.site_xpos[site]), R
        if body >= 0:
            return int(body), np.array(data.xpos[body]), data.xmat[body].reshape(3, 3)
        sites = [model.site(k).name for k in range(model.nsite)]
        bodies = [model.body(k).name for k in range(1, model.nbody)]
        raise self._error(
            f"no site or body '{name}'",
            "where the instrument sits",
            nearest(name, [n for n in (*sites, *bodies) if n] or ["nothing has a name"]),
        )

    def _error(self, found: str, need: str, do: str = "correct the scenario") -> TiltcalError:
        return TiltcalError(self.subject, found=found, need=need, do=do)


def _frame_along(axis: Array, body: Array) -> Array:
    """A frame whose z is an axis, and whose x is as near as can be to one of a body's, the first of
    those that are equally near but for rounding, (3, 3).
    """
    z = axis / np.linalg.norm(axis)
    across = body[:, int(np.argmin(np.abs(body.T @ z).round(9)))]
    x = across - z * (z @ across)
    x = x / np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])
