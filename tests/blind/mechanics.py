"""Listed physics of the environment and the table: what changes what the sensors truly feel."""

from collections.abc import Callable

import numpy as np

from blind.laboratory import Lab
from blind.memory import play
from blind.mount import TILT, mount
from blind.rotations import ARCSEC, DEG
from blind.spec import UG, Shape, Spec
from blind.world import H, Past, Physics


def mechanics(lab: Lab) -> list[Spec]:
    """All of them that this laboratory can have."""
    every = _base(lab) + mount(lab)
    if lab.table in ("vertical", "placing", "dual", "three") and not lab.unlocked:
        every += _readouts(lab) + _axes(lab) + _drive(lab) + _events(lab)
    return every


def _east_north(past: Past, t: np.ndarray, p: np.ndarray, course: np.ndarray) -> np.ndarray:
    return np.stack([p[0] * course, p[1] * course, np.zeros(len(t))], 1)


def _base(lab: Lab) -> list[Spec]:
    end = lab.track.end_s
    names = ("tilt_east_arcsec", "tilt_north_arcsec")
    forms = {
        "ramp": lambda t, s: t / end,
        "relax": lambda t, s: -np.expm1(-t / (s["tau"] * end)),
        "steps": lambda t, s: (
            sum(1 / (1 + np.exp(-(t / end - c) * 300)) for c in s["at"]) / len(s["at"])
        ),
        "wave": lambda t, s: np.sin(np.pi * s["tau"] * t / end),
    }

    def level(p: np.ndarray, shape: Shape) -> Physics:
        return Physics(base=lambda past, t: _east_north(past, t, p, np.ones(len(t))))

    def drift(p: np.ndarray, shape: Shape) -> Physics:
        return Physics(
            base=lambda past, t: _east_north(past, t, p, forms[shape.get("form", "ramp")](t, shape))
        )

    def odd(rng: np.random.Generator, lab: Lab) -> Shape:
        form = str(rng.choice(["relax", "steps", "wave"]))
        return {
            "form": form,
            "tau": rng.uniform(0.2, 0.5) if form == "relax" else rng.uniform(1.2, 2.5),
            "at": sorted(rng.uniform(0.15, 0.85, 2)),
        }

    def shake(p: np.ndarray, shape: Shape) -> Physics:
        def course(past: Past, t: np.ndarray) -> np.ndarray:
            phase = 2 * np.pi * shape["hertz"] * t + shape.get("wander", 0.0) * np.sin(
                2 * np.pi * t / (0.3 * end)
            )
            return np.outer(np.cos(phase), p[0::2]) + np.outer(np.sin(phase), p[1::2])

        return Physics(shake=course)

    def hertz(rng: np.random.Generator, lab: Lab) -> list[Shape]:
        return [{"hertz": f} for f in rng.uniform(0.13, 0.42, 1) * lab.rate_hz]

    specs = [
        Spec(
            "table_levelling",
            "table",
            names,
            ARCSEC,
            60,
            level,
            TILT,
            together=True,
            drawn=not lab.unlocked,
        ),
        Spec(
            "floor_tilt_drift",
            "environment",
            names,
            ARCSEC,
            60,
            drift,
            ("time",),
            odd=odd,
            together=True,
            later="none",
        ),
    ]
    if lab.sensors[0].kind == "accelerometer":
        lines = tuple(f"{d}{q}_ug" for d in "enu" for q in "cs")
        specs.append(
            Spec(
                "base_vibration",
                "environment",
                lines,
                UG,
                2000,
                shake,
                ("frequency", "time"),
                shapes=hertz,
                later="none",
                together=True,
                odd=lambda r, lab: {**hertz(r, lab)[0], "wander": r.uniform(0.5, 3)},
                extra=lambda s: {"frequency_hz": s["hertz"]},
            )
        )
    return specs


# --------------------------------------------------------------------------------------------------
# ----------- readouts


def _readout(
    k: int, lab: Lab, curve: Callable[[Past, np.ndarray, np.ndarray], np.ndarray]
) -> Physics:
    """An error of one readout: curve(past, t, angle)."""

    def error(past: Past, t: np.ndarray) -> np.ndarray:
        out = np.zeros((len(t), len(lab.axes)))
        out[:, k] = curve(past, t, lab.track.angles(t)[:, k])
        return out

    return Physics(readout=error)


