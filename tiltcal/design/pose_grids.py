"""Poses that stand for all allowed ones: a grid where axes are few, evenly spread ones where they
are many.
"""

from collections.abc import Sequence

import numpy as np

from tiltcal.core.arrays import Array

Limits = Sequence[tuple[float, float] | None]


def grid(limits: Limits, step: float, shift: float = 0.0) -> Array:
    """All poses on a grid of the allowed angles, rad, (n, axes).

    Args:
        limits: least and largest angle of each axis, rad; None: a turn without end.
        step: of the grid, rad.
        shift: of the grid of an axis without limits, rad.
    """
    axes = [
        np.arange(-np.pi, np.pi - 1e-9, step) + shift
        if pair is None
        else np.linspace(*pair, max(2, round((pair[1] - pair[0]) / step) + 1))
        for pair in limits
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def spread(limits: Limits, count: int) -> Array:
    """Allowed poses that fill the angles evenly, rad, (count, axes): a Kronecker sequence.

    Source: Roberts 2018, *The unreasonable effectiveness of quasirandom sequences*: multiples of
    the inverse powers of the root of x^(d+1) = x + 1, in d dimensions.
    """
    d, root = len(limits), 2.0
    for _ in range(60):
        root = (1 + root) ** (1 / (d + 1))
    shares = (0.5 + np.outer(np.arange(1, count + 1), root ** -np.arange(1.0, d + 1))) % 1
    low, high = np.array([pair or (-np.pi, np.pi) for pair in limits]).T
    return np.asarray(low + shares * (high - low))
