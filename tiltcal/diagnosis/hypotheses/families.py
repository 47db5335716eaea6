"""Which curves complete the form of a named effect: real laws are seldom the one-parameter textbook
form.

A family keeps where the effect acts and what it follows, and frees how: an encoder's error of its
    angle keeps to that angle,
a bias that follows temperature may follow it late or bent. A curve of another place or coordinate
is another effect.
"""

from tiltcal.diagnosis.hypotheses.hypothesis import STEPS, Hypothesis
from tiltcal.effects.learned import ANGLES, Learned, LearnedReading, LearnedReadout, LearnedTilt

READING: dict[str, tuple[str, ...]] = {
    "acc_K2": ("input",),
    "acc_K3": ("input",),
    "acc_Koq": ("input",),
    "acc_scale_asym": ("input",),
    "acc_bias_asym": ("input",),
    "adc_inl": ("input",),
    "tilt_conversion": ("input",),
    "gyr_scale_asym": ("input",),
    "gyr_nonlinearity": ("input",),
    "fog_deadband": ("input",),
    "acc_temp_bias": ("temperature",),
    "acc_thermal_hysteresis": ("temperature", "warming"),
    "acc_thermal_gradient": ("warming", "temperature"),
    "gyr_temp": ("temperature",),
    "fog_shupe": ("warming",),
    "acc_warmup": ("time",),
    "gyr_warmup": ("time",),
    "acc_bias_step": ("time",),
    "gyr_bias_step": ("time",),
    "acc_drift": ("time",),
    "acc_angle_bias": ("table_outer", "table_inner", "table_middle"),
    "gyr_gsens": ("force_x", "force_y", "force_z"),
    "gyr_g2sens": ("force_x", "force_y", "force_z"),
}
SCALE: dict[str, str] = {"acc_temp_scale": "temperature", "reference_drift": "temperature"}
READOUT = {
    "table_encoder_eccentricity",
    "table_encoder_2rev",
    "table_encoder_sde",
    "table_sag",
    "cable_torque",
}
TILT: dict[str, tuple[str, str]] = {
    "floor_tilt_drift": ("base", "time"),
    "mount_slip": ("mount", "time"),
    "mount_thermal_tilt": ("mount", "temperature"),
}
SUPERPOSED = {
    "table_backlash",
    "acc_hysteresis",
    "acc_warmup",
    "gyr_warmup",
    "settling_transient",
    "mains_pickup",
    "base_vibration",
    "adc_inl",
}
"""At several shapes at once."""
WANDER = 0.05  # Hz: of the mains about its frequency (PHYSICS 3.6); further off is another tone
ALL_AXES = {"servo_lag", "servo_friction_deadband"}  # one drive is like the other
KIN = {("gyr_g2sens", "gyr_gsens")}  # (what completes, whose form)
OF_INPUT = {
    "acc_K2",
    "acc_K3",
    "acc_Koq",
    "acc_scale_asym",
    "acc_bias_asym",
    "adc_inl",
    "gyr_nonlinearity",
    "gyr_scale_asym",
}
"""Functions of the channel's own input."""
FREE_FORM = {"adc_inl", "floor_tilt_drift"}  # the name says where and of what, not which form


def completes(curve: Hypothesis, host: Hypothesis) -> bool:
    """Whether a curve is of the family of a named effect."""
    effect = curve.effect
    if not host.listed:
        return _same_curve(curve, host)
    if curve.listed and curve.alias:
        other = host.effect
        if curve.id != host.id or effect.sensor != other.sensor or not isinstance(effect, Learned):
            return False
        return not isinstance(other, Learned) or (
            (other.lag, other.power) == (effect.lag, effect.power)
            and len(curve.names) == len(host.names)
        )
    if curve.listed:
        if (curve.id, host.id) in KIN:
            return effect.sensor == host.effect.sensor
        if curve.id != host.id or effect.sensor != host.effect.sensor:
            return False
        if curve.id in STEPS:  # what creeps on after it
            return (
                curve.effect.values["time"] == host.effect.values["time"]
                and curve.effect.values.get("creep", 0) > 0
            )
        if curve.id == "mains_pickup":
            return abs(curve.effect.values["frequency"] - host.effect.values["frequency"]) < WANDER
        return curve.id in ALL_AXES or (curve.id in SUPERPOSED and effect.axis == host.effect.axis)
    assert isinstance(effect, Learned)
    if isinstance(effect, LearnedReading):
        if effect.sensor != host.effect.sensor or (
            host.effect.axis and host.effect.axis != effect.axis
        ):
            return False
        if (
            not any(name.endswith(f"_{effect.axis}") or "_" not in name for name in host.names)
            and host.id not in SCALE
        ):
            return False
        if effect.per_input:
            return SCALE.get(host.id) == effect.coordinate
        return effect.coordinate in READING.get(host.id, ())
    if isinstance(effect, LearnedReadout):
        return host.id in READOUT and ANGLES.get(effect.coordinate) == effect.axis == (
            host.effect.axis or "outer"
        )
    assert isinstance(effect, LearnedTilt)
    if host.id == "table_axis_wobble":
        return (
            effect.slot == f"{host.effect.axis}_bearing"
            and ANGLES.get(effect.coordinate) == host.effect.axis
        )
    return TILT.get(host.id) == (effect.slot, effect.coordinate)


def _same_curve(curve: Hypothesis, host: Hypothesis) -> bool:
    """Whether two curves are parts of one unnamed effect: the same coordinate at the same place, on
    another axis.
    """
    a, b = curve.effect, host.effect
    if (
        not isinstance(a, Learned)
        or not isinstance(b, Learned)
        or type(a) is not type(b)
        or a.coordinate != b.coordinate
    ):
        return False
    if (a.knots, a.period, a.beside, a.power, a.odd) != (
        b.knots,
        b.period,
        b.beside,
        b.power,
        b.odd,
    ):
        return False
    if isinstance(a, LearnedTilt):
        return a.slot == b.slot and a.turn != b.turn and len(curve.names) == len(host.names)
    same = (
        a.per_input == b.per_input
        and a.sensor == b.sensor
        and a.lag == b.lag
        and len(curve.names) == len(host.names)
    )
    return isinstance(a, LearnedReading) and same and a.axis != b.axis
