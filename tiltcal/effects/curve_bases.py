"""Forms of a learned curve, and their derivatives: harmonics, splines, a power, transients."""

from collections.abc import Sequence

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.statistics.splines import cardinal_splines


def harmonics_of(u: Array, order: int, count: int, pace: float) -> Array:
    """cos(pace u), sin(pace u), cos(2 pace u), ..., or a derivative, (n, count)."""
    turn = np.exp(1j * pace * u)
    wave, columns = np.ones_like(turn), np.empty((count, len(u)))
    for k in range(count):
        if k % 2 == 0:
            wave = wave * turn
        # the real part of i^quarters times the wave; a sine is a quarter turn behind
        quarters = (order - k % 2) % 4
        part = wave.real if quarters % 2 == 0 else wave.imag
        size = float((k // 2 + 1) * pace) ** order
        np.multiply(part, -size if quarters in (1, 2) else size, out=columns[k])
    return columns.T


def spline_of(
    u: Array,
    order: int,
    knots: Sequence[float],
    period: float,
    weights: Array,
    *,
    parabola: bool,
    holds: bool,
) -> Array:
    """Sums of the splines that are one at each knot, or a derivative, (n, m).

    Args:
        u: coordinates, (n,).
        order: of the derivative.
        knots: (p,).
        period: after which it begins again, 0 for none.
        weights: of each spline, (p, m).
        parabola: whether it is that through three knots.
        holds: whether it is clamped to its last value beyond its knots. Else it extrapolates: a
            parabola as it is, others by their mean slope, as an end is as uncertain as a few
            readings there.
    """
    from scipy.interpolate import PPoly

    u = knots[0] + (u - knots[0]) % period if period else u
    each = cardinal_splines(tuple(knots), *(("not-a-knot",) if parabola else ()))
    spline = PPoly(each.c @ weights, each.x)
    if parabola and not holds:
        return np.asarray(spline(u, order))
    inside = np.clip(u, knots[0], knots[-1])
    beyond, found = (u - inside)[:, None], np.asarray(spline(inside, order))
    if not beyond.any():
        return found
    middle = np.array(knots) - np.mean(knots)
    slope = middle / (middle @ middle) @ weights if not holds else np.zeros(1)
    if order == 0:
        return found + slope * beyond
    return np.where(beyond == 0, found, slope if order == 1 else 0.0)


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
