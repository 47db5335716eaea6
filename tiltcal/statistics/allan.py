"""Allan variance of a record at standstill, and that of each kind of noise. ``RunningAllan``
computes the deviation of a record that comes piece by piece, in memory that does not grow with it.
"""

from dataclasses import dataclass
from math import log, pi

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.core.errors import TiltcalError

TERMS = ("Q", "N", "B", "K", "R")
NAMES = {
    "Q": "quantisation noise",
    "N": "white noise (random walk of the integral)",
    "B": "bias instability (flicker)",
    "K": "random walk",
    "R": "ramp",
}
# in the cache, and below what BLAS spreads over threads: waiting for them took ten times as long
CHUNK = 1 << 13
LEAST = 16  # samples of a record


@dataclass(frozen=True)
class AllanDeviation:
    """Overlapped Allan deviation.

    Args:
        tau: averaging times, s, (m,).
        deviation: in the unit of the record, (m,).
        freedom: equivalent degrees of freedom, (m,).
    """

    tau: Array
    deviation: Array
    freedom: Array

    def interval(self, probability: float = 0.68) -> tuple[Array, Array]:
        """Confidence interval of the deviation, (m,) each, from chi-square with the equivalent
        degrees of freedom.
        """
        from scipy.special import chdtri

        tail = (1 - probability) / 2
        high = self.deviation * np.sqrt(
            self.freedom / np.array([chdtri(f, 1 - tail) for f in self.freedom])
        )
        low = self.deviation * np.sqrt(
            self.freedom / np.array([chdtri(f, tail) for f in self.freedom])
        )
        return low, high


