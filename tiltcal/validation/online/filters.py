"""Tilt filters to compare with: complementary, and Kalman by filterpy. Both carry gravity's
direction in the body frame.
"""

from collections.abc import Mapping
from math import asin, exp, hypot, sqrt
from typing import Any

import numpy as np

from tiltcal.calibration.result import Calibration
from tiltcal.core.arrays import Array
from tiltcal.core.frames import skew
from tiltcal.setup.sensor import Sensor

Vector = tuple[float, float, float]


class Complementary:
    """Up is carried by the gyro, ``du/dt = u x w``, and pulled towards f/|f| with time constant
    tau: plain floats.

    Args:
        accel, gyro: triads; gravity: m/s2; calibration: of the accelerometer, or None; tau_s: s.

    Errors:
        A gyro bias b leaves a tilt of b tau; an acceleration a that lasts t << tau leaves a t / (g
        tau).
    """

    def __init__(
        self,
        accel: Sensor,
        gyro: Sensor,
        gravity: float,
        calibration: Calibration | None,
        tau_s: float,
    ) -> None:
        self.accel, self.gyro, self.tau = accel, gyro, tau_s
        self.read = _Reader(accel, gravity, calibration)
        self.time: float | None = None
        self.up: Vector | None = None

    def update(self, sample: Mapping[str, Any]) -> tuple[float, float]:
        """Tilt of x and y, rad."""
        seen, now = self.read(sample), sample["time_s"]
        if self.up is None:
            self.up = seen
        if self.up is None:
            return float("nan"), float("nan")
        dt, self.time = (0.0 if self.time is None else now - self.time), now
        x, y, z = self.up
        rate = sample.get(self.gyro.name)
        if rate is not None:
            p, q, r = rate
            x, y, z = x + dt * (y * r - z * q), y + dt * (z * p - x * r), z + dt * (x * q - y * p)
        if seen is not None:
            k = 1 - exp(-dt / self.tau)
            x, y, z = x + k * (seen[0] - x), y + k * (seen[1] - y), z + k * (seen[2] - z)
        n = sqrt(x * x + y * y + z * z)
        self.up = (x / n, y / n, z / n)
        return asin(self.up[0]), asin(self.up[1])


class Kalman:
    """Up and the gyro's bias as the state of a filterpy Kalman filter, linear in the last state.

    ``u' = u - (w - b) x u dt``, b a slow random walk; measured: f/g = u, trusted less the further
    |f| is from g.

    Args:
        accel, gyro: triads; gravity: m/s2; calibration: of the accelerometer, or None.
        noise: accelerometer, g a sample; gyro, rad/s a sample; walk of its bias, rad/s a sample;
            how much of ||f|/g - 1|
            counts as noise.
    """

    def __init__(
        self,
        accel: Sensor,
        gyro: Sensor,
        gravity: float,
        calibration: Calibration | None,
        noise: tuple[float, ...],
    ) -> None:
        from filterpy.kalman import KalmanFilter

        self.accel, self.gyro, self.noise = accel, gyro, noise
        self.read = _Reader(accel, gravity, calibration)
        self.filter = KalmanFilter(dim_x=6, dim_z=3)
        self.filter.H = np.hstack([np.eye(3), np.zeros((3, 3))])
        self.filter.P = np.diag([noise[0] ** 2] * 3 + [1e-2**2] * 3)
        self.time = 0.0
        self.started = False

    def update(self, sample: Mapping[str, Any]) -> tuple[float, float]:
        """Tilt of x and y, rad."""
        seen, now = self.read(sample), sample["time_s"]
        k = self.filter
        if not self.started:
            if seen is None:
                return float("nan"), float("nan")
            k.x = np.array([*seen, 0.0, 0.0, 0.0])[:, None]
            self.started, self.time = True, now
        dt, self.time = now - self.time, now
        rate = sample.get(self.gyro.name)
        if rate is not None and dt > 0:
            k.predict(F=self._transition(np.asarray(rate), dt), Q=self._drift(dt))
        if seen is not None:
            off = self.noise[3] * abs(self.read.length - 1.0)
            k.update(np.array(seen)[:, None], R=np.eye(3) * (self.noise[0] ** 2 + off**2))
        up = k.x[:3, 0] / np.linalg.norm(k.x[:3, 0])
        return asin(float(up[0])), asin(float(up[1]))

    def _transition(self, rate: Array, dt: float) -> Array:
        """F with F x = (u - (w - b) x u dt, b): exact in u and b together."""
        F = np.eye(6)
        F[:3, :3] -= dt * skew(rate) - dt * dt / 2 * skew(rate) @ skew(rate)
        F[:3, 3:] = -dt * skew(self.filter.x[:3, 0])
        return F

    def _drift(self, dt: float) -> Array:
        up = skew(self.filter.x[:3, 0]) * dt * self.noise[1]
        Q = np.zeros((6, 6))
        Q[:3, :3] = up @ up.T + 1e-16 * np.eye(3)
        Q[3:, 3:] = self.noise[2] ** 2 * np.eye(3)
        return Q


class _Reader:
    """Direction of the specific force of a sample, and its length in g; None where the triad was
    not sampled.
    """

    def __init__(self, accel: Sensor, gravity: float, calibration: Calibration | None) -> None:
        self.accel, self.gravity, self.calibration, self.length = accel, gravity, calibration, 1.0

    def __call__(self, sample: Mapping[str, Any]) -> Vector | None:
        f = sample.get(self.accel.name)
        if f is None:
            return None
        if self.calibration is not None:
            f = self.calibration.correct(self.accel, np.array([f]), self.gravity)[0].tolist()
        n = hypot(*f)
        if not n > 0:  # a reading that is no number, or nothing at all
            return None
        self.length = n / self.gravity
        return f[0] / n, f[1] / n, f[2] / n
