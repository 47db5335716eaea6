"""Listed physics of the electronics and of timing."""

from typing import Any

import numpy as np

from blind.laboratory import Lab, Sensor
from blind.mount import warm, warm_odd
from blind.spec import G0, UG, Shape, Spec, added, per_axis
from blind.world import Past, Physics, State


def electronics(lab: Lab) -> list[Spec]:
    """All of them that this laboratory can have."""
    specs = _timing(lab)
    force = next((s for s in lab.sensors if s.kind in ("accelerometer", "inclinometer")), None)
    return specs + _gains(lab) + (_converter(lab, force) if force else [])


def _converter(lab: Lab, sensor: Sensor) -> list[Spec]:
    name, axes = sensor.name, sensor.axes

    def bow(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        v = s.f[:, i] / (1.2 * G0)
        if shape["form"] == "pieces":
            return np.interp(v, shape["knots"], shape["heights"])
        return 1 - v**2 if shape["form"] == "bow" else 2.6 * (v - v**3)

    def forms(rng: np.random.Generator, lab: Lab) -> list[Shape]:
        return [{"form": f} for f in rng.permutation(["bow", "s"])]

    def pieces(rng: np.random.Generator, lab: Lab) -> Shape:
        knots = np.linspace(-1, 1, 7)
        return {"form": "pieces", "knots": knots, "heights": rng.uniform(-1, 1, 7) * (1 - knots**2)}

    def tone(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        phase = 2 * np.pi * shape["hertz"] * s.t + shape["phase"]
        return np.sin(
            phase + shape.get("wander", 0.0) * np.sin(2 * np.pi * s.t / (0.3 * lab.track.end_s))
        )

    def hertz(rng: np.random.Generator, lab: Lab) -> list[Shape]:
        mains = rng.choice([50.0, 60.0]) + rng.uniform(-0.15, 0.15)
        alias = abs(mains - lab.rate_hz * round(mains / lab.rate_hz))
        return [{"hertz": float(alias), "phase": rng.uniform(0, 6.28)}]

    tones = added(name, tone)
    return [
        Spec(
            "adc_inl",
            "electronics",
            per_axis("inl", axes, "ug"),
            UG,
            1500,
            added(name, bow),
            ("tilt", "table_outer"),
            (name,),
            shapes=forms,
            odd=pieces,
        ),
        Spec(
            "mains_pickup",
            "electronics",
            per_axis("pickup", axes, "ug"),
            UG,
            2000,
            tones,
            ("frequency", "time"),
            (name,),
            shapes=hertz,
            odd=lambda r, lab: {**hertz(r, lab)[0], "wander": r.uniform(0.5, 4)},
            later="none",
            extra=lambda s: {"frequency_hz": s["hertz"]},
        ),
    ]


def _gains(lab: Lab) -> list[Spec]:
    def drift(p: np.ndarray, shape: Shape) -> Physics:
        def gain(past: Past, s: State, sensor: Sensor, y: np.ndarray) -> np.ndarray:
            return y * (1 + p[0] * warm(lab, s.t, shape))[:, None]

        return Physics(shape=gain)

    names = tuple(s.name for s in lab.sensors)
    return [
        Spec(
            "reference_drift",
            "electronics",
            ("gain_ppm_degC",),
            1e-6,
            400,
            drift,
            ("temperature",),
            names,
            odd=warm_odd,
        )
    ]


def _timing(lab: Lab) -> list[Spec]:
    every = tuple(s.name for s in lab.sensors)
    hand = lab.table == "handheld"
    names = ("fog",) if hand else every
    specs = []

    def later(p: np.ndarray, shape: Shape) -> Physics:
        return Physics(delay=lambda: dict.fromkeys(names, p[0]))

    def skew(p: np.ndarray, shape: Shape) -> Physics:
        return Physics(
            delay=lambda: {
                s.name: p[0] * np.arange(len(s.axes)) for s in lab.sensors if len(s.axes) > 1
            }
        )

    def slow(sensor: str) -> Any:
        def physics(p: np.ndarray, shape: Shape) -> Physics:
            return Physics(
                lag=lambda: {sensor: p[0]},
                delay=(lambda: {sensor: p[0] * shape["dead"]}) if shape else None,
            )

        return physics

    def clock(p: np.ndarray, shape: Shape) -> Physics:
        return Physics(
            stamps=lambda t: t * (1 - p[0]) + shape.get("bend", 0.0) * p[0] * t**2 / lab.track.end_s
        )

    moving = not lab.unlocked and lab.kind != "six_any"
    specs.append(
        Spec(
            "data_latency",
            "timing",
            ("latency_ms",),
            1e-3,
            40,
            later,
            ("rate", "time"),
            names,
            drawn=moving,
            axes=(),
        )
    )
    if moving:
        specs.append(
            Spec(
                "channel_mux_skew",
                "electronics",
                ("skew_ms",),
                1e-3,
                20,
                skew,
                ("rate", "time"),
                every[:1] if hand else every,
                drawn=not hand,
            )
        )
        specs += [
            Spec(
                "gyr_bandwidth" if n == "gyro" else "acc_bandwidth",
                "sensor",
                ("tau_ms",),
                1e-3,
                40,
                slow(n),
                ("rate", "time"),
                (n,),
                odd=lambda r, lab: {"dead": r.uniform(0.5, 1.5)},
            )
            for n in every
            if n != "fog"
        ]
    if moving and not hand:
        specs.append(
            Spec(
                "clock_skew",
                "timing",
                ("skew_ppm",),
                1e-6,
                500,
                clock,
                ("time", "rate"),
                every,
                odd=lambda r, lab: {"bend": r.uniform(0.3, 0.6)},
            )
        )
    return specs
