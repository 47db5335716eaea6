"""Allan deviation of a record that comes piece by piece, in memory that does not grow with it."""

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.statistics.allan import LEAST, AllanDeviation, curve_of

DENSE = 64  # second differences within an averaging time, at most: more overlap tells nothing new


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
        samples: of the averaging time; stride: between second differences, a divisor of it.
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
