"""The second author's gyros: what a triad and a FOG may do that follows rates, turns and heat."""

import numpy as np

from blind.laboratory import Lab, Sensor
from blind.second_author_terms import PLACE, drawn, heat, hinge, per_axis_effect, way
from blind.spec import DEG_H, G0, Shape, Spec
from blind.world import Past, State

RATE = ("rate",)
HISTORY = ("rate", "move", "time", *PLACE)


def gyros(lab: Lab) -> list[Spec]:
    """All of them."""
    triad = next(s for s in lab.sensors if s.kind == "gyro")
    fog = next(s for s in lab.sensors if s.kind == "fog")
    return _of_rates(triad) + _of_history(triad) + _of_load_and_heat(lab, triad) + _of_fog(lab, fog)


def _of_rates(triad: Sensor) -> list[Spec]:
    """Rate only: a knee, rectified neighbours, coning, a beat."""

    def knee(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return hinge(shape["sign"] * s.w[:, i] - shape["at"], 0.05)

    def lesser(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return np.sqrt(np.abs(s.w[:, (i + 1) % 3] * s.w[:, (i + 2) % 3]))

    def coning(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        j, k = (i + 1) % 3, (i + 2) % 3
        return s.w[:, j] * s.dw[:, k] - s.w[:, k] * s.dw[:, j]

    def starting(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return hinge(shape["sign"] * s.dw[:, i] - shape["at"], 0.05)

    def signed(low: float, high: float):  # type: ignore[no-untyped-def]
        return lambda r, lab: [
            {"sign": float(r.choice([-1.0, 1.0])), "at": float(r.uniform(low, high))}
        ]

    ppm = {"suffix": "ppm", "unit": 1e-6}
    return [
        per_axis_effect(triad, "gyro_knee", 9000, knee, RATE, signed(0.1, 0.8), **ppm),  # type: ignore[arg-type]
        per_axis_effect(triad, "gyro_neighbours", 9000, lesser, RATE, **ppm),  # type: ignore[arg-type]
        per_axis_effect(triad, "gyro_coning", 30000, coning, RATE, suffix="ms", unit=1e-6),
        per_axis_effect(
            triad, "gyro_starting", 9000, starting, HISTORY, signed(0.0, 0.3), "us", 1e-6
        ),
    ]


def _of_history(triad: Sensor) -> list[Spec]:
    """Turns that a spring has wound up; heat of the turning; a slow settling after it."""

    def wound(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        def make() -> np.ndarray:
            turned = np.cumsum(past.column("w", i)) * past.STEP_S
            return np.tanh(turned / shape["radians"])

        return past.at(s.t, ("wound", i, shape["radians"]), make)

    def warmed(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        made = past.at(s.t, ("heat", shape["tau"]), lambda: heat(past, shape["tau"]))
        return made * s.w[:, i]

    def settling(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        since = past.lab.track.since_arrival(s.t)
        return np.exp(-((since / shape["tau"]) ** shape["bent"]))

    return [
        per_axis_effect(
            triad, "gyro_wound", 900, wound, HISTORY, drawn(radians=(2, 8)), "deg_h", DEG_H
        ),
        per_axis_effect(
            triad, "gyro_warmed", 20000, warmed, HISTORY, drawn(tau=(5, 40)), "ppm", 1e-6
        ),
        per_axis_effect(
            triad,
            "gyro_settling",
            900,
            settling,
            HISTORY,
            drawn(tau=(0.4, 2.0), bent=(0.35, 0.6)),
            "deg_h",
            DEG_H,
        ),
    ]


def _of_load_and_heat(lab: Lab, triad: Sensor) -> list[Spec]:
    """Scale by the side that the load lies on, and while the room warms."""

    def side(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return s.w[:, i] * np.tanh((s.f[:, (i + 1) % 3] / G0 - shape["at"]) / 0.1)

    def warming(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return s.w[:, i] * hinge(lab.room.slope_at(s.t) * 100 - shape["at"], 0.2)

    return [
        per_axis_effect(
            triad, "gyro_side", 6000, side, ("rate", "tilt"), drawn(at=(-0.5, 0.5)), "ppm", 1e-6
        ),
        per_axis_effect(
            triad,
            "gyro_warming",
            9000,
            warming,
            ("rate", "temperature", "time"),
            drawn(at=(-1, 1)),
            "ppm",
            1e-6,
        ),
    ]


def _of_fog(lab: Lab, fog: Sensor) -> list[Spec]:
    """A beat of scattered light, light that fades with the rate, a coil that turns wring."""

    def beat(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return np.sin(2 * np.pi * (s.w @ fog.input_axis) / shape["beat"])

    def fading(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        rate = s.w @ fog.input_axis
        return rate * np.exp(-((rate / shape["width"]) ** 2))

    def wrung(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        far = np.maximum(past.at(s.t, "way", lambda: way(past)), 0.0)
        return np.sqrt(far) * (s.w @ fog.input_axis)

    return [
        per_axis_effect(fog, "fog_beat", 100, beat, RATE, drawn(beat=(0.15, 0.6)), "deg_h", DEG_H),
        per_axis_effect(
            fog, "fog_fading", 5000, fading, RATE, drawn(width=(0.2, 0.8)), "ppm", 1e-6
        ),
        per_axis_effect(fog, "fog_wrung", 900, wrung, HISTORY, suffix="ppm", unit=1e-6),
    ]
