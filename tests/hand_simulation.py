"""A sensor in a hand: own physics, numpy only. It turns to the pose that is asked for, misses it by
some degrees, trembles on the way, and stands still on something firm.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

G = 9.80123  # m/s2
AXES = "xyz"


def scenario(table: str = "handheld", rate_hz: float = 100.0, **sensor: object) -> dict:
    """A scenario of an accelerometer triad, as the table of its file."""
    accel = {
        "name": "accel",
        "kind": "accelerometer",
        "rate_hz": rate_hz,
        "adjustable": ["bias", "scale", "cross_axis"],
    }
    return {
        "schema": 1,
        "name": "live",
        "site": {"gravity_m_s2": G},
        "rig": {"table": table},
        "sensor": [accel | sensor],
        "effect": [{"id": "acc_noise", "white_ug_rthz": 100.0}],
    }


@dataclass
class Hand:
    """A triad in a hand.

    Args:
        rate_hz: samples a second.
        off_deg: how far a pose is missed.
        bias: m/s2, (3,).
        matrix: reading by specific force, (3, 3).
        white: noise of a sample, m/s2.
        drift: of the bias, m/s2 a second, (3,).
        limit: readings beyond are cut off, m/s2.
        extra: readings of further columns at standstill.
    """

    rate_hz: float = 100.0
    off_deg: float = 8.0
    bias: np.ndarray = field(default_factory=lambda: np.array([0.05, -0.08, 0.11]))
    matrix: np.ndarray = field(
        default_factory=lambda: (
            np.eye(3) + np.array([[4e-3, 1e-3, -2e-3], [1e-3, -3e-3, 5e-4], [-2e-3, 5e-4, 6e-3]])
        )
    )
    white: float = 100e-6 * 9.80665 * 10.0
    drift: np.ndarray = field(default_factory=lambda: np.zeros(3))
    limit: float = np.inf
    seed: int = 1
    time: float = 0.0
    up: np.ndarray = field(default_factory=lambda: np.array([0.3, -0.2, 0.93]))

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.up = self.up / np.linalg.norm(self.up)

    def turn(self, up: np.ndarray, seconds: float = 2.0) -> tuple[np.ndarray, dict]:
        """Samples of a move to about some direction."""
        aim = np.asarray(up, float)
        if self.off_deg:
            across = np.cross(aim, self.rng.normal(size=3))
            across /= np.linalg.norm(across)
            off = np.radians(self.off_deg) * self.rng.uniform(0.6, 1.2)
            aim = np.cos(off) * aim + np.sin(off) * across
        n = round(seconds * self.rate_hz)
        share = (1 - np.cos(np.pi * (np.arange(n) + 1) / n)) / 2
        way = self.up + share[:, None] * (aim - self.up)
        if np.linalg.norm(self.up + aim) < 0.5:  # over: not through zero
            side = np.cross(aim, [0.3, 0.9, -0.2])
            way += np.sin(np.pi * share)[:, None] * side / np.linalg.norm(side)
        way /= np.linalg.norm(way, axis=1)[:, None]
        phase = 2 * np.pi * 9.0 * np.arange(n) / self.rate_hz
        tremble = 0.6 * np.sin(phase[:, None] + self.rng.uniform(0, 6, 3))
        tremble += self.rng.normal(0, 0.3, (n, 3))
        self.up = way[-1]
        return self._read(G * way + tremble)

    def hold(self, seconds: float) -> tuple[np.ndarray, dict]:
        """Samples at standstill."""
        n = round(seconds * self.rate_hz)
        return self._read(np.tile(G * self.up, (n, 1)))

    def _read(self, force: np.ndarray) -> tuple[np.ndarray, Mapping[str, np.ndarray]]:
        n = len(force)
        time = self.time + np.arange(1, n + 1) / self.rate_hz
        self.time = float(time[-1])
        read = self.bias + force @ self.matrix.T + time[:, None] * self.drift
        read += self.rng.normal(0, self.white, (n, 3))
        read = np.clip(read, -self.limit, self.limit)
        return time, {f"accel_{a}_m_s2": read[:, k] for k, a in enumerate(AXES)}


def follow(guide, hand: Hand, dwells: int = 40, hold_s: float = 6.0) -> int:
    """Turn to what a guide proposes until it is done; the number of turns."""
    for number in range(dwells):
        if guide.state.done:
            return number
        asked = guide.state.next
        guide.feed(*hand.turn(np.array(asked.up)))
        guide.feed(*hand.hold(hold_s))
    return dwells
