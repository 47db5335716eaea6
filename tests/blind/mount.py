"""Listed physics of the mount; and the courses of steps and of temperature that others share."""

import numpy as np

from blind.laboratory import Lab
from blind.rotations import ARCSEC
from blind.spec import Shape, Spec
from blind.world import Past, Physics

TILT = ("table_outer", "tilt")


def step_shape(rng: np.random.Generator, lab: Lab) -> list[Shape]:
    """Instants of a step."""
    between = (
        np.floor(rng.uniform(0.15, 0.85, 1) * lab.track.end_s * lab.rate_hz) + 0.5
    ) / lab.rate_hz
    return [{"time": float(x)} for x in between]


def step_odd(rng: np.random.Generator, lab: Lab) -> Shape:
    """A step that creeps on."""
    return {**step_shape(rng, lab)[0], "creep": rng.uniform(0.3, 0.8), "tau": rng.uniform(8, 40)}


def step(t: np.ndarray, shape: Shape) -> np.ndarray:
    """0 before, 1 in the end."""
    late = np.clip(t - shape["time"], 0, None)
    return np.where(
        t >= shape["time"], 1 - shape.get("creep", 0.0) * np.exp(-late / shape.get("tau", 1.0)), 0.0
    )


def mount(lab: Lab) -> list[Spec]:
    xyz = tuple(f"{{}}_{a}_arcsec{{}}" for a in "xyz")

    def names(stem: str, suffix: str = "") -> tuple[str, ...]:
        return tuple(x.format(stem, suffix) for x in xyz)

    def slip(p: np.ndarray, shape: Shape) -> Physics:
        return Physics(
            mount=lambda past, t, up: np.outer(
                np.full(len(t), 1.0) if shape.get("settled") else step(t, shape), p
            )
        )

    def thermal(p: np.ndarray, shape: Shape) -> Physics:
        return Physics(mount=lambda past, t, up: np.outer(warm(lab, t, shape), p))

    def bend(p: np.ndarray, shape: Shape) -> Physics:
        more = shape.get("more", 0.0)
        return Physics(
            mount=lambda past, t, up: np.stack(
                [
                    -p[0] * up[:, 1] * (1 + more * np.abs(up[:, 1])),
                    p[1] * up[:, 0] * (1 + more * np.abs(up[:, 0])),
                    np.zeros(len(t)),
                ],
                1,
            )
        )

    moving = lab.table in ("vertical", "placing", "dual", "three") and not lab.unlocked
    specs = [
        Spec(
            "mount_slip",
            "mount",
            names("slip"),
            ARCSEC,
            90,
            slip,
            ("time",),
            shapes=step_shape,
            odd=step_odd,
            together=True,
            later="after",
            extra=lambda s: {"time_s": s["time"]},
            drawn=moving,
        ),
        Spec(
            "mount_thermal_tilt",
            "mount",
            names("tilt", "_degC"),
            ARCSEC,
            15,
            thermal,
            ("temperature",),
            odd=warm_odd,
            together=True,
            drawn=moving,
        ),
        Spec(
            "mount_compliance",
            "mount",
            ("bend_x_arcsec_g", "bend_y_arcsec_g"),
            ARCSEC,
            60,
            bend,
            TILT,
            together=True,
            drawn=moving,
            odd=lambda r, lab: {"more": r.uniform(0.3, 1.0)},
        ),
    ]
    if lab.sensors[0].kind == "accelerometer" and lab.table == "three":
        specs += _levers()
    return specs


def _levers() -> list[Spec]:
    def lever(p: np.ndarray, shape: Shape) -> Physics:
        return Physics(lever=lambda: p)

    def apart(p: np.ndarray, shape: Shape) -> Physics:
        def sense(past: Past, s):  # type: ignore[no-untyped-def]
            w, dw = s.w, s.dw
            out = np.zeros_like(w)
            for i in range(3):  # component i of dw x r + w x (w x r) with r along the next axis
                j, k = (i + 1) % 3, (i + 2) % 3
                out[:, i] = p[i] * (w[:, i] * w[:, j] - dw[:, k])
            return {"accel": out}

        return Physics(sense=sense)

    names = ("{}_x_mm", "{}_y_mm", "{}_z_mm")
    return [
        Spec(
            "lever_arm",
            "mount",
            tuple(n.format("lever") for n in names),
            1e-3,
            20,
            lever,
            ("rate", "time"),
            together=True,
            sensors=("accel",),
        ),
        Spec(
            "triad_size_effect",
            "mount",
            tuple(n.format("offset") for n in names),
            1e-3,
            30,
            apart,
            ("rate", "time"),
            together=True,
            sensors=("accel",),
        ),
    ]


def warm(lab: Lab, t: np.ndarray, shape: Shape) -> np.ndarray:
    """Excess temperature, as the textbook has it, or behind a lag, or bent."""
    T = lab.room.lagged(t, shape["lag"]) if shape.get("lag") else lab.room.at(t)
    return (T - lab.T0) * (1 + shape.get("bend", 0.0) * (T - lab.T0))


def warm_odd(rng: np.random.Generator, lab: Lab) -> Shape:
    """Lagged by 15-60 s, or bent."""
    return (
        {"lag": rng.uniform(15, 60)}
        if rng.random() < 0.6
        else {"bend": rng.choice([-1, 1]) * rng.uniform(0.15, 0.4)}
    )
