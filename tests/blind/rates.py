"""Listed physics of gyros and of the FOG."""

import numpy as np

from blind.laboratory import Lab
from blind.mount import step, step_shape, warm, warm_odd
from blind.spec import DEG, DEG_H, G0, Shape, Spec, added, per_axis
from blind.world import Past, Physics, State


def gyro(lab: Lab, axes: tuple[str, ...]) -> list[Spec]:
    def asym(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return np.sqrt(s.w[:, i] ** 2 + shape.get("round", 0.0) ** 2) / 2

    def cubic(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return s.w[:, i] * np.abs(s.w[:, i]) ** (shape.get("power", 3.0) - 1)

    def heat(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return warm(lab, s.t, shape)

    def settle(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return np.exp(-s.t / shape["tau"])

    def jump(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return np.ones(len(s.t)) if shape.get("settled") else step(s.t, shape)

    own = ("gyro",)
    specs = [
        Spec(
            "gyr_scale_asym",
            "sensor",
            per_axis("scale_asym", axes, "ppm"),
            1e-6,
            5000,
            added("gyro", asym),
            ("rate",),
            own,
            odd=lambda r, lab: {"round": r.uniform(0.2, 0.6)},
        ),
        Spec(
            "gyr_nonlinearity",
            "sensor",
            per_axis("cubic", axes, "ppm_rad2_s2"),
            1e-6,
            3000,
            added("gyro", cubic),
            ("rate",),
            own,
            odd=lambda r, lab: {"power": r.choice([2.0, 4.0, 5.0])},
        ),
        Spec(
            "gyr_temp",
            "sensor",
            per_axis("temp_bias", axes, "deg_s_degC"),
            DEG,
            0.05,
            added("gyro", heat),
            ("temperature",),
            own,
            odd=warm_odd,
        ),
        Spec(
            "gyr_warmup",
            "sensor",
            per_axis("warmup", axes, "deg_s"),
            DEG,
            0.3,
            added("gyro", settle),
            ("time",),
            own,
            shapes=lambda r, lab: [{"tau": float(r.uniform(0.08, 0.4) * lab.track.end_s)}],
            extra=lambda s: {"tau_s": s["tau"]},
        ),
        Spec(
            "gyr_bias_step",
            "sensor",
            per_axis("bias_step", axes, "deg_s"),
            DEG,
            0.2,
            added("gyro", jump),
            ("time",),
            own,
            shapes=step_shape,
            later="after",
            extra=lambda s: {"time_s": s["time"]},
        ),
    ]
    return specs + ([_gsens(lab, axes)] if lab.table == "three" else [])


def _gsens(lab: Lab, axes: tuple[str, ...]) -> Spec:
    """One row of G: one gyro axis, all three directions of f."""

    def physics(p: np.ndarray, shape: Shape) -> Physics:
        def sense(past: Past, s: State) -> dict[str, np.ndarray]:
            f = s.f / G0
            return {"gyro": (f * (1 + shape.get("more", 0.0) * f)) @ p.reshape(3, 3).T}

        return Physics(sense=sense)

    names = tuple(f"gsens_{a}{d}_deg_h_g" for a in axes for d in "xyz")
    return Spec(
        "gyr_gsens",
        "sensor",
        names,
        DEG_H,
        400,
        physics,
        ("tilt", "table_outer", "table_middle", "table_inner"),
        ("gyro",),
        odd=lambda r, lab: {"more": r.uniform(0.2, 0.5)},
    )


def fog(lab: Lab, u: np.ndarray) -> list[Spec]:
    z = np.array([0.0, 0.0, 1.0])
    b1 = np.cross(u, z) / np.linalg.norm(np.cross(u, z))
    b2 = np.cross(u, b1)

    def axis(p: np.ndarray, shape: Shape) -> Physics:
        return Physics(sense=lambda past, s: {"fog": (s.w @ (p[0] * b1 + p[1] * b2))[:, None]})

    def magnet(p: np.ndarray, shape: Shape) -> Physics:
        return Physics(sense=lambda past, s: {"fog": ((s.R @ u) @ p)[:, None]})

    def shupe(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        if not shape:
            return lab.room.slope_at(s.t)
        return lab.room.lagged(s.t + 0.5, shape["lag"]) - lab.room.lagged(s.t - 0.5, shape["lag"])

    def lock(p: np.ndarray, shape: Shape) -> Physics:
        def dead(past: Past, s: State, sensor, y: np.ndarray) -> np.ndarray:  # type: ignore[no-untyped-def]
            return np.where(np.abs(y) < p[0], 0.0, y) if sensor.name == "fog" else y

        return Physics(shape=dead)

    specs = [
        Spec(
            "fog_axis_error",
            "sensor",
            ("axis_u_arcsec", "axis_v_arcsec"),
            DEG / 3600,
            1200,
            axis,
            ("rate",),
            ("fog",),
            together=True,
            drawn=lab.table == "three",
        ),
        Spec(
            "fog_shupe",
            "sensor",
            ("shupe_a_deg_h_s_degC",),
            DEG_H,
            2000,
            added("fog", shupe),
            ("temperature", "time"),
            ("fog",),
            odd=lambda r, lab: {"lag": r.uniform(5, 30)},
        ),
        Spec(
            "magnetic_field",
            "environment",
            tuple(f"bias_{d}_deg_h" for d in "enu"),
            DEG_H,
            60,
            magnet,
            ("table_outer", "tilt"),
            ("fog",),
            together=True,
            drawn=lab.table == "three",
        ),
        Spec(
            "fog_deadband",
            "sensor",
            ("deadband_deg_h",),
            DEG_H,
            300,
            lock,
            ("rate",),
            ("fog",),
            drawn=False,
        ),
    ]
    return specs
