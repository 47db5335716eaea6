"""Errors of an accelerometer triad or inclinometer that follow the specific force (IEEE 1293 model
equation).

Axis i is the input axis, the next two cyclically are pendulous (p) and output (o). Coefficients act
on f in g.
"""

from abc import abstractmethod

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import G0
from tiltcal.effects.base import TermEffect
from tiltcal.effects.parameter import Parameter
from tiltcal.effects.sense import ACCELEROMETERS, Sense
from tiltcal.effects.spans import CoordinateRanges
from tiltcal.effects.traits import Family

WIDTH = Parameter("width", "unitless", (0.2, 0.2, 0.2), positive=True, shape=True)
"""In g, of the curve about zero force; 0: sharp."""
WIDTHS = (0.0, 0.03, 0.06, 0.12)


class AccTerm(TermEffect):
    """A term of the model equation: one coefficient an axis, named ``<stem>_<axis>``."""

    row_wise = True
    stage = "sensor"
    kinds = ACCELEROMETERS
    order = 10
    source = "IEEE 1293; Physics: Accelerometers and inclinometers"

    def term(self, name: str, sense: Sense) -> tuple[int, Array]:
        axis = name[-1]
        i = "xyz".index(axis)
        f = sense.force
        return self.channel_of(axis, sense), self.column(
            f[:, i], f[:, (i + 1) % 3], f[:, (i + 2) % 3]
        )

    @abstractmethod
    def column(self, fi: Array, fp: Array, fo: Array) -> Array:
        """Reading per unit coefficient, from the force along input, pendulous and output axis,
        m/s2. (n,) each.
        """


class AccBias(AccTerm):
    id = "acc_bias"
    title = "bias K0"
    parameters = (Parameter("bias_{axis}", "ug", (4000, 25000, 60000)),)
    physics = "The reading at zero input: electrode and suspension asymmetry, electronics offset."
    equation = "reading_i += b_i"
    excited_by = "any pose"
    look = "a constant on its channel"
    calibration_term = "bias"
    ordinary = True

    def column(self, fi: Array, fp: Array, fo: Array) -> Array:
        return np.ones_like(fi)


class AccScale(AccTerm):
    id = "acc_scale"
    title = "scale factor K1"
    parameters = (Parameter("scale_{axis}", "ppm", (300, 10000, 30000)),)
    physics = "The slope of the reading against its input."
    equation = "reading_i += S_i f_i"
    excited_by = "tilting the axis"
    look = "proportional to its own force"
    calibration_term = "scale"
    ordinary = True

    def column(self, fi: Array, fp: Array, fo: Array) -> Array:
        return fi


class AccCrossAxis(TermEffect):
    row_wise = True
    id = "acc_cross_axis"
    stage = "sensor"
    kinds = ACCELEROMETERS
    order = 10
    title = "cross-axis sensitivity and non-orthogonality"
    parameters = (Parameter("cross_{pair}", "ppm", (2000, 10000, 20000)),)
    physics = "Sensing axes are not orthogonal, or are misaligned with the body's frame."
    equation = "reading_i += C_ij f_j"
    source = "IEEE 1293; Geist et al. 2017; Physics: Accelerometers and inclinometers"
    excited_by = "tilting the other axis"
    look = "first harmonics of the other axes; the antisymmetric part is a mounting rotation"
    calibration_term = "cross_axis"
    ordinary = True
    # x is the accelerometer's own x, and its y has no part along z
    frame_convention = ("cross_xy", "cross_xz", "cross_yz")

    def term(self, name: str, sense: Sense) -> tuple[int, Array]:
        return self.channel_of(name[-2], sense), sense.force[:, "xyz".index(name[-1])]


class AccK2(AccTerm):
    id = "acc_K2"
    title = "second-order non-linearity"
    parameters = (Parameter("k2_{axis}", "ug_g2", (30, 500, 5000)),)
    physics = (
        "Electrostatic or pendulum stiffness that changes with deflection; rectifies vibration."
    )
    equation = "reading_i += K2_i f_i^2 (g)"
    excited_by = "both signs of its own force"
    look = "constant and second harmonic; the norm gains first and third"
    ordinary = True
    family = Family(reading=("input",))
    distinguished_by = {
        "table_encoder_eccentricity": "compare the norm of all three axes: only K2 changes it"
    }

    def column(self, fi: Array, fp: Array, fo: Array) -> Array:
        return fi * fi / G0


