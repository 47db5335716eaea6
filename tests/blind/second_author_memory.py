"""The second author's memories: terms that follow what has happened, and the drive of the table."""

import numpy as np

from blind.laboratory import Lab, Sensor
from blind.memory import leaky
from blind.second_author_terms import (
    PLACE,
    by_dwell,
    drawn,
    heat,
    per_axis_effect,
    rates,
    total_rate,
    way,
)
from blind.spec import G0, Shape, Spec
from blind.world import Past, State

HISTORY = ("move", "time", "tilt", *PLACE)


def memories(lab: Lab, force: Sensor) -> list[Spec]:
    """All of them."""
    return _of_poses(force) + _of_loops(force) + _of_work(force) + _of_drive(force)


def _of_poses(force: Sensor) -> list[Spec]:
    """What the pose before was, how far the way from it, how long ago it was left."""

    def before(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        def make() -> np.ndarray:
            starts = np.array([a for a, _ in past.lab.track.dwells])
            f = past.column("f", i)[
                np.minimum((starts / past.STEP_S).astype(int), len(past.grid) - 1)
            ]
            return by_dwell(past, np.tanh(2 * np.r_[f[:1], f[:-1]] / G0))

        return past.at(s.t, ("before", i), make)

    def last_way(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        def make() -> np.ndarray:
            starts = np.array([a for a, _ in past.lab.track.dwells])
            gone = np.abs(np.diff(past.lab.track.angles(starts), axis=0, prepend=0.0)).sum(1)
            gone[0] = 0.0
            return by_dwell(past, np.tanh(gone / shape["far"]))

        return past.at(s.t, ("last_way", shape["far"]), make)

    def stretched(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        since = past.lab.track.since_arrival(s.t)
        return np.exp(-((since / shape["tau"]) ** shape["bent"]))

    def streak(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return past.at(s.t, "streak", lambda: by_dwell(past, three_moves(past)))

    return [
        per_axis_effect(force, "before", 3000, before, HISTORY),
        per_axis_effect(force, "last_way", 4000, last_way, HISTORY, drawn(far=(0.3, 1.5))),
        per_axis_effect(
            force,
            "stretched",
            5000,
            stretched,
            ("move", "time"),
            drawn(tau=(0.3, 1.5), bent=(0.35, 0.6)),
        ),
        per_axis_effect(force, "streak", 3000, streak, HISTORY),
    ]


def three_moves(past: Past) -> np.ndarray:
    """Mean sense of the last three moves of the outermost axis that moves, -1 .. 1: (dwells,)."""
    starts = np.array([a for a, _ in past.lab.track.dwells])
    senses = np.zeros(len(starts))
    for m in past.lab.track.moves:
        if m.axis == 0 or len(past.lab.axes) > 2:
            later = np.searchsorted(starts, m.start_s, side="right")
            senses[min(later, len(senses) - 1)] = np.sign(m.to_rad - m.from_rad)
    last = [senses[: k + 1][senses[: k + 1] != 0][-3:] for k in range(len(starts))]
    return np.array([x.sum() / 3 for x in last])


def _of_loops(force: Sensor) -> list[Spec]:
    """Loops of unusual shape: a butterfly, and a pawl that lets go at one angle."""

    def butterfly(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        j = (i + 1) % 3
        return np.abs(past.play(s.t, "f", j, shape["half"] * G0)) * s.f[:, i] / G0

    def pawl(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        def make() -> np.ndarray:
            return ratchet(past.column("angles", 0), shape["back"])

        return past.at(s.t, ("pawl", shape["back"]), make)

    def soak(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        j = (i + 1) % 3

        def make() -> np.ndarray:
            return leaky(np.maximum(past.column("f", j) / G0, 0.0) ** 2, shape["tau"], past.STEP_S)

        return past.at(s.t, ("soak", j, shape["tau"]), make)

    return [
        per_axis_effect(force, "butterfly", 4000, butterfly, HISTORY, drawn(half=(0.1, 0.5))),
        per_axis_effect(force, "pawl", 3000, pawl, HISTORY, drawn(back=(0.6, 2.5))),
        per_axis_effect(force, "soak", 4000, soak, HISTORY, drawn(tau=(6, 30))),
    ]


def ratchet(angle: np.ndarray, back: float) -> np.ndarray:
    """Rises as the axis goes up, keeps when it goes down, and falls to nothing once it has gone
    down by ``back`` rad. angle: (m,); returns tanh of the rise.
    """
    risen, top, out = 0.0, float(angle[0]), np.empty(len(angle))
    last = top
    for k, a in enumerate(angle.tolist()):
        risen += max(a - last, 0.0)
        top = max(top, a)
        if top - a > back:
            risen, top = 0.0, a
        out[k], last = risen, a
    return np.tanh(out / 2)


def _of_work(force: Sensor) -> list[Spec]:
    """Heat of the moves, in the bias and in the scale; lubricant that the way has spread."""

    def warmed(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return past.at(s.t, ("heat", shape["tau"]), lambda: heat(past, shape["tau"])) * 10

    def worked(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return warmed(past, s, i, shape) * s.f[:, i] / G0

    def spread(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        return past.at(s.t, "way", lambda: way(past)) % shape["turn"] / shape["turn"]

    work = ("move", "time", "rate")
    return [
        per_axis_effect(force, "warmed", 5000, warmed, work, drawn(tau=(5, 40))),
        per_axis_effect(force, "worked", 8000, worked, (*work, "tilt"), drawn(tau=(5, 40))),
        per_axis_effect(force, "spread", 3000, spread, (*work, *PLACE), drawn(turn=(8, 16))),
    ]


def _of_drive(force: Sensor) -> list[Spec]:
    """The drive is heard: its current by the commutation, its braking in the supply."""

    def acceleration(past: Past) -> np.ndarray:
        return np.gradient(rates(past).sum(1), past.STEP_S)

    def current(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        push = past.at(s.t, "push", lambda: acceleration(past))
        return push * np.sin(shape["poles"] * s.angles[:, 0] + shape["at"])

    def braking(past: Past, s: State, i: int, shape: Shape) -> np.ndarray:
        def make() -> np.ndarray:
            fast = total_rate(past)
            return leaky(np.maximum(-np.gradient(fast**2, past.STEP_S), 0.0), 0.4, past.STEP_S)

        return past.at(s.t, "braking", make) * 10

    drive = ("rate", "move", "time", "frequency", *PLACE)
    return [
        per_axis_effect(force, "current", 50000, current, drive, drawn(poles=(4, 11), at=(0, 6))),
        per_axis_effect(force, "braking", 20000, braking, drive),
    ]
