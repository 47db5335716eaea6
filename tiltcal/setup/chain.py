"""The mechanics of a user's own model: links that turn about one axis each or slide along it, and
where the instrument sits among them.

Link frames have their origin on the axis and z along it. At readout zero a link stands in its
parent's frame as its ``LinkFrame`` states; the base's frame is the world's: East, North, Up.
"""

from collections.abc import Mapping
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from tiltcal.core.arrays import Array
from tiltcal.core.units import DEG, MM
from tiltcal.setup.part import StrictTable

BASE = ""
"""Parent of what stands on the base itself."""


class LinkFrame(StrictTable):
    """A frame that is fixed on a link."""

    on: str = BASE
    """Axis of the link that carries it; empty: the base."""
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Its origin, in the frame of that link, m."""
    rotation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    """Quaternion w, x, y, z that takes its components to those of the link."""

    @cached_property
    def offset(self) -> Array:
        """m, (3,)."""
        return np.array(self.offset_m)

    @cached_property
    def R(self) -> Array:
        """Components in the frame to components in the link's, (3, 3)."""
        w, x, y, z = np.array(self.rotation) / np.linalg.norm(self.rotation)
        return np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )


class Link(LinkFrame):
    """A link behind an axis."""

    axis: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]
    """Name of the axis; its readout is the column `table_<axis>_deg` or `_mm`."""
    joint: str = ""
    """Joint of the model that it was read from."""
    slides: bool = False
    """It slides along its axis instead of turning about it."""
    sign: Literal[1, -1] = 1
    """-1 where the readout counts against that joint."""
    offset_deg: float = 0.0
    """Angle of a joint that turns, at readout zero, deg."""
    offset_mm: float = 0.0
    """Position of a joint that slides, at readout zero, mm."""
    reference_deg: float = 0.0
    """Readout of a joint that turns, with the model at its reference, deg."""
    gear_ratio: Annotated[float, Field(gt=0)] | None = None
    """Turns of the motor for one of the joint; not given: unknown, or no gear."""
    range_deg: tuple[float, float] | None = None
    """Lowest and highest readout of a joint that turns, deg; not given: no limits."""
    range_mm: tuple[float, float] | None = None
    """Lowest and highest readout of a joint that slides, mm; not given: no limits."""
    mass_kg: Annotated[float, Field(ge=0)] = 0.0
    """Mass of all that moves with it, kg."""
    centre_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Centre of that mass in the link's frame, m."""
    inertia_kg_m2: tuple[float, float, float, float, float, float] = (0.0,) * 6
    """Inertia about that centre, xx, yy, zz, xy, xz, yz in the link's frame, kg m2."""
    armature_kg_m2: Annotated[float, Field(ge=0)] = 0.0
    """Inertia of the drive about the joint, kg m2; along a slide kg."""
    damping_N_m_s_rad: Annotated[float, Field(ge=0)] = 0.0
    """Damping of the joint, N m s/rad; along a slide N s/m."""
    friction_N_m: Annotated[float, Field(ge=0)] = 0.0
    """Dry friction of the joint, N m; along a slide N."""
    servo_N_m_rad: Annotated[float, Field(ge=0)] = 0.0
    """Stiffness of the servo in a run by time steps, N m/rad; along a slide N/m."""
    servo_N_m_s_rad: Annotated[float, Field(ge=0)] = 0.0
    """Damping of that servo, N m s/rad; along a slide N s/m."""

    @property
    def zero(self) -> float:
        """Angle or position of the joint at readout zero, rad or m."""
        return self.offset_mm * MM if self.slides else self.offset_deg * DEG

    @cached_property
    def inertia(self) -> Array:
        """About the centre of mass, in the link's frame, kg m2, (3, 3)."""
        xx, yy, zz, xy, xz, yz = self.inertia_kg_m2
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


class Chain(StrictTable):
    """The links, each after its parent, and the position of the instrument."""

    link: tuple[Link, ...]
    instrument: LinkFrame = LinkFrame()

    @cached_property
    def links(self) -> Mapping[str, Link]:
        """Each link by its axis."""
        return {link.axis: link for link in self.link}

    @cached_property
    def gears(self) -> tuple[float, ...]:
        """The gear ratios that are stated, each once."""
        return tuple(dict.fromkeys(link.gear_ratio for link in self.link if link.gear_ratio))

    @cached_property
    def path(self) -> tuple[str, ...]:
        """Axes that move the instrument, outermost first."""
        found: list[str] = []
        on = self.instrument.on
        while on != BASE:
            found.append(on)
            on = self.links[on].on
        return tuple(reversed(found))

    @cached_property
    def upright(self) -> frozenset[str]:
        """Axes that do not change the direction of gravity: those that slide, and those that stand
        upright when all angles are zero and no axis outside them tilts.
        """
        found = {link.axis for link in self.link if link.slides}
        R = np.eye(3)
        for name in self.path:
            R = R @ self.links[name].R
            if name not in found and abs(R[2, 2]) < 1 - 1e-12:
                break
            found.add(name)
        return frozenset(found)

    @cached_property
    def ranges(self) -> Mapping[str, tuple[float, float]]:
        """Lowest and highest readout of the axes whose joint has a range, deg, or mm of a slide."""
        ranges = {link.axis: link.range_mm if link.slides else link.range_deg for link in self.link}
        return {axis: ends for axis, ends in ranges.items() if ends is not None}

    def problem(self) -> str | None:
        """What is wrong with it; None where nothing is."""
        seen = {BASE}
        for link in self.link:
            if link.axis in seen:
                return f"two links of the axis '{link.axis}'"
            if link.on not in seen:
                return f"link '{link.axis}' on '{link.on}', which is no link before it"
            seen.add(link.axis)
        if self.instrument.on not in seen:
            return f"the instrument on '{self.instrument.on}', which is no link"
        return None