class AccK3(AccTerm):
    id = "acc_K3"
    title = "third-order non-linearity"
    parameters = (Parameter("k3_{axis}", "ug_g3", (10, 200, 1000)),)
    physics = "Odd curvature of the transfer function."
    equation = "reading_i += K3_i f_i^3 (g)"
    excited_by = "at least eight angles of its own axis"
    look = "first and third harmonics; six positions hide it in the scale factor"
    ordinary = True
    family = Family(reading=("input",))
    distinguished_by = {"acc_Koq": "nothing within 1 g: a centrifuge"}

    def column(self, fi: Array, fp: Array, fo: Array) -> Array:
        return fi * fi * fi / G0**2


class AccKoq(AccTerm):
    id = "acc_Koq"
    title = "odd quadratic non-linearity"
    parameters = (Parameter("koq_{axis}", "ug_g2", (10, 200, 1000)),)
    physics = "A quadratic of opposite sign for opposite input."
    equation = "reading_i += Koq_i f_i |f_i| (g)"
    excited_by = "a dense sweep of its own axis"
    look = "as K3 (cosine 0.99 within 1 g)"
    family = Family(reading=("input",))

    def column(self, fi: Array, fp: Array, fo: Array) -> Array:
        return fi * np.abs(fi) / G0


class AccScaleAsym(AccTerm):
    id = "acc_scale_asym"
    title = "scale factor differs by sign"
    parameters = (Parameter("scale_asym_{axis}", "ppm", (20, 500, 1000)), WIDTH)
    physics = "Two halves of a differential capacitor or torquer differ."
    equation = "reading_i += a_i/2 |f_i|, the kink as wide as given: sqrt(f_i^2 + width^2)"
    excited_by = "both signs of its own force"
    look = "a kink at zero; near K2"
    family = Family(reading=("input",))

    @classmethod
    def shapes(cls, span: CoordinateRanges) -> list[dict[str, float]]:
        return [{"width": w} for w in WIDTHS]

    def column(self, fi: Array, fp: Array, fo: Array) -> Array:
        return np.hypot(fi, self.value("width") * G0) / 2


class AccBiasAsym(AccTerm):
    id = "acc_bias_asym"
    sharp = True
    title = "dead zone, sign-dependent bias"
    parameters = (Parameter("bias_asym_{axis}", "ug", (5, 200, 1000)), WIDTH)
    physics = "A loop that does not regulate about zero jumps with the sign of its input."
    equation = "reading_i += b_i/2 sign(f_i), the step as wide as given: tanh(f_i / width)"
    excited_by = "crossing zero force"
    look = "a step at zero force"
    family = Family(reading=("input",))

    @classmethod
    def shapes(cls, span: CoordinateRanges) -> list[dict[str, float]]:
        return [{"width": w} for w in WIDTHS]

    def column(self, fi: Array, fp: Array, fo: Array) -> Array:
        width = self.value("width") * G0
        return (np.tanh(fi / width) if width > 0 else np.sign(fi)) / 2


class AccKip(AccTerm):
    id = "acc_Kip"
    title = "product of input and pendulous axis"
    parameters = (Parameter("kip_{axis}", "ug_g2", (20, 500, 5000)),)
    physics = "Cross-coupling of a pendulum deflected by its input."
    equation = "reading_i += Kip_i f_i f_(i+1) (g)"
    excited_by = "both axes loaded at once (45 deg)"
    look = "second harmonics; invisible in six positions"
    ordinary = True

    def column(self, fi: Array, fp: Array, fo: Array) -> Array:
        return fi * fp / G0


class AccKio(AccTerm):
    id = "acc_Kio"
    title = "product of input and output axis"
    parameters = (Parameter("kio_{axis}", "ug_g2", (20, 500, 5000)),)
    physics = "Cross-coupling through the hinge's compliance along the output axis."
    equation = "reading_i += Kio_i f_i f_(i+2) (g)"
    excited_by = "both axes loaded at once (45 deg)"
    look = "second harmonics; invisible in six positions"
    ordinary = True

    def column(self, fi: Array, fp: Array, fo: Array) -> Array:
        return fi * fo / G0


class AccKpo(AccTerm):
    id = "acc_Kpo"
    title = "product of pendulous and output axis"
    parameters = (Parameter("kpo_{axis}", "ug_g2", (20, 500, 5000)),)
    physics = "Cross-coupling of the two axes across the input."
    equation = "reading_i += Kpo_i f_(i+1) f_(i+2) (g)"
    excited_by = "the two other axes loaded at once"
    look = "second harmonic of the other two axes; near an axis wobble"
    ordinary = True

    def column(self, fi: Array, fp: Array, fo: Array) -> Array:
        return fp * fo / G0