def _readouts(lab: Lab) -> list[Spec]:
    specs = []
    for k, name in enumerate(lab.axis_names):
        where = (f"table_{name}", "tilt")

        def harmonic(p: np.ndarray, shape: Shape, k: int = k) -> Physics:
            n, more = shape["n"], shape.get("more", 0.0)
            return _readout(
                k,
                lab,
                lambda past, t, a: (
                    p[0] * np.cos(n * a)
                    + p[1] * np.sin(n * a)
                    + more * (p[0] * np.sin(3 * n * a) - p[1] * np.cos(2 * n * a))
                ),
            )

        def zero(p: np.ndarray, shape: Shape, k: int = k) -> Physics:
            return _readout(k, lab, lambda past, t, a: np.full(len(t), p[0]))

        cs = ("cos_arcsec", "sin_arcsec")
        for id_, n, size in (("table_encoder_eccentricity", 1, 40), ("table_encoder_2rev", 2, 25)):
            specs.append(
                Spec(
                    id_,
                    "table",
                    cs,
                    ARCSEC,
                    size,
                    harmonic,
                    where,
                    together=True,
                    axes=(name,),
                    shapes=lambda r, lab, n=n: [{"n": n}],
                    odd=lambda r, lab, n=n: {"n": n, "more": r.uniform(0.1, 0.35)},
                )
            )
        specs.append(
            Spec(
                "table_encoder_sde",
                "table",
                cs,
                ARCSEC,
                8,
                harmonic,
                where,
                together=True,
                axes=(name,),
                extra=lambda s: {"lines": s["n"]},
                shapes=lambda r, lab: [{"n": int(n)} for n in r.integers(12, 60, 1)],
            )
        )
        specs.append(
            Spec(
                "table_encoder_zero",
                "table",
                (f"{name}_zero_arcsec",),
                ARCSEC,
                60,
                zero,
                where,
                drawn=False,
                axes=(name,),
            )
        )
    return specs


# --------------------------------------------------------------------------------------------------
# ------ axes and load


def _axes(lab: Lab) -> list[Spec]:
    specs = [_wobble(lab, k, name) for k, name in enumerate(lab.axis_names)]
    names = {
        "dual": ("outer_inner_arcsec",),
        "three": ("outer_middle_arcsec", "middle_inner_arcsec"),
    }.get(lab.table)
    if names:
        about = {"dual": {0: (0, 1.0, 0)}, "three": {0: (1.0, 0, 0), 1: (0, 0, 1.0)}}[lab.table]

        def bent(p: np.ndarray, shape: Shape) -> Physics:
            return Physics(
                between=lambda k: p[k] * np.array(about[k]) if k in about else np.zeros(3)
            )

        along = {"dual": (0, 1.0, 0), "three": (1.0, 0, 0)}[lab.table]

        def apart(p: np.ndarray, shape: Shape) -> Physics:
            return Physics(offset=lambda k: p[0] * np.array(along) if k == 0 else np.zeros(3))

        specs.append(
            Spec(
                "axis_nonorthogonality",
                "table",
                names,
                ARCSEC,
                120,
                bent,
                ("table_inner", "table_middle", *TILT),
                together=True,
            )
        )
        if lab.table == "three":
            specs.append(
                Spec(
                    "axis_nonintersection",
                    "table",
                    ("offset_mm",),
                    1e-3,
                    5,
                    apart,
                    ("rate", "time", *TILT),
                )
            )
    return specs


def _wobble(lab: Lab, k: int, name: str) -> Spec:
    axis = lab.axes[k]
    i, j = (axis + 1) % 3, (axis + 2) % 3

    def tilt(p: np.ndarray, shape: Shape) -> Physics:
        def course(past: Past, axis_k: int, a: np.ndarray) -> np.ndarray | None:
            if axis_k != k:
                return None
            z = sum(
                (p[2 * m] + 1j * p[2 * m + 1]) * np.exp(1j * n * a)
                for m, n in enumerate((-1, 2, -2))
            )
            z = z + shape.get("more", 0.0) * (p[0] - 1j * p[3]) * np.exp(3j * a)
            out = np.zeros((len(a), 3))
            out[:, i], out[:, j] = z.real, z.imag
            return out

        return Physics(axis_tilt=course)

    names = tuple(f"{m}_arcsec" for m in ("m1c", "m1s", "p2c", "p2s", "m2c", "m2s"))
    return Spec(
        "table_axis_wobble",
        "table",
        names,
        ARCSEC,
        20,
        tilt,
        (f"table_{name}", "tilt"),
        together=True,
        axes=(name,),
        odd=lambda r, lab: {"more": r.uniform(0.3, 1.0)},
    )


