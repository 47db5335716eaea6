"""Listed physics of the sensors: terms that are added to what is sensed."""

from collections.abc import Callable

import numpy as np

from blind.laboratory import Lab
from blind.memory import play
from blind.mount import step, step_odd, step_shape, warm, warm_odd
from blind.rates import fog, gyro
from blind.spec import G0, UG, Shape, Spec, added, per_axis
from blind.world import Past, Physics, State


def sensing(lab: Lab) -> list[Spec]:
    """All of them that this laboratory can have."""
    specs: list[Spec] = []
    for sensor in lab.sensors:
        if sensor.kind in ("accelerometer", "inclinometer"):
            specs += _static(lab, sensor.name, sensor.axes) + _slow(lab, sensor.name, sensor.axes)
        elif sensor.kind == "gyro":
            specs += gyro(lab, sensor.axes)
        else:
            specs += fog(lab, sensor.input_axis)
    return specs


# -------------------------------------------------------------------------------------------
# accelerometer, inclinometer

POWERS: dict[str, tuple[str, str, float, Callable[[np.ndarray, int], np.ndarray]]] = {
    "acc_K2": ("k2", "ug_g2", 3000, lambda f, i: f[:, i] ** 2),
    "acc_K3": ("k3", "ug_g3", 2000, lambda f, i: f[:, i] ** 3),
    "acc_Koq": ("koq", "ug_g2", 2000, lambda f, i: f[:, i] * np.abs(f[:, i])),
    "acc_Kip": ("kip", "ug_g2", 2000, lambda f, i: f[:, i] * f[:, (i + 1) % 3]),
    "acc_Kio": ("kio", "ug_g2", 2000, lambda f, i: f[:, i] * f[:, (i + 2) % 3]),
    "acc_Kpo": ("kpo", "ug_g2", 2000, lambda f, i: f[:, (i + 1) % 3] * f[:, (i + 2) % 3]),
}


