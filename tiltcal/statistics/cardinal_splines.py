"""Cubic splines that are one at one knot and zero at the others."""

from functools import cache
from typing import Any, Literal

import numpy as np


@cache
def cardinal_splines(
    knots: tuple[float, ...], ends: Literal["natural", "not-a-knot"] = "natural"
) -> Any:
    """The cubic splines that are one at a knot and zero at the others; of three knots that are
    ``not-a-knot`` the parabolas.
    """
    from scipy.interpolate import CubicSpline, PPoly

    if len(knots) == 2:  # straight: nothing to solve
        slope = 1 / (knots[1] - knots[0])
        return PPoly(np.array([[[-slope, slope]], [[1.0, 0.0]]]), knots)
    return CubicSpline(knots, np.eye(len(knots)), bc_type=ends)
