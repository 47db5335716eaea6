"""Physics that no catalogue lists, invented by a second author who has not read the search.

What a metrologist has met or can imagine on inclinometers, rotary tables and gyros; here what
follows an angle, the load, the temperature or the time. Memories, bodies and gyros have files of
their own beside this one.
"""

import numpy as np

from blind.laboratory import Lab, Sensor
from blind.rotations import DEG
from blind.second_author_bodies import bodies
from blind.second_author_memory import memories
from blind.second_author_rates import gyros
from blind.second_author_terms import (
    PLACE,
    ShapesOf,
    drawn,
    hinge,
    inside,
    per_axis_effect,
    wrapped,
)
from blind.spec import G0, Shape, Spec
from blind.world import Past, State

LOAD = ("tilt", *PLACE)


def second_author(lab: Lab) -> list[Spec]:
    """All of them that this laboratory can have."""
    specs: list[Spec] = []
    force = next((s for s in lab.sensors if s.kind in ("accelerometer", "inclinometer")), None)
    if force and lab.written and not lab.unlocked:
        specs += _of_angle(lab, force) + _of_load(force) + _of_temperature(lab, force)
        specs += _of_time(lab, force) + memories(lab, force) + bodies(lab)
    if lab.table in ("three", "handheld") and len(lab.sensors) > 1:
        specs += gyros(lab)
    return specs


# --------------------------------------------------------------------------------------------------
# angles


