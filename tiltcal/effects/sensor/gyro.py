"""Errors of gyro triads and fibre-optic gyros that follow rate and force (IEEE 1431, 952)."""

from abc import abstractmethod

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import G0
from tiltcal.effects.base import RowWiseTerm, SignalEffect, TermEffect
from tiltcal.effects.hysteresis_and_lag import vibration_power
from tiltcal.effects.parameter import Parameter
from tiltcal.effects.sense import Sense
from tiltcal.effects.sensor.environmental import GYROS, FollowsTemperature, FollowsWarming
from tiltcal.effects.traits import Family

TRIAD = frozenset({"gyro"})
FOG = frozenset({"fog"})


class GyrTerm(RowWiseTerm):
    """One coefficient an axis that acts on the axis' own rate."""

    stage = "sensor"
    kinds = TRIAD
    order = 10
    source = "IEEE 1431; Physics: Gyroscopes and FOGs"

    def term(self, name: str, sense: Sense) -> tuple[int, Array]:
        channel = self.channel_of(name[-1], sense)
        return channel, self.column(sense.true_input()[:, max(channel, 0)])

    @abstractmethod
    def column(self, w: Array) -> Array:
        """Reading per unit coefficient from the rate along the axis, rad/s, (n,) each."""


class GyrBias(GyrTerm):
    id = "gyr_bias"
    title = "bias"
    parameters = (Parameter("bias_{axis}", "deg_s", (0.001, 0.5, 1.0)),)
    physics = "The reading at rest."
    equation = "reading_i += b_i"
    excited_by = "any recording"
    look = "a constant"
    calibration_term = "bias"
    ordinary = True

    def column(self, w: Array) -> Array:
        return np.ones_like(w)


class GyrScale(GyrTerm):
    id = "gyr_scale"
    title = "scale factor"
    parameters = (Parameter("scale_{axis}", "ppm", (500, 10000, 20000)),)
    physics = "The slope of the reading against its rate."
    equation = "reading_i += S_i w_i"
    excited_by = "turning about the axis"
    look = "proportional to its own rate"
    calibration_term = "scale"
    ordinary = True

    def column(self, w: Array) -> Array:
        return w


class GyrScaleAsym(GyrTerm):
    id = "gyr_scale_asym"
    title = "scale factor differs by sign"
    parameters = (Parameter("scale_asym_{axis}", "ppm", (50, 1000, 6000)),)
    physics = "The slope differs between clockwise and counter-clockwise."
    equation = "reading_i += a_i/2 |w_i|"
    excited_by = "turns both ways"
    look = "even in the rate"
    family = Family(reading=("input",))
    follows = "rate"

    def column(self, w: Array) -> Array:
        return np.abs(w) / 2


class GyrNonlinearity(GyrTerm):
    id = "gyr_nonlinearity"
    needs = "motion"
    title = "cubic of rate"
    parameters = (Parameter("cubic_{axis}", "ppm_rad2_s2", (100, 1000, 3000)),)
    physics = "The slope changes with the size of the rate."
    equation = "reading_i += c_i w_i^3"
    excited_by = "turns at several rates"
    look = "odd in the rate, beyond a straight line"
    family = Family(reading=("input",))

    def column(self, w: Array) -> Array:
        return w**3


class FogBias(GyrBias):
    id = "fog_bias"
    source = "IEEE 952; Physics: Gyroscopes and FOGs"
    kinds = FOG
    parameters = (Parameter("bias_{axis}", "deg_h", (0.1, 5, 20)),)


class FogScale(GyrScale):
    id = "fog_scale"
    source = "IEEE 952; Physics: Gyroscopes and FOGs"
    kinds = FOG
    parameters = (Parameter("scale_{axis}", "ppm", (10, 500, 1000)),)


class GyrMisalignment(RowWiseTerm):
    id = "gyr_misalignment"
    stage = "sensor"
    kinds = TRIAD
    order = 10
    title = "cross-axis"
    parameters = (Parameter("cross_{pair}", "ppm", (500, 10000, 20000)),)
    physics = "Input axes are misaligned with the body's frame."
    equation = "reading_i += C_ij w_j"
    source = "IEEE 1431; Physics: Gyroscopes and FOGs"
    excited_by = "turning about another axis"
    look = "rate on the axes that are not turned"
    linear = True
    calibration_term = "cross_axis"
    ordinary = True

    def term(self, name: str, sense: Sense) -> tuple[int, Array]:
        return self.channel_of(name[-2], sense), sense.rate[:, "xyz".index(name[-1])]


class GyrGsens(RowWiseTerm):
    id = "gyr_gsens"
    stage = "sensor"
    kinds = GYROS
    order = 10
    title = "bias proportional to specific force"
    parameters = (Parameter("gsens_{matrix}", "deg_h_g", (10, 60, 360)),)
    physics = "Gravity deflects the vibrating mass; the bias depends on the pose."
    equation = "reading_i += G_ij f_j (g)"
    source = "IEEE 1431; Physics: Gyroscopes and FOGs"
    excited_by = "dwell in several poses"
    look = "static bias follows the pose; integrates to zero over a full turn"
    linear = True
    ordinary = True
    family = Family(reading=("force_x", "force_y", "force_z"), effects=("gyr_g2sens",))

    def term(self, name: str, sense: Sense) -> tuple[int, Array]:
        return self.channel_of(name[-2], sense), sense.force[:, "xyz".index(name[-1])] / G0


