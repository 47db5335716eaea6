"""The cosine transform in which the noise of a channel is diagonal."""

import numpy as np

from tiltcal.core.arrays import Real

SHORT = 1000  # samples whose transform takes no time
PRIMES = (2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31)


def cosines(column: Real) -> Real:
    """Orthonormal DCT-II along the last axis, (..., n)."""
    from scipy.fft import dct

    return np.asarray(dct(column, norm="ortho"), column.dtype)


def inverse_cosines(waves: Real) -> Real:
    """The column with these orthonormal DCT-II coefficients along the last axis, (..., n)."""
    from scipy.fft import idct

    return np.asarray(idct(waves, norm="ortho"), waves.dtype)


def quick_length(n: int) -> int:
    """The greatest length up to n that has no prime factor above 31; n itself where it is short.

    Its transform takes a quarter of the time of any other on average. At most 1 % of the samples
    are beyond it, and 0.08 % on average of 3000 and more.
    """
    if n < SHORT:
        return n
    return next(length for length in range(n, 0, -1) if _has_small_factors(length))


def _has_small_factors(length: int) -> bool:
    for prime in PRIMES:
        while length % prime == 0:
            length //= prime
    return length == 1
