"""Fixed-point numbers: how many binary places fit, and polynomials with a bound of their error."""

from dataclasses import dataclass
from math import ceil, frexp

import numpy as np

from tiltcal.core.arrays import Array

UNIT_PLACES = 30  # of u, the temperature from -1 to 1


def places_for(bound: float, bits: int) -> int:
    """The most binary places n with ``bound 2^n < 2^bits``, whatever rounding adds."""
    return bits - frexp(max(bound, 1e-30) * (1 + 2.0**-20))[1]


def integers(values: Array, places: int) -> list[int]:
    """Values times 2^places, rounded; flat, exact whatever their size. values: of any shape, such
    as (n,).
    """
    found = []
    for value in np.ravel(values):
        mantissa, exponent = frexp(float(value))
        whole, shift = int(mantissa * 2**53), exponent - 53 + places
        found.append(whole << shift if shift >= 0 else _rounded(whole, -shift))
    return found


def _rounded(whole: int, shift: int) -> int:
    half = 1 << (shift - 1)
    return (whole + half) >> shift if whole >= 0 else -((-whole + half) >> shift)


@dataclass(frozen=True)
class FixedPolynomial:
    """Polynomials of u in -1 ... 1, by Horner's rule in integers.

    Args:
        coefficients: of u^0, u^1 ..., times 2^places, (order + 1, m).
        places: of them and of the result.
        bound: of the largest result, in its unit.
        slope: of the largest change with u.
        error: of the largest result for an exact u.
    """

    coefficients: list[list[int]]
    places: int
    bound: float
    slope: float
    error: float

    @classmethod
    def of(cls, powers: Array, bits: int) -> "FixedPolynomial":
        """Of coefficients (order + 1, m), so that no partial sum reaches 2^bits."""
        sizes = np.abs(powers)
        bound = float(sizes.sum(axis=0).max())
        order = len(powers) - 1
        places = places_for(bound, bits)
        rows = [integers(row, places) for row in powers]
        slope = float((np.arange(order + 1)[:, None] * sizes).sum(axis=0).max())
        # each coefficient is rounded once, each product once
        return cls(rows, places, bound, slope, (2 * order + 1) * 2.0 ** (-places - 1))


@dataclass(frozen=True)
class FixedMatrix:
    """``out = (constant + matrix in) 2^-shift`` in 64 bits.

    Args:
        matrix: (k, m), below 2^31; constant: (k,).
        shift: of the sum, 0 or more.
        places: of the result, which is below 2^31.
        bound: of the largest result; error: of the largest one for exact inputs.
    """

    matrix: list[list[int]]
    constant: list[int]
    shift: int
    places: int
    bound: float
    error: float

    @classmethod
    def of(
        cls, matrix: Array, constant: Array, limits: Array, places: list[int], reach: float = 0.0
    ) -> "FixedMatrix":
        """Of real numbers.

        Args:
            matrix: (k, m).
            constant: (k,).
            limits: largest size of each input, (m,), in its unit.
            places: of each input, (m,).
            reach: a larger bound of the result, where it is not that of these limits.
        """
        sums = np.abs(matrix) @ limits + np.abs(constant)
        columns = zip(np.abs(matrix).max(axis=0), places, strict=True)
        of_sum = min(
            places_for(float(sums.max()), 62),
            *(places_for(float(largest), 31) + place for largest, place in columns),
        )
        bound = max(float(sums.max()), reach)
        out = min(places_for(bound, 31), of_sum)
        stored = np.array(
            [
                integers(column, of_sum - place)
                for column, place in zip(matrix.T, places, strict=True)
            ]
        ).T
        scale = 2.0 ** (np.array(places) - of_sum)
        wrong = np.abs(stored * scale - matrix) @ limits
        error = float(wrong.max()) + 2.0 ** (-of_sum - 1) + 2.0 ** (-out - 1)
        return cls(
            [[int(v) for v in row] for row in stored],
            integers(constant, of_sum),
            of_sum - out,
            out,
            bound,
            error,
        )


def decimals(error: float) -> str:
    """A bound in words: two digits, rounded up."""
    exponent = int(np.floor(np.log10(error))) - 1
    return f"{ceil(error / 10.0**exponent) * 10.0**exponent:.2g}"
