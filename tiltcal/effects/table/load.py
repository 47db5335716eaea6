"""What gives way under the load that a user's own model carries, its joints, its links and its
base; and what it carries.
"""

from collections.abc import Sequence
from dataclasses import replace

from tiltcal.core.frames import rotation
from tiltcal.core.units import DEG
from tiltcal.effects.base import FrameEffect
from tiltcal.effects.loads import LoadEffect
from tiltcal.effects.mechanisms import Compliance, Context, Turn
from tiltcal.effects.parameter import Parameter
from tiltcal.setup.chain import BASE
from tiltcal.setup.loads import Mass
from tiltcal.setup.setup import Rig
from tiltcal.setup.tables import bearing
from tiltcal.setup.trajectory import Jet

TILT = tuple(Parameter(f"tilt_{a}", "arcsec", (5, 60, 1800)) for a in "xy")
SPRING = (0.05, 2.0, 20.0)  # arcsec per N m: 4 to 0.01 MN m/rad


class _OfModel(FrameEffect):
    """Needs the links of a model."""

    stage = "table"
    linear = True
    of_model = True
    on_slides = True


class JointAxisTilt(_OfModel):
    row_wise = True
    id = "joint_axis_tilt"
    title = "axis of a joint not where the model has it"
    parameters = TILT
    axis_wise = True
    physics = (
        "A joint turns about, or slides along, an axis that is tilted against the model's. At the"
        " model's reference, of a slide at readout zero, all that it carries stands where the model"
        " has it."
    )
    equation = (
        "the joint's rotation R becomes T R R0^T T^-1 R0, T = Rx(tilt_x) Ry(tilt_y) in the joint's"
        " frame, R0 at the reference"
    )
    source = "Hayati and Mirmirani 1985; Physics: Joints and links"
    excited_by = "that joint turning"
    look = "a tilt that grows as the joint leaves the model's reference"
    distinguished_by = {"link_tilt": "that joint and the next one turning over a wide range"}

    def turns(self, slot: str, context: Context) -> Sequence[Turn]:
        axis, chain = self.axis or context.rig.axis_names[0], context.rig.kind.chain
        if chain is None or slot not in (axis, bearing(axis)):
            return ()
        x, y = self.value("tilt_x"), self.value("tilt_y")
        if slot == bearing(axis):
            return Turn("x", Jet(x)), Turn("y", Jet(y))
        from scipy.spatial.transform import Rotation

        there = rotation("z", chain.links[axis].reference_deg * DEG)
        back = there.T @ rotation("y", -y) @ rotation("x", -x) @ there
        angles = Rotation.from_matrix(back).as_euler("YXZ")
        return tuple(Turn(a, Jet(float(angle))) for a, angle in zip("yxz", angles, strict=True))


class LinkTilt(_OfModel):
    row_wise = True
    id = "link_tilt"
    title = "a joint stands tilted on the link before it"
    parameters = TILT
    axis_wise = True
    physics = (
        "Two joints are not at the angle to each other that the model states, and all that follows"
        " is turned."
    )
    equation = "Rx(tilt_x) Ry(tilt_y) between a link and the next joint, in the joint's frame"
    source = "Hayati and Mirmirani 1985; Physics: Joints and links"
    excited_by = "the joint before it turning"
    look = "a tilt that turns with the joint before"

    def turns(self, slot: str, context: Context) -> Sequence[Turn]:
        if slot != bearing(self.axis or context.rig.axis_names[0]):
            return ()
        return Turn("x", Jet(self.value("tilt_x"))), Turn("y", Jet(self.value("tilt_y")))


class JointCompliance(_OfModel):
    rows_apart = True
    id = "joint_compliance"
    title = "a joint bends under its load"
    parameters = tuple(Parameter(f"bend_{a}", "arcsec_N_m", SPRING) for a in "xyz")
    axis_wise = True
    physics = (
        "Gearbox and bearing of a joint give way to the moment of all that they carry, of its"
        " weight and of its inertia."
    )
    equation = (
        "rotation bend_i M_i about the axes of the joint's frame before it turns; z is its axis"
    )
    source = "Dumas et al. 2011; Physics: Joints and links"
    excited_by = "poses in which the load on the joint differs"
    look = "a rotation that follows the load moment of the joint, whatever the angles"
    follows = "load moment"

    def turns(self, slot: str, context: Context) -> Sequence[Turn]:
        own = bearing(self.axis or context.rig.axis_names[0])
        if slot != own or self.is_identity or context.rig.kind.chain is None:
            return ()
        return _bends([self.value(f"bend_{a}") for a in "xyz"], context.loads.along(slot))

    def compliances(self, rig: Rig) -> Sequence[Compliance]:
        return _springs(self, bearing(self.axis or rig.axis_names[0]), "xyz")


class LinkCompliance(_OfModel):
    rows_apart = True
    id = "link_compliance"
    title = "a link bends under its load"
    parameters = tuple(Parameter(f"bend_{a}", "arcsec_N_m", SPRING) for a in "xy")
    axis_wise = True
    physics = (
        "What stands on a joint gives way to the moment of all that hangs on it, across the joint's"
        " axis: it bends in directions that turn with the joint. About that axis a link and its"
        " joint bend alike (joint_compliance)."
    )
    equation = "rotation bend_i M_i about x and y of the link's frame, which turns with the joint"
    source = "Klimchik et al. 2013; Physics: Joints and links"
    excited_by = "that joint turning over a wide range, in poses in which its load differs"
    look = "a rotation that follows the load moment in a frame that turns with the joint"
    follows = "load moment"
    distinguished_by = {JointCompliance.id: "that joint turning over a wide range"}

    def turns(self, slot: str, context: Context) -> Sequence[Turn]:
        own = self.axis or context.rig.axis_names[0]
        if slot != own or self.is_identity or context.rig.kind.chain is None:
            return ()
        return _bends([self.value(f"bend_{a}") for a in "xy"], context.loads.along(slot))

    def compliances(self, rig: Rig) -> Sequence[Compliance]:
        return _springs(self, self.axis or rig.axis_names[0], "xy")


