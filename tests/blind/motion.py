"""Smooth moves between poses: angles of every axis at any instant, and a record of when nothing
moves.
"""

from dataclasses import dataclass, field

import numpy as np

SHORTEST_S = 1.2  # of a move: a shorter one is no longer smooth at 25 samples a second


@dataclass(frozen=True)
class Move:
    """One axis goes from one angle to another with soft ramps, or swings about where it stands."""

    axis: int
    start_s: float
    end_s: float
    from_rad: float
    to_rad: float
    ramp: float = 0.5  # share of the time spent on each ramp; 0.5: no cruise
    swing_rad: float = 0.0
    swings: int = 0

    def angle(self, t: np.ndarray) -> np.ndarray:
        """Angle at t. t: (n,), inside the move."""
        u = np.clip((t - self.start_s) / (self.end_s - self.start_s), 0.0, 1.0)
        if self.swings:
            edge = np.minimum(1.0, np.minimum(u, 1 - u) * self.swings)
            return self.from_rad + self.swing_rad * edge**3 * (
                10 - 15 * edge + 6 * edge**2
            ) * np.sin(2 * np.pi * self.swings * u)
        return self.from_rad + (self.to_rad - self.from_rad) * _soft(u, self.ramp)


def _soft(u: np.ndarray, ramp: float) -> np.ndarray:
    """Share of the way: the rate rises as 10 x^3 - 15 x^4 + 6 x^5, stays, and falls likewise."""
    up, down = np.clip(u / ramp, 0, 1), np.clip((1 - u) / ramp, 0, 1)
    way = ramp * _ramp(up) + np.clip(u - ramp, 0, 1 - 2 * ramp)
    return (way + ramp * (0.5 - _ramp(down))) / (1 - ramp)


def _ramp(x: np.ndarray) -> np.ndarray:
    return x**4 * (2.5 - 3 * x + x**2)


@dataclass(frozen=True)
class Track:
    """All moves of a recording. ``home``: (axes,) angles at the start."""

    home: tuple[float, ...]
    moves: tuple[Move, ...]
    end_s: float
    dwells: tuple[tuple[float, float], ...]

    def angles(self, t: np.ndarray) -> np.ndarray:
        """Angles of all axes. t: (n,), returns (n, axes)."""
        out = np.tile(np.array(self.home), (len(t), 1))
        for axis in range(len(self.home)):
            own = [m for m in self.moves if m.axis == axis]
            if not own:
                continue
            which = np.searchsorted([m.start_s for m in own], t, side="right") - 1
            for k in np.unique(which[which >= 0]):
                rows = which == k
                out[rows, axis] = own[k].angle(t[rows])
        return out

    def since_move(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Time since the last move ended (0 while moving) and number of moves begun. t: (n,)."""
        ends = np.array([a for a, _ in self.dwells])
        which = np.clip(np.searchsorted(ends, t, side="right") - 1, 0, None)
        rest = t <= np.array([b for _, b in self.dwells])[which]
        return np.where(rest, np.maximum(t - ends[which], 0.0), 0.0), which + (~rest).astype(int)

    def since_arrival(self, t: np.ndarray) -> np.ndarray:
        """Time since the last dwell that was arrived at by a move began; long before the first. t:
        (n,).
        """
        ends = np.array([-1e3, *(a for a, _ in self.dwells if a > 0)])
        return t - ends[np.searchsorted(ends, t, side="right") - 1]


@dataclass
class Plan:
    """Builds a track step by step."""

    at: list[float]
    clock_s: float = 0.0
    moves: list[Move] = field(default_factory=list)
    dwells: list[tuple[float, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.home = tuple(self.at)

    def dwell(self, seconds: float) -> None:
        """Stay."""
        self.dwells.append((self.clock_s, self.clock_s + seconds))
        self.clock_s += seconds

    def go(self, target: dict[int, float], rate_rad_s: float, ramp: float = 0.5) -> None:
        """Move axes at once; the slowest decides how long."""
        way = max(abs(angle - self.at[axis]) for axis, angle in target.items())
        if way < 1e-9:
            return
        lasts = max(way / rate_rad_s / (1 - ramp), SHORTEST_S)
        for axis, angle in target.items():
            if abs(angle - self.at[axis]) > 1e-9:
                self.moves.append(
                    Move(axis, self.clock_s, self.clock_s + lasts, self.at[axis], angle, ramp)
                )
                self.at[axis] = angle
        self.clock_s += lasts

    def swing(self, axis: int, amplitude_rad: float, hertz: float, swings: int) -> None:
        """Swing about the present angle."""
        lasts = swings / hertz
        here = self.at[axis]
        self.moves.append(
            Move(axis, self.clock_s, self.clock_s + lasts, here, here, 0.5, amplitude_rad, swings)
        )
        self.clock_s += lasts

    def track(self) -> Track:
        """What was planned."""
        return Track(self.home, tuple(self.moves), self.clock_s, tuple(self.dwells))
