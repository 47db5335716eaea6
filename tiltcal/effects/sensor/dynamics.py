"""Sensor effects that are no sum of terms: bandwidth, saturation, angle-dependent bias,
rectification, conversion.
"""

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import G0
from tiltcal.effects.base import SignalEffect, TermEffect
from tiltcal.effects.hysteresis_and_lag import smooth_lag, vibration_power
from tiltcal.effects.parameter import Parameter
from tiltcal.effects.sense import ACCELEROMETERS, Sense
from tiltcal.effects.sensor.environmental import GYROS
from tiltcal.effects.stepwise import StepEffect, SteppedLag, Stepping
from tiltcal.effects.traits import Family
from tiltcal.setup.tables import angle_channel, built_in_axes


class AccBandwidth(SignalEffect):
    id = "acc_bandwidth"
    needs = "motion"
    stage = "sensor"
    kinds = ACCELEROMETERS
    order = 40
    straight = 0.05
    title = "low-pass of the sensor"
    parameters = (Parameter("tau", "ms", (0.5, 10, 20), positive=True),)
    physics = "A damped suspension or its filter follows with a lag."
    equation = "tau dy/dt + y = u"
    source = "IEEE 2700; Physics: Accelerometers and inclinometers"
    excited_by = "moves"
    look = "as a delay in steady turns, an exponential after stops"

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        tau = self.value("tau")
        return np.column_stack(
            [smooth_lag(sense.time, reading[:, i], tau) for i in range(reading.shape[1])]
        )

    def stepwise(self, stepping: Stepping) -> StepEffect:
        shape = (stepping.rows, len(stepping.sensor.axes))
        return SteppedLag(self.value("tau"), 1 / stepping.sensor.rate_hz, shape)


class GyrBandwidth(AccBandwidth):
    id = "gyr_bandwidth"
    needs = "motion"
    kinds = GYROS
    source = "IEEE 2700; Physics: Gyroscopes and FOGs"


class AccSaturation(SignalEffect):
    row_wise = True
    id = "acc_saturation"
    stage = "sensor"
    kinds = ACCELEROMETERS
    order = 45
    title = "clipping"
    parameters = (Parameter("full_scale", "m_s2", (200, 20, 20), positive=True),)
    physics = "Beyond full scale the reading stays at full scale."
    equation = "|reading| <= full scale, on one axis where one is named"
    channel_wise = True
    source = "IEEE 2700; Physics: Accelerometers and inclinometers"
    excited_by = "input beyond full scale"
    look = "flat tops"
    threshold = True
    repair = "samples"

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        limit = self.value("full_scale")
        if limit <= 0:
            return reading
        if self.axis is None:
            return np.minimum(np.maximum(reading, -limit), limit)  # np.clip takes thrice as long
        channel = TermEffect.channel_of(self.axis, sense)
        reading[:, channel] = np.clip(reading[:, channel], -limit, limit)
        return reading


class GyrSaturation(AccSaturation):
    id = "gyr_saturation"
    kinds = GYROS
    parameters = (Parameter("full_scale", "deg_s", (400, 250, 250), positive=True),)
    source = "IEEE 2700; Physics: Gyroscopes and FOGs"


class AccAngleBias(TermEffect):
    row_wise = True
    id = "acc_angle_bias"
    stage = "sensor"
    kinds = ACCELEROMETERS
    order = 25
    title = "zero bias that depends on the placing angle"
    parameters = tuple(
        Parameter(f"{part}{n}_{{axis}}", "ug", (300, 1000, 3000))
        for n in (1, 2, 3, 4)
        for part in ("cos", "sin")
    )
    physics = "A quartz flexure's zero shifts with its rotation about its own sensitive axis."
    equation = (
        "reading_i += sum_n c_n cos(n beta_i) + s_n sin(n beta_i); beta_i: turn about axis i from"
        " level"
    )
    source = "CN 109459585; Physics: Accelerometers and inclinometers"
    excited_by = "turning about the sensitive axis"
    look = "the cross channel's bias as a function of the placing angle"
    form = "unknown"
    family = Family(reading=tuple(map(angle_channel, built_in_axes())))

    def term(self, name: str, sense: Sense) -> tuple[int, Array]:
        axis, n = name[-1], int(name[3])
        beta = placing_angle(axis, sense.force)
        across = (sense.force**2).sum(axis=1) - sense.force[:, "xyz".index(axis)] ** 2
        # with the axis exactly vertical the angle has none
        meaning = across / (across + (1e-7 * G0) ** 2)
        return self.channel_of(axis, sense), meaning * (
            np.cos(n * beta) if name.startswith("cos") else np.sin(n * beta)
        )


def placing_angle(axis: str, force: Array) -> Array:
    """Turn about a body axis from the level pose, rad, (n,): atan2(f_y, f_z) for x, atan2(-f_x,
    f_z) for y.
    """
    x, y, z = force[:, 0], force[:, 1], force[:, 2]
    pairs = {"x": (y, z), "y": (-x, z), "z": (x, y)}
    return np.asarray(np.arctan2(*pairs[axis]))


class AccVre(TermEffect):
    id = "acc_vre"
    needs = "vibration"
    stage = "sensor"
    kinds = ACCELEROMETERS
    order = 25
    title = "vibration rectification error"
    parameters = (Parameter("vre_{axis}", "ug_g2", (60, 5000, 1e5)),)
    physics = "Even non-linearity turns vibration into a bias shift."
    equation = (
        "reading_i += k_i <a_i^2> (g), the mean square over 1 s of what is faster than 0.25 s"
    )
    source = "IEEE 1293; Physics: Accelerometers and inclinometers"
    excited_by = "vibration of changing size"
    look = "the bias follows the square of the vibration"

    def term(self, name: str, sense: Sense) -> tuple[int, Array]:
        power = vibration_power(sense.force[:, "xyz".index(name[-1])], sense.rate_hz)
        return self.channel_of(name[-1], sense), G0 * power


class TiltConversion(SignalEffect):
    row_wise = True
    id = "tilt_conversion"
    stage = "sensor"
    kinds = frozenset({"inclinometer"})
    order = 71
    title = "linear instead of arcsine"
    parameters = (Parameter("mix", "unitless", (1, 1, 1)),)
    physics = "Firmware reports the sine as the angle; 183 arcsec at 10 deg."
    equation = "tilt = (1 - m) asin(s) + m s"
    source = "Pedley 2013; Physics: Accelerometers and inclinometers"
    excited_by = "large tilts"
    look = "odd cubic of the angle"
    linear = True
    family = Family(reading=("input",))

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        return reading + self.value("mix") * (np.sin(reading) - reading)