class BaseLoadCompliance(_OfModel):
    rows_apart = True
    id = "base_load_compliance"
    title = "the base tilts under the load moment"
    parameters = (
        Parameter("bend_east", "arcsec_N_m", SPRING),
        Parameter("bend_north", "arcsec_N_m", SPRING),
        Parameter("cross_east", "arcsec_N_m", SPRING),
        Parameter("cross_north", "arcsec_N_m", SPRING),
    )
    physics = (
        "The base and what it stands on give way to the moment of all that moves on it, of its"
        " weight and of its inertia. Where it is softest about a direction between East and North,"
        " a moment about one of them tilts it about the other too; of an elastic base both cross"
        " terms are the same (Maxwell 1864)."
    )
    equation = (
        "R_base gains Rx(bend_east M_east + cross_east M_north) Ry(cross_north M_east + bend_north"
        " M_north), M about the base's origin"
    )
    source = "Physics: Joints and links"
    excited_by = "poses in which the moment on the base differs"
    look = "a tilt of the base that follows the load moment, whatever the angles"
    follows = "load moment"

    def turns(self, slot: str, context: Context) -> Sequence[Turn]:
        if slot != "base" or self.is_identity or context.rig.kind.chain is None:
            return ()
        east, north, _ = context.loads.along(BASE)
        about_east = east.scaled(self.value("bend_east")) + north.scaled(self.value("cross_east"))
        about_north = east.scaled(self.value("cross_north"))
        about_north = about_north + north.scaled(self.value("bend_north"))
        return Turn("x", about_east), Turn("y", about_north)

    def compliances(self, rig: Rig) -> Sequence[Compliance]:
        if self.value("cross_east") or self.value("cross_north"):
            return ()  # no springs about East and North alone: prescribed
        names = {"x": "bend_east", "y": "bend_north"}
        return [Compliance("base", a, self.value(n)) for a, n in names.items() if n in self.values]


def _bends(sizes: Sequence[float], moment: Sequence[Jet]) -> Sequence[Turn]:
    """Turns about coordinate axes in proportion to a moment, N m."""
    bends = zip("xyz", sizes, moment, strict=False)
    return tuple(Turn(axis, jet.scaled(size)) for axis, size, jet in bends if size)


def _springs(effect: FrameEffect, slot: str, axes: str) -> Sequence[Compliance]:
    """The sizes ``bend_<axis>`` of an effect as springs of a frame."""
    names = {axis: f"bend_{axis}" for axis in axes}
    return [Compliance(slot, a, effect.value(n)) for a, n in names.items() if n in effect.values]


NO_MASS = 1.0
"""kg, of which a first moment is made where a link has no mass."""
ARM_MM = 100.0
"""mm, of a rated payload from the centre of the link that carries it: makers' payload diagrams give
the full load as far as 100 to 300 mm from the flange."""


class Payload(LoadEffect):
    rows_apart = True
    stage = "table"
    linear = True
    of_model = True
    axis_wise = True
    on_slides = True
    id = "payload"
    title = "a link carries another mass than the model's"
    parameters = (
        Parameter("mass", "kg", (0.1, 0.5, 2)),
        *(Parameter(f"com_{a}", "mm", (2, 10, 50), restates=True) for a in "xyz"),
        *(Parameter(f"moment_{a}", "kg_mm", (2, 50, 200)) for a in "xyz"),
    )
    physics = (
        "A link is heavier than the model states, and its centre of mass lies elsewhere: the load"
        " of all joints that carry it is another, and what bends under it bends otherwise."
    )
    equation = (
        "mass of the link + mass, its first moment about its own centre + moment in the link's"
        " frame; or its centre + com, moment = com (mass of the link + mass); seen through"
        " joint_compliance, link_compliance and base_load_compliance alone"
    )
    source = "Khalil and Dombre 2002; Physics: Joints and links"
    excited_by = "poses in which the load of a joint or base that bends differs"
    look = "a known bend that follows another load than the model's"
    follows = "load moment"
    distinguished_by = {
        JointCompliance.id: "the same poses without the payload",
        LinkCompliance.id: "the same poses without the payload",
        BaseLoadCompliance.id: "the same poses without the payload",
    }

    def masses(self, rig: Rig) -> Sequence[Mass]:
        if rig.kind.chain is None or self.is_identity:
            return ()
        link = rig.kind.chain.links[self.axis or rig.axis_names[0]]
        mass, (x, y, z) = self.value("mass"), link.centre_m
        total = link.mass_kg + mass
        carrying = total if total > 0 else NO_MASS
        shift = [
            (total * self.value(f"com_{a}") + self.value(f"moment_{a}")) / carrying for a in "xyz"
        ]
        there = (x + shift[0], y + shift[1], z + shift[2])
        return (
            Mass(link.axis, mass, link.centre_m),
            Mass(link.axis, carrying, there),
            Mass(link.axis, -carrying, link.centre_m),
        )

    @classmethod
    def sizes_on(cls, channels: Sequence[str], rig: Rig) -> dict[str, Parameter]:
        found = super().sizes_on(channels, rig)
        rated = rig.rated_payload_kg
        if rated is None:
            return found
        largest = {
            name: rated * (ARM_MM if p.unit == "kg_mm" else 1.0) for name, p in found.items()
        }
        return {
            name: replace(p, plausible=(largest[name] / 10, largest[name] / 2, largest[name]))
            for name, p in found.items()
        }