def _drive(lab: Lab) -> list[Spec]:
    k, where = 0, TILT
    specs = []

    def moved(curve: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray, Shape], Physics]:
        return lambda p, shape: _readout(k, lab, lambda past, t, a: p[0] * curve(a))

    # a horizontal axis feels the load. true = readout + d sin(readout)
    if lab.table in (
        "placing",
        "dual",
    ):

        def sag(p: np.ndarray, shape: Shape) -> Physics:
            return _readout(
                k,
                lab,
                lambda past, t, a: (
                    -p[0] * (np.sin(a) + shape.get("more", 0.0) * np.sin(a) * np.abs(np.sin(a)))
                ),
            )

        specs.append(
            Spec(
                "table_sag",
                "table",
                ("sag_arcsec",),
                ARCSEC,
                20,
                sag,
                where,
                odd=lambda r, lab: {"more": r.uniform(0.5, 1.5)},
            )
        )

    def pull(p: np.ndarray, shape: Shape) -> Physics:
        return _readout(
            k, lab, lambda past, t, a: -p[0] * (a + shape.get("more", 0.0) * a * np.abs(a))
        )

    def lost(sign: float) -> Callable[[np.ndarray, Shape], Physics]:
        def physics(p: np.ndarray, shape: Shape) -> Physics:
            width = shape.get("width", 0.02 * DEG)
            return _readout(
                k,
                lab,
                lambda past, t, a: (
                    sign
                    * p[0]
                    / 2
                    * past.at(t, ("lost", k, width), lambda: _direction(past, k, width))
                ),
            )

        return physics

    def lag(p: np.ndarray, shape: Shape) -> Physics:
        return _readout(
            k,
            lab,
            lambda past, t, a: (
                p[0] * (lab.track.angles(t + H)[:, k] - lab.track.angles(t - H)[:, k]) / (2 * H)
            ),
        )

    rounded = lambda r, lab: {"width": r.uniform(3, 15) * DEG}  # noqa: E731
    # there it shows as pulses of rate only, whose course nobody knows
    specs += [
        Spec(
            "cable_torque",
            "table",
            ("pull_arcsec_rad",),
            ARCSEC,
            20,
            pull,
            where,
            odd=lambda r, lab: {"more": r.uniform(0.1, 0.4)},
        ),
        Spec(
            "table_backlash",
            "table",
            ("width_arcsec",),
            ARCSEC,
            60,
            lost(1.0),
            ("table_outer", "move", "tilt"),
            odd=rounded,
            axes=("outer",),
            drawn=lab.table != "three",
        ),
    ]
    if lab.readout == "command":
        specs += [
            Spec(
                "servo_friction_deadband",
                "table",
                ("width_arcsec",),
                ARCSEC,
                40,
                lost(1.0),
                ("table_outer", "move", "tilt"),
                odd=rounded,
                drawn=lab.table != "three",
            ),
            Spec("servo_lag", "table", ("tau_ms",), 1e-3, 30, lag, ("rate", "time")),
        ]
    return specs


def _direction(past: Past, k: int, width: float) -> np.ndarray:
    """Direction of the last motion, reached over ``width`` of travel, rounded."""
    z = play(past.column("angles", k), width / 2)
    z = np.tanh(2 * z) / np.tanh(2.0) if width > DEG else z
    soft = np.hanning(11) / np.hanning(11).sum()
    return np.convolve(np.pad(z, 5, "edge"), soft, "valid")


def _events(lab: Lab) -> list[Spec]:
    def ring(p: np.ndarray, shape: Shape) -> Physics:
        def course(past: Past, t: np.ndarray, a: np.ndarray) -> np.ndarray:
            since = lab.track.since_arrival(t)
            soft = np.clip(since / 0.08, 0, 1)
            return (
                -p[0]
                * soft**2
                * (3 - 2 * soft)
                * np.exp(-since / shape["tau"])
                * np.cos(2 * np.pi * shape["hertz"] * since)
            )

        return _readout(0, lab, course)

    def index(p: np.ndarray, shape: Shape) -> Physics:
        """Each stop somewhere else, by chance; the way there is smooth."""
        stops = np.array(lab.track.dwells)
        draws = np.random.default_rng(shape["seed"]).standard_normal(len(stops))
        at, value = stops.ravel(), np.repeat(draws, 2)

        def course(past: Past, t: np.ndarray, a: np.ndarray) -> np.ndarray:
            k = np.clip(np.searchsorted(at, t, side="right") - 1, 0, len(at) - 2)
            u = np.clip((t - at[k]) / np.maximum(at[k + 1] - at[k], 1e-9), 0, 1)
            return p[0] * (value[k] + (value[k + 1] - value[k]) * u**3 * (10 - 15 * u + 6 * u**2))

        return _readout(0, lab, course)

    shape_of = lambda r, lab: [{"tau": r.uniform(0.4, 1.2), "hertz": r.uniform(0.8, 3.0)}]  # noqa: E731
    return [
        Spec(
            "table_index_error",
            "table",
            ("sigma_arcsec",),
            ARCSEC,
            30,
            index,
            (*TILT, "move"),
            later="none",
            shapes=lambda r, lab: [{"seed": int(r.integers(2**31))}],
            drawn=lab.table in ("placing", "dual"),
        ),
        Spec(
            "settling_transient",
            "table",
            ("amplitude_arcsec",),
            ARCSEC,
            200,
            ring,
            ("time", "move"),
            shapes=shape_of,
            extra=lambda s: {"tau_s": s["tau"], "frequency_hz": s["hertz"]},
            drawn=lab.sensors[0].kind != "gyro" and lab.table != "vertical",
        ),
    ]
