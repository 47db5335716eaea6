"""A composite instrument turned about its axes at a constant rate: block means by hand, the case of
the bound.
"""

import numpy as np

from tiltcal.calibration.methods.field_log import BLOCK, FieldLog
from tiltcal.core.units import DEG

U = np.ones(3) / np.sqrt(3)
MEMS, FOG_NOISE = 0.34 * DEG / 60, 0.02 * DEG / 60  # rad per square root of s
RATE, TURN, REST = 60 * DEG, 390 * DEG, 10.0
SCALE = np.array([2e-3, -2e-3, 1e-3])
NSUM2 = MEMS**2 + FOG_NOISE**2
# white noise only: what the patent's filter claims
PLAIN = np.sqrt(NSUM2 / (U[0] ** 2 * RATE * TURN))
BOUND = np.sqrt(PLAIN**2 + NSUM2 / REST * (TURN / RATE) ** 2 / (U[0] * TURN) ** 2)


def turned_about_each_axis(
    rng: np.random.Generator | None,
    scale: np.ndarray = SCALE,
    axis: np.ndarray = U,
    assumed: np.ndarray = U,
    fog_bias: float = 1e-6,
) -> FieldLog:
    """Ten seconds of rest, then 390 deg about x, y, z at 60 deg/s; no rest between."""
    still, turning = round(REST / BLOCK), round(TURN / RATE / BLOCK)
    w = np.zeros((still + 3 * turning, 3))
    for i in range(3):
        w[still + i * turning : still + (i + 1) * turning, i] = RATE
    n = len(w)
    rate, fog = (1 + scale) * w + [0.01, -0.02, 0.03], w @ axis + fog_bias
    if rng is not None:
        rate = rate + rng.normal(size=(n, 3)) * MEMS / np.sqrt(BLOCK)
        fog = fog + rng.normal(size=n) * FOG_NOISE / np.sqrt(BLOCK)
    rest = np.where(np.arange(n) < still, 0, -1)
    bias = np.append(rate[:still].mean(axis=0), fog[:still].mean())
    return FieldLog(
        BLOCK * np.arange(n), np.full(n, BLOCK), rate, fog, None, rest, assumed, NSUM2, bias
    )
