"""What gives way under the load that a user's own model carries: its joints, and its base."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.effects.base import FrameEffect
from tiltcal.effects.mechanisms import Compliance, Context, Turn
from tiltcal.effects.parameter import Parameter
from tiltcal.setup.chain import BASE
from tiltcal.setup.setup import Rig
from tiltcal.setup.tables import bearing
from tiltcal.setup.trajectory import Jet

SPRING = (0.05, 2.0, 20.0)  # arcsec per N m: 4 to 0.01 MN m/rad
MOMENT = 1e-3  # s before and after, from which the rate of a load follows


class _OfModel(FrameEffect):
    """Needs the links of a model."""

    stage = "table"
    linear = True
    of_model = True


class JointAxisTilt(_OfModel):
    row_wise = True
    id = "joint_axis_tilt"
    title = "axis of a joint not where the model has it"
    parameters = (
        Parameter("tilt_x", "arcsec", (5, 60, 1800)),
        Parameter("tilt_y", "arcsec", (5, 60, 1800)),
    )
    axis_wise = True
    physics = "Two joints are not at the angle to each other that the model says."
    equation = "Rx(tilt_x) Ry(tilt_y) between a link and the next joint, in the joint's frame"
    source = "Hayati and Mirmirani 1985, J. Robotic Systems 2, 397"
    excited_by = "that joint and the next one turning"
    look = "a tilt that turns with the joint before"

    def turns(self, slot: str, context: Context) -> Sequence[Turn]:
        if slot != bearing(self.axis or context.rig.axis_names[0]):
            return ()
        return Turn("x", Jet(self.value("tilt_x"))), Turn("y", Jet(self.value("tilt_y")))


class JointCompliance(_OfModel):
    row_wise = True
    id = "joint_compliance"
    title = "a joint bends under its load"
    parameters = tuple(Parameter(f"bend_{a}", "arcsec_N_m", SPRING) for a in "xyz")
    axis_wise = True
    physics = "Gearbox and bearing of a joint give way to the moment of all that they carry."
    equation = (
        "rotation bend_i M_i about the axes of the joint's frame before it turns; z is its axis"
    )
    source = "Dumas et al. 2011, Robotics and CIM 27, 881: joint stiffness from deflection and load"
    excited_by = "poses in which the load on the joint differs"
    look = "a rotation that follows the load moment of the joint, whatever the angles"
    follows = "load moment"

    def turns(self, slot: str, context: Context) -> Sequence[Turn]:
        axis = self.axis or context.rig.axis_names[0]
        if slot != bearing(axis) or self.is_identity or context.rig.kind.chain is None:
            return ()

        def fixed(angles: dict[str, Array]) -> Array:
            x, y, z = _moment(axis, angles, context).T
            c, s = np.cos(angles[axis]), np.sin(angles[axis])
            return np.column_stack([c * x - s * y, s * x + c * y, z])

        return _bends([self.value(f"bend_{a}") for a in "xyz"], fixed, context)

    def compliances(self, rig: Rig) -> Sequence[Compliance]:
        slot = bearing(self.axis or rig.axis_names[0])
        bends = {a: self.value(f"bend_{a}") for a in "xyz" if f"bend_{a}" in self.values}
        return [Compliance(slot, a, bend) for a, bend in bends.items()]


class BaseLoadCompliance(_OfModel):
    row_wise = True
    id = "base_load_compliance"
    title = "the base tilts under the load moment"
    parameters = (
        Parameter("bend_east", "arcsec_N_m", SPRING),
        Parameter("bend_north", "arcsec_N_m", SPRING),
    )
    physics = "The base and what it stands on give way to the moment of all that moves on it."
    equation = "R_base gains Rx(bend_east M_east) Ry(bend_north M_north), M about the base's origin"
    source = "elastic foundation: tilt in proportion to the moment"
    excited_by = "poses in which the moment on the base differs"
    look = "a tilt of the base that follows the load moment, whatever the angles"
    follows = "load moment"

    def turns(self, slot: str, context: Context) -> Sequence[Turn]:
        if slot != "base" or self.is_identity or context.rig.kind.chain is None:
            return ()

        def level(angles: dict[str, Array]) -> Array:
            return _moment(BASE, angles, context)[:, :2]

        return _bends([self.value("bend_east"), self.value("bend_north")], level, context)

    def compliances(self, rig: Rig) -> Sequence[Compliance]:
        names = {"x": "bend_east", "y": "bend_north"}
        return [Compliance("base", a, self.value(n)) for a, n in names.items() if n in self.values]


def _moment(axis: str, angles: dict[str, Array], context: Context) -> Array:
    """Moment of the weight of all that an axis carries, in its link's frame, N m, (n, 3). angles:
    rad, (n,) each.
    """
    chain = context.rig.kind.chain
    assert chain is not None
    return chain.moments(angles, context.gravity)[axis]


def _bends(
    sizes: Sequence[float], moment: Callable[[dict[str, Array]], Array], context: Context
) -> Sequence[Turn]:
    """Turns about coordinate axes in proportion to a moment that follows the angles, N m, (n, k).

    Rate and acceleration are central differences along the motion of each row.
    """
    n = len(context.drive.time)
    jets = {name: _rows(jet, n) for name, jet in context.axes.items()}
    moving = np.any([(jet.v != 0) | (jet.a != 0) for jet in jets.values()], axis=0)
    here = moment(_moved(jets, np.ones(n, bool), 0.0))
    rate, change = np.zeros_like(here), np.zeros_like(here)
    if moving.any():
        earlier, later = (moment(_moved(jets, moving, by)) for by in (-MOMENT, MOMENT))
        rate[moving] = (later - earlier) / (2 * MOMENT)
        change[moving] = (later - 2 * here[moving] + earlier) / MOMENT**2
    return tuple(
        Turn(axis, Jet(size * here[:, i], size * rate[:, i], size * change[:, i]))
        for i, (axis, size) in enumerate(zip("xyz", sizes, strict=False))
        if size
    )


def _rows(jet: Jet, n: int) -> Jet:
    """A jet with a value for each row, (n,)."""
    return Jet(*(np.broadcast_to(part, n) for part in (jet.x, jet.v, jet.a)))


def _moved(jets: Mapping[str, Jet], rows: Mask, by: float) -> dict[str, Array]:
    """The angles of some rows a time ``by`` from now, s, were the accelerations to stay: rad, (m,)
    each.
    """
    return {
        name: np.asarray(jet.x + by * (jet.v + by / 2 * jet.a))[rows] for name, jet in jets.items()
    }
