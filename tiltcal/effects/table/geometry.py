"""Axes that are not where they should be: levelling, wobble, non-orthogonality."""

from collections.abc import Sequence

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.effects.base import FrameEffect, LinkEffect
from tiltcal.effects.mechanisms import Context, Turn
from tiltcal.effects.parameter import Parameter, PerTable
from tiltcal.effects.spans import CoordinateRanges
from tiltcal.effects.traits import Family
from tiltcal.setup.setup import Rig
from tiltcal.setup.tables import bearing
from tiltcal.setup.trajectory import Jet


class TableLevelling(FrameEffect):
    row_wise = True
    id = "table_levelling"
    stage = "table"
    title = "base of the table is not level"
    parameters = (
        Parameter("tilt_east", "arcsec", (5, 60, 3600)),
        Parameter("tilt_north", "arcsec", (5, 60, 3600)),
    )
    physics = "The base stands on its feet with a tilt about East and one about North."
    equation = "R_base = Rx(east) Ry(north)"
    source = "IEEE 1554; Physics: Table mechanics"
    excited_by = "a turn about a vertical axis"
    look = (
        "on a vertical axis once per turn in both channels; on a horizontal one a constant and the"
        " encoder's zero"
    )
    linear = True
    ordinary = True

    def turns(self, slot: str, context: Context) -> Sequence[Turn]:
        if slot != "base":
            return ()
        return Turn("x", Jet(self.value("tilt_east"))), Turn("y", Jet(self.value("tilt_north")))


class AxisNonorthogonality(FrameEffect):
    row_wise = True
    id = "axis_nonorthogonality"
    stage = "table"
    title = "table axes are not perpendicular"
    parameters = PerTable(
        lambda table: tuple(f"{a}_{b}" for a, b, _ in table.joints), "arcsec", (5, 60, 1800)
    )
    physics = "Successive axes were bored a little off square."
    equation = (
        "R(e) between successive axes, about the perpendicular of both; dual: Ry; three: Rx after"
        " outer, Rz after middle"
    )
    source = "Geist and Gaitan 2022; Physics: Table mechanics"
    excited_by = "both angles changing"
    look = "product of both angles; invisible on one axis"
    linear = True
    ordinary = True
    follows = "table_{innermost}"

    def turns(self, slot: str, context: Context) -> Sequence[Turn]:
        return tuple(
            Turn(about, Jet(self.value(f"{a}_{b}")))
            for a, b, about in context.rig.kind.joints
            if slot == bearing(b)
        )


class AxisWobble(FrameEffect):
    row_wise = True
    id = "table_axis_wobble"
    stage = "table"
    title = "synchronous tilt of the rotation axis"
    parameters = tuple(
        Parameter(n, "arcsec", (1, 10, 100)) for n in ("m1c", "m1s", "p2c", "p2s", "m2c", "m2s")
    )
    axis_wise = True
    physics = "Bearing races that are not round tilt the axis as it turns, the same way every turn."
    equation = (
        "stator-frame rotation vector (c + i s) exp(i n a), n = -1, +2, -2, along the next two axes"
        " cyclically"
    )
    source = "ISO 230-7; Physics: Table mechanics"
    excited_by = "a full turn"
    look = (
        "on a vertical axis the sensor sees orders -2, +1, -3; n = +1 would be the mounting and is"
        " left out"
    )
    linear = True
    ORDERS = (("m1", -1), ("p2", 2), ("m2", -2))
    ordinary = True
    family = Family(tilt=(("{axis}_bearing", "table_{axis}"),))

    def turns(self, slot: str, context: Context) -> Sequence[Turn]:
        axis = self.axis or context.rig.axis_names[0]
        if slot != bearing(axis):
            return ()
        angle = context.axes[axis]
        real, imaginary = Jet(0.0), Jet(0.0)
        for name, n in self.ORDERS:
            c, s = self.value(f"{name}c"), self.value(f"{name}s")
            if c or s:
                real = real + angle.harmonic(n, c, -s)  # Re[(c + i s)(cos na + i sin na)]
                imaginary = imaginary + angle.harmonic(n, s, c)
        i = "xyz".index(dict(context.rig.axes)[axis])
        return Turn("xyz"[(i + 1) % 3], real), Turn("xyz"[(i + 2) % 3], imaginary)


class WobbleAsync(FrameEffect):
    id = "table_wobble_async"
    stage = "table"
    title = "non-repeating bearing wobble"
    parameters = (
        Parameter("cos", "arcsec", (0.5, 5, 20)),
        Parameter("sin", "arcsec", (0.5, 5, 20)),
        Parameter("ratio", "unitless", (0.43, 0.43, 0.43), positive=True, default=0.43),
    )
    axis_wise = True
    physics = (
        "The ball cage turns at less than half the axis' rate: the tilt of the axis does not close"
        " after a turn."
    )
    equation = (
        "stator-frame rotation vector (c + i s) exp(i r a), r turns of the cage a turn of the axis"
    )
    source = "ISO 230-7; Physics: Table mechanics"
    excited_by = "several turns"
    look = "a wobble that differs from turn to turn and repeats with the cage"

    @classmethod
    def shapes(cls, span: CoordinateRanges) -> list[dict[str, float]]:
        return [{"ratio": r} for r in (0.38, 0.4, 0.42, 0.44, 0.46, 0.48)]

    def turns(self, slot: str, context: Context) -> Sequence[Turn]:
        axis = self.axis or context.rig.axis_names[0]
        if slot != bearing(axis):
            return ()
        angle, r, c, s = (
            context.axes[axis],
            self.value("ratio"),
            self.value("cos"),
            self.value("sin"),
        )
        i = "xyz".index(dict(context.rig.axes)[axis])
        return Turn("xyz"[(i + 1) % 3], angle.harmonic(r, c, -s)), Turn(
            "xyz"[(i + 2) % 3], angle.harmonic(r, s, c)
        )


class AxisNonintersection(LinkEffect):
    row_wise = True
    id = "axis_nonintersection"
    needs = "motion"
    stage = "table"
    title = "table axes do not intersect"
    parameters = (Parameter("offset", "mm", (0.5, 5, 5)),)
    physics = (
        "The inner axes do not meet the outer one: a lever arm that depends on which axis turns."
    )
    equation = (
        "inner axes displaced along the perpendicular of the first two: dual along y, three along"
        " x, of the outer stage"
    )
    source = "Physics: Table mechanics"
    excited_by = "turning the outer axis"
    look = "centripetal and tangential, as a lever arm, but fixed to the outer stage"
    linear = True

    def offset(self, slot: str, rig: Rig) -> Array:
        r = np.zeros(3)
        for _, inner, along in rig.kind.joints[:1]:
            r["xyz".index(along)] = self.value("offset") if slot == bearing(inner) else 0.0
        return r