def _of_angle(lab: Lab, force: Sensor) -> list[Spec]:
    """A sector with soft edges, a flexible print that comes to bear, a belt of no whole ratio."""

    def sector(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        x = wrapped(s.angles[:, shape["k"]] - shape["at"])
        edge = shape["edge"]
        return (np.tanh((x + shape["half"]) / edge) - np.tanh((x - shape["half"]) / edge)) / 2

    def bearing(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return hinge(shape["sign"] * (s.angles[:, shape["k"]] - shape["at"]), 0.05)

    def belt(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return np.exp(-((wrapped(shape["ratio"] * s.angles[:, 0] + shape["at"]) / 0.5) ** 2))

    def at(**more: tuple[float, float]) -> ShapesOf:
        def shapes(rng: np.random.Generator, lab: Lab) -> list[Shape]:
            k = int(rng.integers(len(lab.axes)))
            own = {"k": k, "at": inside(rng, lab, k), "sign": float(rng.choice([-1.0, 1.0]))}
            return [own | drawn(**more)(rng, lab)[0]]

        return shapes

    specs = [
        per_axis_effect(
            force,
            "sector",
            3000,
            sector,
            LOAD,
            shapes=at(half=(15 * DEG, 50 * DEG), edge=(3 * DEG, 9 * DEG)),
        ),
        per_axis_effect(force, "bearing", 3000, bearing, LOAD, shapes=at()),
        per_axis_effect(force, "belt", 3000, belt, LOAD, shapes=drawn(ratio=(1.3, 3.7), at=(0, 6))),
    ]
    return specs + (_of_two_angles(force) if len(lab.axes) > 1 else [])


def _of_two_angles(force: Sensor) -> list[Spec]:
    """Poles of one motor that pass poles of the other; two openings that come to face."""

    def poles(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        apart = s.angles[:, 0] - s.angles[:, -1]
        return np.tanh(4 * np.sin(shape["times"] * apart + shape["at"]))

    def openings(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        a, b = s.angles[:, 0] + shape["at"], s.angles[:, -1] + shape["other"]
        return np.exp(4 * (np.cos(a) * np.cos(b) - 1))

    return [
        per_axis_effect(
            force,
            "poles",
            3000,
            poles,
            LOAD,
            shapes=lambda r, lab: [{"times": int(r.integers(1, 5)), "at": float(r.uniform(0, 6))}],
        ),
        per_axis_effect(
            force, "openings", 4000, openings, LOAD, shapes=drawn(at=(0, 6), other=(0, 6))
        ),
    ]


# --------------------------------------------------------------------------------------------------
# load


def _of_load(force: Sensor) -> list[Spec]:
    """A stop inside a cone of loads; gains that follow the load across; channels rectified."""

    def stop(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return hinge(s.f @ np.array(shape["way"]) / G0 - shape["at"], 0.04)

    def ways(rng: np.random.Generator, lab: Lab) -> list[Shape]:
        way = rng.normal(size=3)
        way /= np.linalg.norm(way)
        return [{"way": tuple(float(x) for x in way), "at": float(rng.uniform(0.1, 0.6))}]

    def girth(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        across = s.f[:, (i + 1) % 3] / G0
        return -s.f[:, i] / G0 * np.expm1(-((across / shape["width"]) ** 2))

    def seat(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        across = s.f[:, (i + 2) % 3] / G0 - shape["at"]
        return s.f[:, i] / G0 * np.tanh(across / 0.06)

    def lesser(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return np.minimum(np.abs(s.f[:, (i + 1) % 3]), np.abs(s.f[:, (i + 2) % 3])) / G0

    def azimuth(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        x, y = s.f[:, (i + 1) % 3] / G0, s.f[:, (i + 2) % 3] / G0
        return np.hypot(x, y) * np.tanh(3 * np.sin(shape["lobes"] * np.arctan2(y, x) + shape["at"]))

    return [
        per_axis_effect(force, "stop", 4000, stop, LOAD, shapes=ways),
        per_axis_effect(force, "girth", 4000, girth, LOAD, shapes=drawn(width=(0.15, 0.5))),
        per_axis_effect(force, "seat", 3000, seat, LOAD, shapes=drawn(at=(-0.4, 0.4))),
        per_axis_effect(force, "lesser", 4000, lesser, LOAD),
        per_axis_effect(
            force,
            "azimuth",
            3000,
            azimuth,
            LOAD,
            shapes=lambda r, lab: [{"lobes": int(r.choice([3, 5])), "at": float(r.uniform(0, 6))}],
        ),
    ]


# --------------------------------------------------------------------------------------------------
# temperature and time


def _of_temperature(lab: Lab, force: Sensor) -> list[Spec]:
    """Scale by two masses that warm at two paces; heating only; a knee; rate and temperature."""
    room = lab.room

    def masses(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        apart = room.lagged(s.t, shape["quick"]) - room.lagged(s.t, shape["slow"])
        return apart * s.f[:, i] / G0

    def heating(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return hinge(room.slope_at(s.t) - shape["over"], 0.002)

    def knee(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return hinge(s.T - lab.T0 - shape["at"], 0.1)

    def swell(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return np.sqrt(np.abs(s.T - room.lagged(s.t, shape["slow"]))) * np.abs(s.f[:, i] / G0)

    warm = ("temperature", "time")
    return [
        per_axis_effect(
            force, "masses", 3000, masses, warm, shapes=drawn(quick=(3, 10), slow=(30, 90))
        ),
        per_axis_effect(
            force, "heating", 90000, heating, warm, shapes=drawn(over=(-0.01, 0.01)), suffix="ug_s"
        ),
        per_axis_effect(force, "knee", 3000, knee, warm, shapes=drawn(at=(-0.8, 0.8))),
        per_axis_effect(force, "swell", 3000, swell, (*warm, "tilt"), shapes=drawn(slow=(20, 60))),
    ]


def _of_time(lab: Lab, force: Sensor) -> list[Spec]:
    """A creep that slips back again and again; a scale that follows the sun, by day only."""
    end = lab.track.end_s

    def stick(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        edges = np.array([0.0, *shape["at"], 1.0])
        k = np.clip(np.searchsorted(edges, s.t / end, side="right") - 1, 0, len(edges) - 2)
        share = (s.t / end - edges[k]) / (edges[k + 1] - edges[k])
        return np.clip(share, 0, 1) ** shape["bent"]

    def instants(rng: np.random.Generator, lab: Lab) -> list[Shape]:
        teeth = np.cumsum(rng.uniform(0.5, 1.5, int(rng.integers(5, 10))))
        at = [float(x) for x in teeth[:-1] / teeth[-1]]
        return [{"at": at, "bent": float(rng.uniform(0.5, 2.0))}]

    def daylight(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return hinge(np.sin(2 * np.pi * s.t / (shape["days"] * end) + shape["at"]), 0.1) * (
            s.f[:, i] / G0
        )

    return [
        per_axis_effect(force, "stick", 2000, stick, ("time",), shapes=instants, later="none"),
        per_axis_effect(
            force,
            "daylight",
            4000,
            daylight,
            ("time", "tilt"),
            shapes=drawn(days=(0.2, 0.6), at=(0, 6)),
            later="none",
        ),
    ]
