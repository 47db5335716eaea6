"""Derivatives of evenly sampled values by local polynomials, each from the window that tells it
best.
"""

from itertools import product

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.recordings.rest_edges import STRICT

DEGREES = (4, 6)  # of the local polynomials: a fast swing bends more than a quartic does
# samples of them: those that leave no more than the readout's own noise
WIDTHS = (5, 7, 9, 11, 15, 19, 25, 33, 41)
AROUND = (0.2, 0.35, 0.5, 0.65, 0.8)  # in a window, of the sample whose rate it tells
BESIDE = (0.0, 1.0)  # where no window around a sample fits: next to a corner


def by_best_windows(u: Array, noise: Array) -> tuple[Array, Array, Array, Array]:
    """First and second derivative per sample, each from the polynomial of the window that is best
    for it, and the expected squares of the errors of both, (n,) each.

    That is the variance and the square of the bias, told from what a polynomial of two degrees
    more has (Ruppert, J. Am. Stat. Assoc. 92, 1997). The narrowest window where none fits.

    Args:
        u: angle, rad. noise: of each sample, rad, (n,).
    """
    n = len(u)
    told, error = _by_narrowest(u, noise)
    narrowest = error.copy()
    for row in _ends(n):  # no window is around them
        error[:, row] = np.inf
    kept = np.ones((2, n), bool)
    fitting = {(w, d): fits(u, w, d, noise) for d, w in product(DEGREES, WIDTHS) if d + 1 < w < n}
    for places in (AROUND, BESIDE):
        wanted = np.ones((2, n), bool) if places is AROUND else error >= narrowest
        for ((width, degree), fit), share in product(fitting.items(), places):
            place = round(share * (width - 1))
            rows = slice(place, n - width + 1 + place)
            each = _weights(width, place, degree)
            more = _weights(width, place, degree + 2) if width > degree + 3 else each
            for k, weights in enumerate(each):
                expected = float(weights @ weights) * noise[rows] ** 2
                expected = expected + _bias(u, more[k] - weights, noise[rows])
                better = fit & wanted[k, rows] & (expected < error[k, rows])
                if better.any():
                    found = np.convolve(u, weights[::-1], mode="valid")
                    told[k, rows] = np.where(better, found, told[k, rows])
                    error[k, rows] = np.where(better, expected, error[k, rows])
                    kept[k, rows] &= ~better
    v, a = told
    squares, bending = np.where(kept, narrowest + _bias_of_narrowest(u, noise), error)
    return v, a, squares, bending


def _by_narrowest(u: Array, noise: Array) -> tuple[Array, Array]:
    """First and second derivative per sample from the narrowest window around it, at the ends to
    one side, and the variances of both, (2, n) each.
    """
    n, half = len(u), WIDTHS[0] // 2
    told, variance = np.zeros((2, 2, n))
    for k, weights in enumerate(_weights(WIDTHS[0], half, DEGREES[0])):
        told[k, half : n - half] = np.convolve(u, weights[::-1], mode="valid")
        variance[k] = float(weights @ weights) * noise**2
    for row in _ends(n):
        begin = 0 if row < half else n - WIDTHS[0]
        for k, weights in enumerate(_weights(WIDTHS[0], row - begin, DEGREES[0])):
            told[k, row] = float(weights @ u[begin : begin + WIDTHS[0]])
            variance[k, row] = float(weights @ weights) * noise[row] ** 2
    return told, variance


def _bias_of_narrowest(u: Array, noise: Array) -> Array:
    """Expected squares of what the narrowest windows are off where their polynomials bend too
    little, (2, n).
    """
    n, half, beyond = len(u), WIDTHS[0] // 2, WIDTHS[1] // 2
    if n < WIDTHS[1]:
        return np.zeros((2, n))
    narrow = np.pad(_weights(WIDTHS[0], half, DEGREES[0]), ((0, 0), (beyond - half,) * 2))
    more = np.array(_weights(WIDTHS[1], beyond, DEGREES[1])) - narrow
    squares = [_bias(u, weights, noise[beyond : n - beyond]) for weights in more]
    return np.pad(squares, ((0, 0), (beyond, beyond)), "edge")


def _ends(n: int) -> tuple[int, ...]:
    """Rows that no window is around."""
    half = WIDTHS[0] // 2
    return (*range(half), *range(n - half, n))


def _bias(u: Array, more: Array, noise: Array) -> Array:
    """Square of what the weights of a higher degree add in each full window, beyond its noise,
    (m,). more: those weights less the weights in use; noise: of the sample told, rad, (m,).
    """
    added = np.convolve(u, more[::-1], mode="valid") ** 2
    return np.asarray(np.maximum(added - float(more @ more) * noise**2, 0.0))


def _weights(width: int, place: int, degree: int) -> tuple[Array, Array]:
    """What takes the first and the second derivative at one sample of a window from its polynomial,
    (width,) each.
    """
    fitted = np.linalg.pinv(
        np.vander((np.arange(width) - float(place)) / width, degree + 1, increasing=True)
    )
    return fitted[1] / width, 2 * fitted[2] / width**2


def fits(u: Array, width: int, degree: int, noise: Array, off: float = STRICT) -> Mask:
    """Whether the polynomial fitted to each full window leaves no more than the noise, and so many
    sigma of it, (n - width + 1,).
    """
    k, dof = np.arange(width) - width // 2, width - degree - 1
    basis = np.linalg.qr(np.vander(k / width, degree + 1, increasing=True))[0]
    windows = np.lib.stride_tricks.sliding_window_view(u - u.mean(), width)
    # of the angle itself nothing is left to cancel
    centred = windows - windows[:, width // 2 : width // 2 + 1]
    left = (centred**2).sum(axis=1) - ((centred @ basis) ** 2).sum(axis=1)
    limit = noise[width // 2 : len(u) - width // 2] * (1 + off / np.sqrt(2 * dof))
    return np.asarray(np.sqrt(np.maximum(left, 0.0) / dof) <= limit)
