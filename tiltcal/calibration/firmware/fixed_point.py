"""Fixed-point numbers: a number x with n binary places is the integer x 2^n."""

from dataclasses import dataclass
from fractions import Fraction
from math import ceil, frexp

import numpy as np

from tiltcal.core.arrays import Array


def places_for(bound: float, bits: int) -> int:
    """The most binary places n with ``bound 2^n < 2^bits``, whatever rounding adds."""
    return bits - frexp(max(bound, 1e-30) * (1 + 2.0**-20))[1]


def integers(values: Array, places: int) -> list[int]:
    """Values times 2^places, rounded; flat, exact whatever their size. values: of any shape, such
    as (n,).
    """
    return [round(Fraction(float(v)) * Fraction(2) ** places) for v in np.ravel(values)]


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
            reach: a larger bound of the result, where it is stated.
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
