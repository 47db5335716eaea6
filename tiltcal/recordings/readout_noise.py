"""The noise of a readout and of its stamps, told from the readout itself."""

from math import comb

import numpy as np

from tiltcal.core.arrays import NOWHERE, Array, Index, Mask
from tiltcal.core.quantisation import code_width
from tiltcal.statistics.dwell_noise import MAD_TO_SIGMA

RESTS = 32  # steps at rest that tell the readout's noise
FAST = 0.3  # of the fastest rate: there an error of the stamps shows
ORDERS = (4, 6, 8)  # of differences that tell it of an axis that never rests


def noise_of_rests(angle: Array, still: Mask, parted: Index = NOWHERE) -> float | None:
    """Standard deviation of a readout from row to row at rest, rad, at least that of its codes;
    None if it hardly rests. angle: rad, (n,).
    """
    both = still[1:] & still[:-1]
    both[parted - 1] = False  # what moved within a pause is no noise
    steps = np.diff(angle)[both]
    return (
        float(max(np.sqrt(np.mean(steps**2) / 2), code_width(angle) / np.sqrt(12)))
        if len(steps) > RESTS
        else None
    )


def noise_of_stamps(uniform: Array, pace: Array, noise: float) -> float:
    """How far stamps are off the instants of their rows (rounded, or late), standard deviation in
    samples: what higher differences of the readout show beyond its noise where it is fast.
    """
    least = np.inf
    for k in ORDERS:
        turned = pace[k // 2 : len(pace) - k // 2]
        fast = turned > FAST * pace.max()
        size = np.abs(np.diff(uniform, k))[fast] / np.sqrt(comb(2 * k, k))
        spread = MAD_TO_SIGMA * np.median(size / turned[fast])
        least = min(least, spread**2 - (noise / np.median(turned[fast])) ** 2)
    return float(np.sqrt(max(least, 0.0)))


def noise_of_motion(uniform: Array) -> float:
    """The least that higher differences of a readout at even times show, rad: there a smooth motion
    leaves nothing else. uniform: (n,).
    """
    return float(
        min(
            MAD_TO_SIGMA * np.median(np.abs(np.diff(uniform, k))) / np.sqrt(comb(2 * k, k))
            for k in ORDERS
        )
    )
