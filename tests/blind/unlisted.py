"""Physics that no catalogue lists, invented by the author of the search."""

import numpy as np

from blind.laboratory import Lab
from blind.rotations import ARCSEC, DEG
from blind.spec import DEG_H, G0, UG, Shape, Spec, added, per_axis, unlisted_effect
from blind.world import Past, Physics, State


def unlisted(lab: Lab) -> list[Spec]:
    """All of them that this laboratory can have."""
    specs: list[Spec] = []
    force = next((s for s in lab.sensors if s.kind in ("accelerometer", "inclinometer")), None)
    if force and lab.written:
        specs += (
            _of_angle(lab, force.name, force.axes)
            + _of_history(lab, force.name, force.axes)
            + _of_axis(lab)
        )
    if lab.table in ("three", "handheld") and len(lab.sensors) > 1:
        specs += _of_rate(lab)
    return specs


def _of_angle(lab: Lab, name: str, axes: tuple[str, ...]) -> list[Spec]:
    """A bump where the shaft passes a magnet; a saw with the angle; a product of two angles."""

    def bump(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        x = np.angle(np.exp(1j * (s.angles[:, shape["k"]] - shape["at"])))
        return np.exp(-((x / shape["width"]) ** 2))

    def saw(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return (s.angles[:, 0] / shape["pitch"] + shape["at"]) % 1.0 - 0.5

    def product(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        a, b = s.angles[:, 0], s.angles[:, -1]
        return np.sin(shape["m"] * a + shape["at"]) * np.cos(shape["n"] * b)

    def at(rng: np.random.Generator, lab: Lab) -> list[Shape]:
        k = int(rng.integers(len(lab.axes)))
        reach = [m.to_rad for m in lab.track.moves if m.axis == k] or [0.0]
        return [{"k": k, "at": float(rng.choice(reach)), "width": rng.uniform(15, 40) * DEG}]

    angle = ("table_outer", "table_middle", "table_inner", "tilt")
    specs = [
        unlisted_effect(
            "u_angle_bump",
            per_axis("bump", axes, "ug"),
            UG,
            3000,
            added(name, bump),
            angle,
            (name,),
            shapes=at,
        ),
        unlisted_effect(
            "u_angle_saw",
            per_axis("saw", axes, "ug"),
            UG,
            3000,
            added(name, saw),
            angle,
            (name,),
            shapes=lambda r, lab: [{"pitch": r.uniform(70, 110) * DEG, "at": r.uniform()}],
        ),
    ]
    if len(lab.axes) > 1:
        specs.append(
            unlisted_effect(
                "u_angle_product",
                per_axis("product", axes, "ug"),
                UG,
                3000,
                added(name, product),
                angle,
                (name,),
                shapes=lambda r, lab: [
                    {"m": int(r.integers(2, 4)), "n": int(r.integers(2, 4)), "at": r.uniform(0, 6)}
                ],
            )
        )
    return specs


def _of_history(lab: Lab, name: str, axes: tuple[str, ...]) -> list[Spec]:
    """Memory of the number of moves, of the time since the last one, of the rate, of the load on
    another axis.
    """

    def count(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return 1 - np.exp(-lab.track.since_move(s.t)[1] / shape["moves"])

    def odd_moves(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return (lab.track.since_move(s.t)[1] % 3 == 0).astype(float)

    def pulse(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        since, _ = lab.track.since_move(s.t)
        return np.where(since > 0, np.sin(2 * np.pi * since / shape["period"]), 0.0)

    def charge(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        axis = lab.axes[0]
        return past.leaky(s.t, "w", axis, shape["tau"])

    def creep(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        other = (i + 1) % 3
        return (past.leaky(s.t, "f", other, shape["tau"]) - s.f[:, other]) / G0

    moves, time = ("move", "time"), ("move", "time", "rate", "table_outer", "tilt")
    return [
        unlisted_effect(
            "u_move_count",
            per_axis("count", axes, "ug"),
            UG,
            3000,
            added(name, count),
            moves,
            (name,),
            shapes=lambda r, lab: [{"moves": r.uniform(6, 15)}],
        ),
        unlisted_effect(
            "u_every_third_move",
            per_axis("third", axes, "ug"),
            UG,
            2000,
            added(name, odd_moves),
            moves,
            (name,),
        ),
        unlisted_effect(
            "u_pulse_since_move",
            per_axis("pulse", axes, "ug"),
            UG,
            3000,
            added(name, pulse),
            ("move", "time", "frequency"),
            (name,),
            shapes=lambda r, lab: [{"period": r.uniform(0.6, 1.6)}],
        ),
        unlisted_effect(
            "u_leaky_rate",
            per_axis("charge", axes, "ug_s"),
            UG,
            20000,
            added(name, charge),
            time,
            (name,),
            shapes=lambda r, lab: [{"tau": r.uniform(4, 20)}],
        ),
        unlisted_effect(
            "u_cross_creep",
            per_axis("creep", axes, "ug"),
            UG,
            3000,
            added(name, creep),
            time,
            (name,),
            shapes=lambda r, lab: [{"tau": r.uniform(4, 20)}],
        ),
    ]


def _of_axis(lab: Lab) -> list[Spec]:
    """The outer axis tilts as a hose stretches: a tanh of the angle; or the readout has a kink."""
    axis = lab.axes[0]

    def hose(p: np.ndarray, shape: Shape) -> Physics:
        def tilt(past: Past, k: int, a: np.ndarray) -> np.ndarray | None:
            if k != 0:
                return None
            out = np.zeros((len(a), 3))
            out[:, (axis + 1) % 3] = p[0] * np.tanh((a - shape["at"]) / shape["width"])
            return out

        return Physics(axis_tilt=tilt)

    def at(rng: np.random.Generator, lab: Lab) -> list[Shape]:
        angles = [m.to_rad for m in lab.track.moves if m.axis == 0]
        return [
            {
                "at": float(np.median(angles)) + rng.normal(0, 0.3),
                "width": rng.uniform(15, 50) * DEG,
            }
        ]

    return [
        unlisted_effect(
            "u_hose_tanh",
            ("hose_arcsec",),
            ARCSEC,
            60,
            hose,
            ("table_outer", "tilt"),
            stage="table",
            shapes=at,
        )
    ]


def _of_rate(lab: Lab) -> list[Spec]:
    """Rate times temperature, transverse rates of a FOG, a bias that follows the square root of the
    rate.
    """
    fog = next(s for s in lab.sensors if s.name == "fog")
    across = np.cross(fog.input_axis, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)

    def heat(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return s.w[:, i] * (s.T - lab.T0)

    def transverse(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return np.abs(s.w @ across) if shape["form"] == "abs" else (s.w @ across) ** 2

    def root(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return np.sqrt(np.abs(s.w[:, (i + 1) % 3]))

    def charge(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return past.leaky(s.t, "w", (i + 1) % 3, shape["tau"])

    rate = ("rate",)
    return [
        unlisted_effect(
            "u_fog_transverse",
            ("transverse_ppm",),
            1e-6,
            5000,
            added("fog", transverse),
            rate,
            ("fog",),
            shapes=lambda r, lab: [{"form": str(r.choice(["abs", "square"]))}],
        ),
        unlisted_effect(
            "u_rate_heat",
            per_axis("heat", ("x", "y", "z"), "ppm_degC"),
            1e-6,
            3000,
            added("gyro", heat),
            ("rate", "temperature"),
            ("gyro",),
        ),
        unlisted_effect(
            "u_root_rate",
            per_axis("root", ("x", "y", "z"), "deg_h"),
            DEG_H,
            500,
            added("gyro", root),
            rate,
            ("gyro",),
        ),
        unlisted_effect(
            "u_leaky_turns",
            per_axis("charge", ("x", "y", "z"), "ppm"),
            1e-6,
            5000,
            added("gyro", charge),
            ("rate", "time", "move"),
            ("gyro",),
            shapes=lambda r, lab: [{"tau": r.uniform(4, 15)}],
        ),
    ]
