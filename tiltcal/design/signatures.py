"""What known effects leave in the readings of a triad on a dual table, for designs that shall be blind to none of them.

An effect acts on all axes (or at all phases) with one size; its energy at a pose is the sum over its columns and channels.
Units: g per unit coefficient. The sign of f is smoothed over 5 deg: what no table could set apart is no pose.
"""

import numpy as np

from tiltcal.design.polynomial import dual_up
from tiltcal.frames import Array
from tiltcal.units import DEG

SOFT_SIGN = np.sin(5 * DEG)
EFFECTS = (
    "K2", "K3", "Kip", "Kio", "Kpo", "|f|", "sgn f", "outer 1st harmonic", "inner 1st harmonic", "outer 2nd harmonic",
    "inner 2nd harmonic",
)  # fmt: skip
GROUP = np.array([0, 1, 2, 3, 4, 5, 6, 7, 7, 8, 8, 9, 9, 10, 10])
"""Effect of each column."""


def linear_part(up: Array) -> Array:
    """What the ordinary terms of one channel explain: 1, x, y, z, (n, 4)."""
    return np.column_stack([np.ones(len(up)), up])


def signatures(angles: Array) -> Array:
    """Columns at poses, (n, 3 channels, columns). angles: outer, inner, rad, (n, 2)."""
    up = dual_up(angles)
    a, b = angles.T
    ahead, behind = np.roll(up, -1, axis=1), np.roll(up, -2, axis=1)
    columns = [up**2, up**3, up * ahead, up * behind, ahead * behind, np.abs(up), np.tanh(up / SOFT_SIGN)]
    by_outer = np.column_stack([np.cos(a) * np.sin(b), np.cos(a) * np.cos(b), -np.sin(a)])
    by_inner = np.column_stack([np.sin(a) * np.cos(b), -np.sin(a) * np.sin(b), 0 * a])
    for m in (1, 2):
        for angle, slope in ((a, by_outer), (b, by_inner)):
            columns += [slope * np.cos(m * angle)[:, None], slope * np.sin(m * angle)[:, None]]
    return np.stack(columns, axis=2)


def left_over(angles: Array, weight: Array) -> tuple[Array, Array]:
    """Energy of each effect that the linear terms, fitted with these weights, leave at each pose, (n, effects); M, (4, 4)."""
    F, E = linear_part(dual_up(angles)), signatures(angles)
    flat = E.reshape(len(E), -1)
    M = F.T @ (weight[:, None] * F) + 1e-9 * np.eye(4)
    rest = flat - F @ np.linalg.solve(M, F.T @ (weight[:, None] * flat))
    energy = (rest**2).reshape(E.shape).sum(axis=1)
    return energy @ np.eye(len(EFFECTS))[GROUP], M


def efficiency(angles: Array) -> float:
    """D-efficiency of the linear terms: det(F'F / n)^(1/4) over the bound 27^(-1/4), which six positions reach."""
    F = linear_part(dual_up(angles))
    return float(max(np.linalg.det(F.T @ F / len(F)), 0.0) ** 0.25 * 27**0.25)