def allan_deviation(values: Array, rate_hz: float, tau: Array | None = None) -> AllanDeviation:
    """Overlapped Allan deviation of one channel, (n,), at octave averaging times unless others are
    given. Its degrees of freedom are those of white noise.

    ``s2(tau) = sum (x_(k+2m) - 2 x_(k+m) + x_k)^2 / (2 tau^2 (N - 2m))`` with x the running
    integral.

    Raises:
        TiltcalError: the record is shorter than 16 samples.

    Source: IEEE 952 annex C.
    """
    n = len(values)
    _require_enough(n)
    if tau is None:
        m = 2 ** np.arange(int(np.log2(n / 5)) + 1)
    else:
        m = np.unique(np.clip(np.round(np.asarray(tau) * rate_hz).astype(int), 1, (n - 1) // 2))
    x = np.zeros(n + 1)
    np.cumsum(values - values.mean(), out=x[1:])
    double = 2.0 * x
    variance = np.array(
        [_second_differences(x, double, int(k)) / (2.0 * k**2 * (n + 1 - 2 * k)) for k in m]
    )
    return curve_of(m, variance, n, rate_hz)


def curve_of(m: Index, variance: Array, n: int, rate_hz: float) -> AllanDeviation:
    """The deviation of Allan variances, with the degrees of freedom of white noise.

    Args:
        rate_hz: of the samples.
        m: samples of each averaging time, (k,).
        variance: at each, in the square of the unit of the record, (k,).
        n: samples of the record.

    Raises:
        TiltcalError: they are fewer than 16.
    """
    _require_enough(n)
    white = freedoms(m.astype(float), n)[:, TERMS.index("N")]
    return AllanDeviation(m / rate_hz, np.sqrt(variance), white)


def _require_enough(n: int) -> None:
    """Refuse a record that is too short."""
    if n < LEAST:
        raise TiltcalError(
            "noise record", found=f"{n} samples", need=f"at least {LEAST}", do="record longer"
        )


def _second_differences(x: Array, double: Array, m: int) -> float:
    """Sum of (x_(k+2m) - 2 x_(k+m) + x_k)^2, by pieces that stay in the cache and without new
    arrays.
    """
    count = len(x) - 2 * m
    buffer = np.empty(min(CHUNK, count))
    total = 0.0
    for first in range(0, count, CHUNK):
        last = min(first + CHUNK, count)
        second = buffer[: last - first]
        np.add(x[first:last], x[first + 2 * m : last + 2 * m], out=second)
        np.subtract(second, double[first + m : last + m], out=second)
        total += float(second @ second)
    return total


def slopes(tau: Array) -> Array:
    """Allan variance of each term at unit coefficient, (m, 5), in the order of TERMS."""
    return np.column_stack(
        [3 / tau**2, 1 / tau, np.full_like(tau, 2 * log(2) / pi), tau / 3, tau**2 / 2]
    )


def freedoms(m: Array, n: int) -> Array:
    """Equivalent degrees of freedom of the overlapped Allan variance of each term, (k, 5), in the
    order of TERMS; a ramp has those of a random walk.

    Args:
        m: samples of each averaging time, (k,).
        n: samples of the record.

    Source: Riley, Handbook of Frequency Stability Analysis, NIST SP 1065 (2008), 5.4.1, with n + 1
        readings of the integral; after Howe, Allan and Barnes (1981).
    """
    x = n + 1.0
    phase = (x + 1) * (x - 2 * m) / (2 * (x - m))
    white = (3 * (x - 1) / (2 * m) - 2 * (x - 2) / x) * 4 * m**2 / (4 * m**2 + 5)
    flicker = np.where(m < 2, 2 * (x - 2) ** 2 / (2.3 * x - 4.9), 5 * x**2 / (4 * m * (x + 3 * m)))
    walk = (x - 2) / m * ((x - 1) ** 2 - 3 * m * (x - 1) + 4 * m**2) / (x - 3) ** 2
    return np.maximum(np.column_stack([phase, white, flicker, walk, walk]), 1.0)


DENSE = 64  # second differences within an averaging time, at most: more overlap adds no information


class RunningAllan:
    """Overlapped Allan deviation at octave averaging times of 2^k samples.

    Up to ``DENSE`` samples it is that of ``allan_deviation``; beyond, second differences of the
    running integral begin at every 2^k / ``DENSE``-th sample only.

    Args:
        samples: that are expected; averaging times end at a fifth of them.
    """

    def __init__(self, samples: int) -> None:
        most = int(np.log2(max(samples, LEAST) / 5))
        self._levels = [_Level(2**k, max(2**k // DENSE, 1)) for k in range(most + 1)]
        self._samples = 0
        self._last = 0.0  # of the running integral
        self._offset: float | None = None  # of the values: a straight line in their integral

    def add(self, values: Array) -> None:
        """Go on with further values, (n,)."""
        if not len(values):
            return
        if self._offset is None:
            self._offset = float(values.mean())
            for level in self._levels:
                level.add(np.zeros(1), 0)
        integral = self._last + np.cumsum(values - self._offset)
        for level in self._levels:
            level.add(integral, self._samples + 1)
        self._samples += len(values)
        self._last = float(integral[-1])

    def deviation(self, rate_hz: float) -> AllanDeviation:
        """That of all values so far.

        Raises:
            TiltcalError: there are fewer than 16.
        """
        used = [level for level in self._levels if 5 * level.samples <= self._samples]
        m = np.array([level.samples for level in used])
        return curve_of(m, np.array([level.variance for level in used]), self._samples, rate_hz)


class _Level:
    """Second differences of the running integral at one averaging time.

    Args:
        samples: of the averaging time.
        stride: between second differences, a divisor of it.
    """

    def __init__(self, samples: int, stride: int) -> None:
        self.samples, self._stride = samples, stride
        self._kept = np.zeros(0)
        self._total, self._count = 0.0, 0

    def add(self, integral: Array, first: int) -> None:
        """Further values of the integral, (n,), the first with this number."""
        lag = self.samples // self._stride
        x = np.concatenate([self._kept, integral[-first % self._stride :: self._stride]])
        second = x[2 * lag :] - 2 * x[lag : max(len(x) - lag, lag)] + x[: max(len(x) - 2 * lag, 0)]
        self._total += float(second @ second)
        self._count += len(second)
        self._kept = x[max(len(x) - 2 * lag, 0) :]

    @property
    def variance(self) -> float:
        """Allan variance, in the square of the unit of the values."""
        return self._total / (2.0 * self.samples**2 * max(self._count, 1))
