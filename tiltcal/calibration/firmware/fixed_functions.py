"""Functions in integers: the coefficients of their polynomials, and a bound of their error."""

from collections.abc import Callable
from dataclasses import dataclass
from math import pi

import numpy as np

from tiltcal.core.arrays import Array

TURN = 2.0**32 / (2 * pi)
"""Phase of one rad: a turn is 2^32."""
RATE_PLACES = 58  # of the exponent of 2 by which something decays
EVEN = 64  # terms whose remainder is below the rounding of a double


@dataclass(frozen=True)
class FixedSeries:
    """``f(v) / v`` in powers of w = v^2 on 0 ... 1, by Horner's rule on 32-bit coefficients.

    Args:
        coefficients: times 2^places.
        error: largest of f, in its unit, for an exact v.
    """

    coefficients: list[int]
    error: float

    @classmethod
    def of(cls, function: Callable[[Array], Array], terms: int, places: int) -> "FixedSeries":
        """By Chebyshev interpolation.

        Args:
            function: odd, of values (n,) in 0 ... 1.
            terms: of the polynomial.
            places: of its coefficients.
        """

        def of_square(w: Array) -> Array:
            root = np.sqrt(np.maximum(w, 1e-18))
            return function(root) / root

        series = np.polynomial.chebyshev.Chebyshev.interpolate
        fitted = series(of_square, terms - 1, domain=[0, 1]).convert(kind=np.polynomial.Polynomial)
        powers = [float(c) for c in fitted.coef]
        # interpolation leaves at most twice the coefficients that it leaves out
        left_out = 2 * float(np.abs(series(of_square, EVEN - 1, domain=[0, 1]).coef[terms:]).sum())
        slope = sum(n * abs(c) for n, c in enumerate(powers))
        # a coefficient and a product are rounded in each step, then the product with v; w to 2^-31
        rounded = (2 * terms + 1) * 2.0 ** (-places - 1) + slope * 2.0**-31
        return cls([round(c * 2.0**places) for c in powers], left_out + rounded)


SINE = FixedSeries.of(lambda v: np.sin(pi / 2 * v), 7, 30)
"""Of a right angle times v."""
ARCTANGENT = FixedSeries.of(lambda q: np.arctan(q) * TURN, 12, 1)
"""Phase of a direction whose smaller component is q of the larger one."""
SINE_ERROR = SINE.error + 2.0**-31  # the result is rounded to 30 places
PHASE_ERROR = (ARCTANGENT.error + 2.0**-31 * TURN + 0.5) / TURN
"""Of a direction, rad: with its q and its result rounded."""
# h = 1 - 2^-y is cut off at 2^-31 and the quotient h / (2 - h) at 2^-30, which has a slope of 2;
# the polynomial of h is wrong by less than 2^-33, the factor of z by 2^-29 of z sech^2 z < z / 2
TANH_ERROR = 2.0**-28


def decay() -> list[int]:
    """Sizes of the coefficients of (1 - 2^-x) / x on 0 ... 1, times 2^64; their signs alternate."""
    series = np.polynomial.chebyshev.Chebyshev.interpolate(
        lambda x: -np.expm1(-x * np.log(2)) / x, 7, domain=[0, 1]
    )
    coefficients = series.convert(kind=np.polynomial.Polynomial).coef
    return [round(abs(float(c)) * 2**64) for c in coefficients]
