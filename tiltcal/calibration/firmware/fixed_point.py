"""Fixed-point numbers: how many binary places fit, and polynomials with a bound of their error.

The temperature in integers: its low-pass, its memory, and the error of both.
"""

from dataclasses import dataclass
from math import ceil, frexp
from typing import Any

import numpy as np

from tiltcal.calibration.firmware.linear_terms import LinearTerms
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.instrument.temperature import SHORTEST, Memory

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


READ_PLACES = 16  # of a temperature that is read, degC
STATE_PLACES = 40  # of temperatures that are remembered, degC
HYSTERESIS_PLACES = 60  # of the state of a hysteresis, -1 ... 1
MEMORY_PLACES = 24  # of the memory as it enters a bias
SHORTEST_STEP_S = 1e-3  # between temperatures, for which the error is stated
WIDEST = 256.0  # degC, of the range
NARROWEST = 0.1  # degC, of a hysteresis
TERMS = 8  # of (1 - 2^-x) / x on 0 ... 1
RATE_PLACES = 58  # of the exponent of 2 by which something decays
CHANGE_PLACES = 60  # of that exponent per degC
WHOLE = 2**64


@dataclass(frozen=True)
class FixedTemperature:
    """Constants and errors.

    Args:
        numbers: for the template.
        level: largest error of the level, degC; unit: of u; memory: of the memory, in its unit.
        most: largest size of the memory.
    """

    numbers: dict[str, Any]
    level: float
    unit: float
    memory: float
    most: float


def fixed_temperature(terms: LinearTerms, memory: Memory) -> FixedTemperature:
    """The temperature of a calibration in integers.

    Raises:
        TiltcalError: its range is too wide, or its hysteresis too narrow.
    """
    low, high = terms.lowest, terms.highest
    span = high - low
    if span > WIDEST or (memory.kind == "hysteresis" and memory.size < NARROWEST):
        raise TiltcalError(
            "fixed point, temperature",
            found=f"a range of {span:g} degC, {memory.words()}",
            need=f"{WIDEST:g} degC at most, a hysteresis of {NARROWEST:g} degC or more",
            do="calibrate over a smaller range, or use the floating-point part",
        )
    smoothing, level = _constant(terms.smoothing, span)
    numbers: dict[str, Any] = {
        "lowest": integers(np.array(low), READ_PLACES)[0],
        "highest": integers(np.array(high), READ_PLACES)[0],
        "middle": integers(np.array((low + high) / 2), STATE_PLACES)[0],
        "per_half": min(round(WHOLE / span * 2), WHOLE - 1),
        "decay": [round(c * WHOLE) for c in _decay()],
        "smoothing": smoothing,
        "read_places": READ_PLACES,
    }
    # u: the level over half the range, with the reciprocal and the result rounded
    unit = 2 * level / span + 2.0 ** (-UNIT_PLACES) + 2.0**-50
    wrong, most = 0.0, 0.0
    if memory.kind == "lag":
        numbers["size"], of_lag = _constant(memory.size, span)
        wrong, most = 2 * level + of_lag, span
    elif memory.kind == "hysteresis":
        per_degree = 1 / (memory.size * np.log(2))
        rate = round(per_degree * 2**CHANGE_PLACES)
        largest = round(64 / per_degree * 2**STATE_PLACES * (1 - 1e-9))
        numbers["size"] = {"rate": rate, "limit": largest}
        # a level that is wrong by e is late in turning over by e, at both ends of its way
        wrong, most = 8 * level / memory.size + 1e-7, 1.0
    return FixedTemperature(numbers, level, unit, wrong + 2.0 ** (-MEMORY_PLACES - 1), most)


def _constant(seconds: float, span: float) -> tuple[dict[str, int], float]:
    """A time constant as decay per microsecond, and the error of what follows with it, degC."""
    per_us = 1 / (max(seconds, SHORTEST) * 1e6 * np.log(2))
    rate = round(per_us * 2.0**RATE_PLACES)
    least = 2.0**-STATE_PLACES
    if rate >= WHOLE:
        return {"rate": 0, "limit": 1}, least  # one microsecond is all
    gain = -np.expm1(-SHORTEST_STEP_S / max(seconds, SHORTEST))
    relative = 0.5 / max(rate, 1) + 1e-11  # of the gain: by the rate, and by the polynomial
    return {"rate": rate, "limit": (WHOLE - 1) // max(rate, 1)}, relative * span + least / gain


def _decay() -> list[float]:
    """Sizes of the coefficients of (1 - 2^-x) / x on 0 ... 1; their signs alternate."""
    series = np.polynomial.chebyshev.Chebyshev.interpolate(
        lambda x: -np.expm1(-x * np.log(2)) / x, TERMS - 1, domain=[0, 1]
    )
    return [abs(float(c)) for c in series.convert(kind=np.polynomial.Polynomial).coef]
