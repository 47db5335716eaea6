"""The second author's bodies and clocks: base, axis, plate and stamps that follow something."""

from collections.abc import Callable

import numpy as np

from blind.laboratory import Lab
from blind.memory import leaky
from blind.rotations import ARCSEC
from blind.second_author_memory import three_moves
from blind.second_author_terms import (
    PLACE,
    STRENGTH,
    ShapesOf,
    by_dwell,
    drawn,
    hinge,
    inside,
    total_rate,
    way,
)
from blind.spec import Shape, Spec, unlisted_effect
from blind.world import Past, Physics

Course = Callable[[Past, np.ndarray, Shape], np.ndarray]
XYZ = ("x_arcsec", "y_arcsec", "z_arcsec")
EAST_NORTH = ("east_arcsec", "north_arcsec")
WHERE = ("tilt", *PLACE)


def bodies(lab: Lab) -> list[Spec]:
    """All of them."""
    return _base(lab) + _plate() + _axis(lab) + _clock(lab)


def _moved(
    stem: str,
    stage: str,
    names: tuple[str, ...],
    size: float,
    physics: Callable[[np.ndarray, Shape], Physics],
    where: tuple[str, ...],
    shapes: ShapesOf,
    unit: float = ARCSEC,
    later: str = "same",
) -> Spec:
    own = tuple(f"{stem}_{n}" for n in names)
    return unlisted_effect(
        f"s_{stem}",
        own,
        unit,
        size,
        physics,
        where,
        stage=stage,
        shapes=shapes,
        later=later,
        together=True,
        strength=STRENGTH,
    )


def _base(lab: Lab) -> list[Spec]:
    """A pier that gives way slowly as the weight comes round; an operator's footsteps."""

    def leaning(course: Course) -> Callable[[np.ndarray, Shape], Physics]:
        def physics(p: np.ndarray, shape: Shape) -> Physics:
            return Physics(base=lambda past, t: np.outer(course(past, t, shape), np.append(p, 0.0)))

        return physics

    def pier(past: Past, t: np.ndarray, shape: Shape) -> np.ndarray:
        def make() -> np.ndarray:
            load = np.sin(past.column("angles", 0) + shape["at"])
            return leaky(load, shape["tau"], past.STEP_S) - load

        return past.at(t, ("pier", shape["at"], shape["tau"]), make)

    def steps(past: Past, t: np.ndarray, shape: Shape) -> np.ndarray:
        here = [a + 1.2 for a, _ in lab.track.dwells][shape["first"] :: shape["every"]]
        return sum((np.exp(-(((t - a) / 0.5) ** 2)) for a in here), np.zeros(len(t)))

    def walks(rng: np.random.Generator, lab: Lab) -> list[Shape]:
        return [{"first": int(rng.integers(1, 4)), "every": int(rng.integers(4, 8))}]

    return [
        _moved(
            "pier",
            "environment",
            EAST_NORTH,
            90,
            leaning(pier),
            ("time", "move", *WHERE),
            drawn(at=(0, 6), tau=(2, 15)),
        ),
        _moved(
            "footsteps",
            "environment",
            EAST_NORTH,
            90,
            leaning(steps),
            ("time", "move"),
            walks,
            later="none",
        ),
    ]


def _plate() -> list[Spec]:
    """The plate tips: on three feet, with the way gone, with the film of oil, after a streak."""

    def tipping(course: Course) -> Callable[[np.ndarray, Shape], Physics]:
        def physics(p: np.ndarray, shape: Shape) -> Physics:
            return Physics(mount=lambda past, t, up: np.outer(course(past, t, shape), p))

        return physics

    def feet(p: np.ndarray, shape: Shape) -> Physics:
        def tip(past: Past, t: np.ndarray, up: np.ndarray) -> np.ndarray:
            across = np.hypot(up[:, 0], up[:, 1])
            side = np.cos(3 * np.arctan2(up[:, 1], up[:, 0]) + shape["at"])
            return np.outer(np.tanh(4 * across * side), p)

        return Physics(mount=tip)

    def loose(past: Past, t: np.ndarray, shape: Shape) -> np.ndarray:
        if shape.get("settled"):
            return np.ones(len(t))
        return -np.expm1(-past.at(t, "way", lambda: way(past)) / shape["radians"])

    def film(past: Past, t: np.ndarray, shape: Shape) -> np.ndarray:
        def make() -> np.ndarray:
            return leaky(np.tanh(total_rate(past) / shape["fast"]), 0.2, past.STEP_S)

        return past.at(t, ("film", shape["fast"]), make)

    def streak(past: Past, t: np.ndarray, shape: Shape) -> np.ndarray:
        return past.at(t, "lean", lambda: by_dwell(past, three_moves(past), 0.5))

    moves = ("move", "time", "rate", *WHERE)
    return [
        _moved("feet", "mount", XYZ, 60, feet, WHERE, drawn(at=(0, 6))),
        _moved(
            "loose", "mount", XYZ, 150, tipping(loose), moves, drawn(radians=(4, 25)), later="after"
        ),
        _moved("film", "table", XYZ, 60, tipping(film), moves, drawn(fast=(0.1, 0.4))),
        _moved("lean", "mount", XYZ, 60, tipping(streak), moves, lambda r, lab: [{}]),
    ]


