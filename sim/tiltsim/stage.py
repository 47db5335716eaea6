"""The nominal table for pictures: solids in motion, and images that need no display."""

import os
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.effects.mechanisms import World
from tiltcal.laboratory.scene import Scene, Solid
from tiltcal.setup.setup import Setup
from tiltcal.setup.trajectory import Drive
from tiltsim.motion import joint_states
from tiltsim.rig import Rig, RigBuilder

KINDS = {mujoco.mjtGeom.mjGEOM_BOX: "box", mujoco.mjtGeom.mjGEOM_CYLINDER: "cylinder"}
PAINT = (
    (0.36, 0.40, 0.47),
    (0.75, 0.47, 0.22),
    (0.25, 0.50, 0.74),
    (0.35, 0.60, 0.40),
    (0.58, 0.45, 0.70),
)
SUBJECT = (0.86, 0.31, 0.27)
CAMERA = {"azimuth": 130.0, "elevation": -18.0}
NO_GL = (
    "install a driver that renders without a display (Debian: apt install libegl1"
    " libgl1-mesa-dri), or run with MUJOCO_GL=osmesa and libosmesa6"
)


def table_scene(setup: Setup, drive: Drive) -> Scene:
    """Boxes and cylinders of the model along a drive; other shapes are left out."""
    solids: list[Solid] = []
    positions: list[Array] = []
    turns: list[Array] = []
    for rig, states in _mountings(setup, drive):
        model, data = rig.model, mujoco.MjData(rig.model)
        shown = [k for k in range(model.ngeom) if int(model.geom_type[k]) in KINDS]
        solids = [_solid(rig.model, k, setup) for k in shown]
        for state in states:
            data.qpos[:] = state
            mujoco.mj_kinematics(model, data)
            positions.append(data.geom_xpos[shown] - rig.centre)
            turns.append(data.geom_xmat[shown].reshape(-1, 3, 3).copy())
    return Scene(solids, np.array(positions), np.array(turns))


def table_pictures(setup: Setup, drive: Drive, width: int, height: int) -> Iterator[bytes]:
    """A picture at each instant of a drive, RGB, row by row from the top.

    Raises:
        TiltcalError: OpenGL is missing.
    """
    for rig, states in _mountings(setup, drive):
        model, data = rig.model, mujoco.MjData(rig.model)
        canvas = _Canvas(model, width, height)
        try:
            for state in states:
                data.qpos[:] = state
                mujoco.mj_forward(model, data)
                yield canvas.draw(model, data, rig.centre)
        finally:
            canvas.close()


def _mountings(setup: Setup, drive: Drive) -> Iterator[tuple[Rig, Array]]:
    """The rig of each mounting with the joint positions at its instants, (n, nq)."""
    if not setup.rig.axes and drive.attitude is None:
        raise TiltcalError(
            f"table {setup.rig.table}",
            found="no attitude at its instants",
            need="a scenario with a sequence: a hand-held recording does not state how it was held",
            do="show the scenario, or a recording on a table",
        )
    starts = [row for row, _ in drive.mounts] + [len(drive.time)]
    for (first, mount), last in zip(drive.mounts, starts[1:], strict=True):
        if last > first:
            builder = RigBuilder(setup, World.of(setup), mount)
            builder.prescribed.update(drive.axes)
            _paint(builder.spec, setup)
            rig = builder.compile()
            yield rig, joint_states(rig, drive, slice(first, last))[0]


def _solid(model: "mujoco.MjModel", k: int, setup: Setup) -> Solid:
    half = np.array(model.geom_size[k])
    kind = KINDS[int(model.geom_type[k])]
    if kind == "cylinder":  # radius and half length
        half = np.array([half[0], half[0], half[1]])
    name = model.body(int(model.geom_bodyid[k])).name
    part = name if name in ("base", *setup.rig.axis_names) else "instrument"
    return Solid(part, "box" if kind == "box" else "cylinder", half)


def _paint(spec: "mujoco.MjSpec", setup: Setup) -> None:
    """Colours of the parts, and a light background."""
    parts = ("base", *setup.rig.axis_names)
    for geom in spec.geoms:
        name = geom.parent.name
        colour = PAINT[parts.index(name) % len(PAINT)] if name in parts else SUBJECT
        geom.rgba = [*colour, 1.0]
    kinds = mujoco.mjtTexture.mjTEXTURE_SKYBOX, mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.45] * 3, [0.6] * 3
    light, lighter = [0.82, 0.86, 0.90], [0.97, 0.98, 0.99]
    spec.add_texture(
        name="background",
        type=kinds[0],
        builtin=kinds[1],
        rgb1=lighter,
        rgb2=light,
        width=64,
        height=384,
    )


class _Canvas:
    """An off-screen OpenGL context of its own: it needs no display."""

    def __init__(self, model: "mujoco.MjModel", width: int, height: int) -> None:
        self.context = _context(width, height)
        self.context.make_current()
        model.vis.global_.offwidth, model.vis.global_.offheight = width, height
        self.scene = mujoco.MjvScene(model, maxgeom=1000)
        self.renderer = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self.renderer)
        self.view = mujoco.MjrRect(0, 0, width, height)
        self.pixels = np.empty((height, width, 3), np.uint8)

    def draw(self, model: "mujoco.MjModel", data: "mujoco.MjData", centre: Array) -> bytes:
        """The picture of a state, looking at the axes' common point."""
        camera = mujoco.MjvCamera()
        mujoco.mjv_defaultFreeCamera(model, camera)
        camera.lookat[:] = centre - [0.0, 0.0, 0.1 * model.stat.extent]
        camera.distance = 1.5 * model.stat.extent
        camera.azimuth, camera.elevation = CAMERA["azimuth"], CAMERA["elevation"]
        options = mujoco.MjvOption()
        mujoco.mjv_updateScene(
            model, data, options, None, camera, mujoco.mjtCatBit.mjCAT_ALL, self.scene
        )
        mujoco.mjr_render(self.view, self.scene, self.renderer)
        mujoco.mjr_readPixels(self.pixels, None, self.view, self.renderer)
        return np.flipud(self.pixels).tobytes()

    def close(self) -> None:
        """Give the context back."""
        self.renderer.free()
        self.context.free()


def _context(width: int, height: int) -> Any:
    """An OpenGL context that needs no display: EGL, or what MUJOCO_GL names.

    Raises:
        TiltcalError: there is none on this machine.
    """
    wanted = os.environ.get("MUJOCO_GL", "egl").lower()
    try:
        if wanted == "osmesa":
            from mujoco.osmesa import GLContext
        else:
            from mujoco.egl import GLContext
        return GLContext(width, height)
    except Exception as error:  # drivers fail in their own ways
        raise TiltcalError(
            "pictures by MuJoCo",
            found=f"no OpenGL without a display ({str(error).strip() or type(error).__name__})",
            need="EGL or OSMesa",
            do=NO_GL,
        ) from error
