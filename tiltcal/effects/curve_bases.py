"""Forms of a learned curve, and their derivatives: harmonics, a power, transients."""

from collections.abc import Sequence

import numpy as np

from tiltcal.core.arrays import Array


def harmonics_of(u: Array, order: int, count: int, pace: float) -> Array:
    """cos(pace u), sin(pace u), cos(2 pace u), ..., or a derivative, (n, count)."""
    turn = np.exp(1j * pace * u)
    wave = np.ones_like(turn)
    columns = np.empty((len(u), count))
    for k in range(count):
        if k % 2 == 0:
            wave = wave * turn
        slope = (1j * (k // 2 + 1) * pace) ** order * (1 if k % 2 == 0 else -1j)
        columns[:, k] = (slope * wave).real
    return columns


def power_of(u: Array, order: int, power: float, odd: bool) -> Array:
    """|u|^power, with the sign of u where it is odd, or a derivative, (n,)."""
    factor = float(np.prod(power - np.arange(order)))
    sign = np.sign(u) if odd != (order % 2 == 1) else 1.0
    # a root has no slope at nothing: it is left out
    away = np.where(u == 0, np.inf if power < order else 0.0, np.abs(u))
    return np.asarray(factor * sign * away ** (power - order)) if factor else np.zeros_like(u)


def transients_at(
    u: Array, order: int, instants: Sequence[float], rise: float, fall: float
) -> Array:
    """What rises evenly to one at each instant and falls exponentially from there, or a derivative
    without what its kinks make, (n, p).
    """
    since = u[:, None] - np.array(instants)
    falling = (-1 / fall) ** order * np.exp(-np.maximum(since, 0.0) / fall)
    rising = (1 + np.minimum(since, 0.0) / rise, np.full_like(since, 1 / rise), 0 * since)[order]
    return np.where(since < 0, np.where(since > -rise, rising, 0.0), falling)