def _static(lab: Lab, name: str, axes: tuple[str, ...]) -> list[Spec]:
    specs = []
    for id_, (stem, suffix, size, power) in POWERS.items():

        def column(past: Past, s: State, i: int, shape: Shape, power=power) -> np.ndarray:  # type: ignore[no-untyped-def]
            f = s.f / G0
            return power(f, i) * (1 + shape.get("more", 0.0) * f[:, i])

        more = (
            (lambda r, lab: {"more": r.choice([-1, 1]) * r.uniform(0.2, 0.5)})
            if id_ in ("acc_K2", "acc_Kip", "acc_Kio", "acc_Kpo")
            else None
        )
        specs.append(
            Spec(
                id_,
                "sensor",
                per_axis(stem, axes, suffix),
                UG,
                size,
                added(name, column),
                ("tilt", "table_outer", "table_inner"),
                (name,),
                odd=more,
            )
        )

    def asym(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        x = s.f[:, i]
        return np.abs(x) / 2 if not shape else np.sqrt(x**2 + (shape["round"] * G0) ** 2) / 2

    def sign(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return np.tanh(s.f[:, i] / G0 / shape.get("round", 2e-4)) / 2

    tilt = ("tilt", "table_outer", "table_inner")
    specs += [
        Spec(
            "acc_scale_asym",
            "sensor",
            per_axis("scale_asym", axes, "ppm"),
            1e-6,
            3000,
            added(name, asym),
            tilt,
            (name,),
            odd=lambda r, lab: {"round": r.uniform(0.05, 0.2)},
        ),
        Spec(
            "acc_bias_asym",
            "sensor",
            per_axis("bias_asym", axes, "ug"),
            UG,
            2000,
            added(name, sign),
            tilt,
            (name,),
            odd=lambda r, lab: {"round": r.uniform(0.03, 0.12)},
        ),
        Spec(
            "acc_hysteresis",
            "sensor",
            per_axis("hysteresis", axes, "ug"),
            UG,
            1000,
            added(name, _play_of_f),
            (*tilt, "move"),
            (name,),
            odd=lambda r, lab: {"width": r.uniform(0.02, 0.08), "round": r.uniform(1, 2)},
        ),
    ]
    if lab.table == "placing":
        specs.append(_angle_bias(lab, name, axes))
    if name == "incl" and lab.table == "placing":
        specs.append(_conversion(lab, axes))
    return specs


def _play_of_f(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
    z = past.play(s.t, "f", i, shape.get("width", 0.05) * G0)
    return np.tanh(shape["round"] * z) / np.tanh(shape["round"]) if "round" in shape else z


def _angle_bias(lab: Lab, name: str, axes: tuple[str, ...]) -> Spec:
    """Any smooth function of the placing angle in the cross channel; as a rival it is judged by its
    harmonics 2 to 5.
    """

    def column(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return sum(c * np.cos(k * s.angles[:, 0] + ph) for k, c, ph in shape["terms"])

    def shapes(rng: np.random.Generator, lab: Lab) -> list[Shape]:
        return [{"terms": [(k, rng.normal() / k, rng.uniform(0, 6.28)) for k in (2, 3, 4, 5)]}]

    names = tuple(f"bias_table_{a}_ug" for a in axes)
    return Spec(
        "acc_angle_bias",
        "sensor",
        names,
        UG,
        2000,
        added(name, column),
        ("table_outer", "tilt"),
        (name,),
        shapes=shapes,
        axes=("y",),
    )


def _conversion(lab: Lab, axes: tuple[str, ...]) -> Spec:
    def physics(p: np.ndarray, shape: Shape) -> Physics:
        def mix(past: Past, s: State, sensor, y: np.ndarray) -> np.ndarray:  # type: ignore[no-untyped-def]
            angle = np.arcsin(np.clip(y / lab.gravity, -1, 1))
            return lab.gravity * np.sin((1 - p[0]) * angle + p[0] * np.sin(angle))

        return Physics(shape=mix)

    return Spec(
        "tilt_conversion",
        "sensor",
        ("mix_unitless",),
        1.0,
        1.0,
        physics,
        ("tilt", "table_outer"),
        ("incl",),
        together=True,
        axes=("x",),
    )


def _slow(lab: Lab, name: str, axes: tuple[str, ...]) -> list[Spec]:
    def heat(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return warm(lab, s.t, shape)

    def heat_f(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return warm(lab, s.t, shape) * s.f[:, i]

    def heating(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return lab.room.slope_at(s.t)

    def loop(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return past.at(
            s.t,
            ("Tplay", shape.get("width", 0.2)),
            lambda: play(past.state.T, shape.get("width", 0.2)),
        )

    def settle(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        second = shape.get("second", 0.0)
        return (1 - second) * np.exp(-s.t / shape["tau"]) + second * np.exp(
            -s.t / (5 * shape["tau"])
        )

    def jump(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return np.ones(len(s.t)) if shape.get("settled") else step(s.t, shape)

    def taus(rng: np.random.Generator, lab: Lab) -> list[Shape]:
        return [{"tau": float(x)} for x in rng.uniform(0.08, 0.4, 1) * lab.track.end_s]

    def ramp(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return s.t / lab.track.end_s

    temp, time = ("temperature",), ("time",)
    return [
        Spec(
            "acc_drift",
            "sensor",
            per_axis("drift", axes, "ug"),
            UG,
            2000,
            added(name, ramp),
            time,
            (name,),
            later="none",
        ),
        Spec(
            "acc_temp_bias",
            "sensor",
            per_axis("temp_bias", axes, "ug_degC"),
            UG,
            400,
            added(name, heat),
            temp,
            (name,),
            odd=warm_odd,
        ),
        Spec(
            "acc_temp_scale",
            "sensor",
            per_axis("temp_scale", axes, "ppm_degC"),
            1e-6,
            400,
            added(name, heat_f),
            temp,
            (name,),
            odd=warm_odd,
        ),
        Spec(
            "acc_thermal_gradient",
            "sensor",
            per_axis("temp_rate", axes, "ug_s_degC"),
            UG,
            20000,
            added(name, heating),
            ("temperature", "time"),
            (name,),
        ),
        Spec(
            "acc_thermal_hysteresis",
            "sensor",
            per_axis("thermal_hysteresis", axes, "ug"),
            UG,
            600,
            added(name, loop),
            ("temperature", "time"),
            (name,),
            shapes=lambda r, lab: [{"width": r.uniform(0.1, 0.4)}],
        ),
        Spec(
            "acc_warmup",
            "sensor",
            per_axis("warmup", axes, "ug"),
            UG,
            3000,
            added(name, settle),
            time,
            (name,),
            shapes=taus,
            odd=lambda r, lab: {**taus(r, lab)[0], "second": r.uniform(0.3, 0.6)},
            extra=lambda s: {"tau_s": s["tau"]},
        ),
        Spec(
            "acc_bias_step",
            "sensor",
            per_axis("bias_step", axes, "ug"),
            UG,
            2000,
            added(name, jump),
            time,
            (name,),
            shapes=step_shape,
            odd=step_odd,
            later="after",
            extra=lambda s: {"time_s": s["time"]},
        ),
    ]
