"""What every case of the examiner has, and the course of a log: dwells joined by short moves."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

G = 9.80123
OMEGA = 7.292115e-5
UG = 9.80665e-6
ARCSEC = np.pi / 648000
DEG = np.pi / 180
DEG_H = DEG / 3600


@dataclass
class Case:
    """One recording with what is known of it.

    Args:
        method: to run on it, with its options.
        table: of the rig; sensors: as a scenario states them.
        time: stamps, s; columns: by name; labels: of the operator.
        truth: parameters that the method should return, SI.
        fault: name of what is wrong; "clean" where nothing is.
        cause: regular expression that a true statement of the cause matches.
        latitude: as the scenario states it, deg; mount: metadata.
        limits: by how much a parameter may be off and not count as wrong, SI.
    """

    method: str
    table: str
    sensors: list[dict[str, object]]
    time: np.ndarray
    columns: dict[str, np.ndarray]
    truth: dict[str, float]
    fault: str = "clean"
    cause: str = ""
    labels: list[str | None] | None = None
    options: dict[str, object] = field(default_factory=dict)
    latitude: float | None = None
    mount: str = ""
    limits: dict[str, float] = field(default_factory=dict)


@dataclass
class Course:
    """Dwells and moves on one time base.

    Args:
        time: s, (n,); dwell: number of the dwell, -1 while moving, (n,).
        fraction: position between dwells: dwell k stands at k, a move runs from k to k + 1, (n,).
    """

    time: np.ndarray
    dwell: np.ndarray
    fraction: np.ndarray

    @classmethod
    def of(cls, dwells: int, seconds: float, move: float, rate: float) -> "Course":
        """That many dwells of some seconds each, joined by moves."""
        step, n, m = 1 / rate, round(seconds * rate), round(move * rate)
        number, fraction = [], []
        for k in range(dwells):
            number += [k] * n
            fraction += [float(k)] * n
            if k < dwells - 1:
                s = (np.arange(m) + 0.5) / m
                number += [-1] * m
                fraction += list(k + s * s * (3 - 2 * s))
        return cls(np.arange(len(number)) * step, np.array(number), np.array(fraction))

    def follow(self, values: np.ndarray) -> np.ndarray:
        """Values of the dwells, (m,) or (m, k), at every row, straight between dwells."""
        values = np.asarray(values, dtype=float)
        knots = np.arange(len(values))
        if values.ndim == 1:
            return np.interp(self.fraction, knots, values)
        return np.column_stack(
            [np.interp(self.fraction, knots, values[:, i]) for i in range(values.shape[1])]
        )

    def turned(self, up: np.ndarray) -> np.ndarray:
        """Unit vectors at every row, along great circles between those of the dwells, (n, 3)."""
        low = np.clip(np.floor(self.fraction).astype(int), 0, len(up) - 1)
        high = np.minimum(low + 1, len(up) - 1)
        s = self.fraction - low
        a, b = up[low], up[high]
        c = np.clip((a * b).sum(axis=1), -1, 1)
        opposite = c < -0.999
        side = np.cross(a, np.roll(a, 1, axis=1))
        side /= np.maximum(np.linalg.norm(side, axis=1), 1e-9)[:, None]
        across = np.where(opposite[:, None], side, b - c[:, None] * a)
        size = np.linalg.norm(across, axis=1)
        across = across / np.maximum(size, 1e-12)[:, None]
        angle = np.arccos(c) * s
        return np.cos(angle)[:, None] * a + np.sin(angle)[:, None] * across

    def labels(self, names: Sequence[str]) -> list[str | None]:
        """The dwell's name at every row, None while moving."""
        return [None if k < 0 else names[k] for k in self.dwell]


Fault = tuple[str, str]  # name, regular expression of the cause
Maker = Callable[[np.random.Generator, str], Case]
FAULTS: dict[str, Mapping[str, str]] = {}
MAKERS: dict[str, Maker] = {}


def system(name: str, faults: Mapping[str, str]) -> Callable[[Maker], Maker]:
    """Register the maker of a system's cases with its faults and how each may be named."""

    def register(maker: Maker) -> Maker:
        MAKERS[name], FAULTS[name] = maker, faults
        return maker

    return register


def rotation(axis: str, angle: np.ndarray | float) -> np.ndarray:
    """Right-handed rotation by an angle or by (n,) angles about a coordinate axis, (..., 3, 3)."""
    angle = np.asarray(angle, dtype=float)
    R = np.zeros((*angle.shape, 3, 3))
    i = "xyz".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    R[..., i, i] = 1
    R[..., j, j] = R[..., k, k] = np.cos(angle)
    R[..., k, j], R[..., j, k] = np.sin(angle), -np.sin(angle)
    return R


def to_codes(values: np.ndarray, code: float) -> np.ndarray:
    """Values as a converter of that code width reads them."""
    return np.round(values / code) * code if code > 0 else values


def decaying(time: np.ndarray, size: float, constant: float) -> np.ndarray:
    """Warm-up: starts at ``size`` and dies away."""
    return size * np.exp(-(time - time[0]) / constant)