def _axis(lab: Lab) -> list[Spec]:
    """The outer axis leans once the hose is taut; the readout remembers heat of the room."""

    def taut(p: np.ndarray, shape: Shape) -> Physics:
        def tilt(past: Past, k: int, a: np.ndarray) -> np.ndarray | None:
            if k != 0:
                return None
            out = np.zeros((len(a), 3))
            pull = hinge(shape["sign"] * (a - shape["at"]), 0.1)
            for n in (0, 1):
                out[:, (lab.axes[0] + 1 + n) % 3] = p[n] * pull
            return out

        return Physics(axis_tilt=tilt)

    def at(rng: np.random.Generator, lab: Lab) -> list[Shape]:
        return [{"at": inside(rng, lab, 0), "sign": float(rng.choice([-1.0, 1.0]))}]

    def scale(p: np.ndarray, shape: Shape) -> Physics:
        """The disc of the readout grows off its centre as the room warms."""

        def error(past: Past, t: np.ndarray) -> np.ndarray:
            angles = past.angles(lab.track, t)
            out = np.zeros_like(angles)
            warm = lab.room.lagged(t, 10.0) - lab.T0
            out[:, 0] = warm * (p[0] * np.cos(angles[:, 0]) + p[1] * np.sin(angles[:, 0]))
            return out

        return Physics(readout=error)

    return [
        _moved("taut", "table", ("c_arcsec", "s_arcsec"), 60, taut, WHERE, at),
        _moved(
            "disc",
            "table",
            ("c_arcsec", "s_arcsec"),
            60,
            scale,
            ("temperature", "time", *WHERE),
            lambda r, lab: [{}],
        ),
    ]


def _clock(lab: Lab) -> list[Spec]:
    """Stamps that are wrong by what the clock's crystal, its corrections or the sense of turning
    follow.
    """

    def stamped(course: Callable[[np.ndarray, Shape], np.ndarray]):  # type: ignore[no-untyped-def]
        def physics(p: np.ndarray, shape: Shape) -> Physics:
            return Physics(stamps=lambda t: t - p[0] * course(t, shape))

        return physics

    def crystal(t: np.ndarray, shape: Shape) -> np.ndarray:
        return np.tanh((lab.room.at(t) - lab.T0) / 0.7)

    def corrected(t: np.ndarray, shape: Shape) -> np.ndarray:
        return (t / shape["every"] + shape["at"]) % 1.0 - 0.5

    def one_way(t: np.ndarray, shape: Shape) -> np.ndarray:
        step = 5e-3
        rate = (lab.track.angles(t + step) - lab.track.angles(t - step))[:, 0] / (2 * step)
        return (1 + np.tanh(shape["sign"] * rate / shape["fast"])) / 2

    def senses(rng: np.random.Generator, lab: Lab) -> list[Shape]:
        sign = float(rng.choice([-1.0, 1.0]))
        return [{"sign": sign, "fast": float(rng.uniform(0.02, 0.1))}]

    late, where = ("ms",), ("rate", "time", "move", "sample")
    return [
        _moved(
            "crystal",
            "timing",
            late,
            40,
            stamped(crystal),
            ("temperature", *where),
            lambda r, lab: [{}],
            unit=1e-3,
        ),
        _moved(
            "corrected",
            "timing",
            late,
            40,
            stamped(corrected),
            ("frequency", *where),
            drawn(every=(11, 35), at=(0, 1)),
            unit=1e-3,
        ),
        _moved("one_way", "timing", late, 40, stamped(one_way), where, senses, unit=1e-3),
    ]