class GyrG2sens(RowWiseTerm):
    id = "gyr_g2sens"
    stage = "sensor"
    kinds = GYROS
    order = 10
    title = "bias quadratic in specific force"
    parameters = (Parameter("g2sens_{matrix}", "deg_h_g2", (1, 10, 60)),)
    physics = "Anisoelastic deflection: two load directions at once turn the drive mode."
    equation = "reading_i += G2_ij f_j^2 (g)"
    source = "IEEE 1431; Physics: Gyroscopes and FOGs"
    excited_by = "dwell in several poses"
    look = "even in the force, second harmonic over a turn"
    linear = True
    family = Family(reading=("force_x", "force_y", "force_z"))
    products_of = "force"

    def term(self, name: str, sense: Sense) -> tuple[int, Array]:
        f = sense.force[:, "xyz".index(name[-1])] / G0
        return self.channel_of(name[-2], sense), f * f


class GyrVre(TermEffect):
    id = "gyr_vre"
    needs = "vibration"
    stage = "sensor"
    kinds = GYROS
    order = 25
    title = "vibration rectification"
    parameters = (Parameter("vre_{axis}", "deg_h_g2", (10, 300, 3000)),)
    physics = "Vibration at the sense mode is rectified into a rate."
    equation = (
        "reading_i += k_i <a^2> (g), the mean square over 1 s of what is faster than 0.25 s, all"
        " axes"
    )
    source = "IEEE 1431; Physics: Gyroscopes and FOGs"
    excited_by = "vibration of changing size"
    look = "the bias follows the square of the vibration"
    linear = True

    def term(self, name: str, sense: Sense) -> tuple[int, Array]:
        total = sum(
            (vibration_power(sense.force[:, j], sense.rate_hz) for j in range(3)),
            np.zeros(len(sense.time)),
        )
        return self.channel_of(name[-1], sense), total


class GyrTemp(FollowsTemperature):
    id = "gyr_temp"
    needs = "temperature"
    kinds = GYROS
    title = "bias against temperature"
    parameters = (Parameter("temp_bias_{axis}", "deg_s_degC", (1e-5, 0.005, 0.05)),)
    physics = "The resonator and its electronics drift with temperature."
    equation = "reading_i += k_i (T - T0)"
    source = "IEEE 1431; Physics: Gyroscopes and FOGs"
    excited_by = "a temperature change"
    look = "follows the temperature record, the same in every pose"
    ordinary = True
    family = Family(reading=("temperature",))
    lags_thermometer = True


class FogShupe(FollowsWarming):
    id = "fog_shupe"
    needs = "temperature"
    kinds = FOG
    title = "bias proportional to dT/dt"
    parameters = (Parameter("shupe_{axis}", "deg_h_s_degC", (10, 100, 1000)),)
    physics = "A temperature gradient along the coil is not reciprocal (Shupe)."
    equation = "reading += k dT/dt"
    source = "Shupe 1980; Physics: Gyroscopes and FOGs"
    excited_by = "a temperature ramp"
    look = "changes sign between heating and cooling"
    family = Family(reading=("warming",))
    lags_thermometer = True


class FogAxisError(RowWiseTerm):
    id = "fog_axis_error"
    stage = "sensor"
    kinds = FOG
    order = 10
    title = "input axis not where assumed"
    parameters = (
        Parameter("axis_u", "arcsec", (60, 400, 1800)),
        Parameter("axis_v", "arcsec", (60, 400, 1800)),
    )
    physics = "The coil's normal leans against the stated input axis."
    equation = "input axis a + u b1 + v (a x b1), b1 = a x z / |a x z|"
    source = "Physics: Gyroscopes and FOGs"
    excited_by = "turning across the input axis"
    look = "transverse rate on the FOG; a field calibration takes it for scale, -du_i/u_i"
    linear = True
    ordinary = True
    follows = "rate"

    def term(self, name: str, sense: Sense) -> tuple[int, Array]:
        b1, b2 = transverse(sense.input_vector)
        return 0, np.asarray(sense.rate @ (b1 if name == "axis_u" else b2))


def transverse(a: Array) -> tuple[Array, Array]:
    """The unit vectors, (3,), across an input axis: b1 = a x z / |a x z| (x if a is z), a x b1."""
    b1 = np.cross(a, [0.0, 0.0, 1.0])
    b1 = b1 / np.linalg.norm(b1) if np.linalg.norm(b1) > 1e-9 else np.array([1.0, 0.0, 0.0])
    return b1, np.cross(a, b1)


class FogDeadband(SignalEffect):
    row_wise = True
    id = "fog_deadband"
    needs = "any"
    stage = "sensor"
    kinds = FOG
    order = 46
    title = "lock-in around zero"
    parameters = (Parameter("deadband", "deg_h", (0.1, 1, 10), positive=True),)
    physics = "Cross-talk of modulation and detection pulls a small phase to zero."
    equation = "reading = 0 where |reading| < dead band"
    source = "IEEE 952; Physics: Gyroscopes and FOGs"
    excited_by = "rates near zero"
    look = "zeros where the Earth's rate should show; variance falls"
    family = Family(reading=("input",))
    threshold = True
    follows = "rate"

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        return np.where(np.abs(reading) < self.value("deadband"), 0.0, reading)


class FogFringe(SignalEffect):
    row_wise = True
    id = "fog_fringe"
    stage = "sensor"
    kinds = FOG
    order = 47
    title = "wrap at the maximum rate"
    parameters = (Parameter("max_rate", "deg_s", (500, 200, 100), positive=True),)
    physics = "An open loop counts fringes only within +-pi of phase."
    equation = "reading wraps beyond +- the maximum rate"
    source = "Lefevre 2014; Physics: Gyroscopes and FOGs"
    excited_by = "rates beyond the maximum"
    look = "jumps by twice the maximum rate"
    threshold = True

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        limit = self.value("max_rate")
        return np.mod(reading + limit, 2 * limit) - limit if limit > 0 else reading
