"""The scale factors of a gyro triad against one FOG, sample by sample: the loop of S3 on line."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from tiltcal.calibration.methods.field_log import BLOCK
from tiltcal.calibration.methods.fog_filter import SCALE_PRIOR
from tiltcal.core.errors import TiltcalError
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup


class FieldScale:
    """A Kalman filter of ``u . r - F = sum_i u_i r_i X_i + c``, X = S / (1 + S).

    The first ``rest_s`` seconds are at rest: their means are taken off both sensors, so that the
    Earth's rate cancels, and c is the error of that mean. Then every block updates the filter.

    Args:
        gyro: triad; fog: with its input axis.
        rest_s: length of the first rest, s.

    Source: docs/sources.md, "Gyro triad in the field". `fog_scale` estimates the
    same from the whole recording.
    """

    columns = tuple(f"scale_{a}_ppm" for a in "xyz")

    def __init__(self, gyro: Sensor, fog: Sensor, rest_s: float) -> None:
        from filterpy.kalman import KalmanFilter

        self.gyro, self.fog, self.rest = gyro.name, fog.name, rest_s
        self.axis = fog.input_vector
        self.start: float | None = None
        self.resting: list[np.ndarray] = []
        self.block: list[np.ndarray] = []
        self.opened = 0.0
        self.mean = np.zeros(4)
        self.noise = 0.0
        self.filter = KalmanFilter(dim_x=4, dim_z=1)
        self.filter.x, self.filter.F = np.zeros((4, 1)), np.eye(4)

    def update(self, sample: Mapping[str, Any]) -> tuple[float, ...]:
        """Scale errors of x, y, z, ppm; NaN during the rest."""
        now = float(sample["time_s"])
        self.start = now if self.start is None else self.start
        if self.gyro in sample and self.fog in sample:
            self._take(now, np.array([*sample[self.gyro], *sample[self.fog]]))
        if not self.noise:
            return (float("nan"),) * 3
        x = self.filter.x[:3, 0]
        return tuple(float(v) for v in x / (1 - x) * 1e6)

    def _take(self, now: float, reading: np.ndarray) -> None:
        """One reading of both sensors."""
        if self.start is not None and now - self.start < self.rest:
            self.resting.append(reading)
            self.opened = now
            return
        if not self.noise:
            self._begin()
        self.block.append(reading)
        if now - self.opened >= BLOCK:
            self._step(np.mean(self.block, axis=0) - self.mean, len(self.block))
            self.block, self.opened = [], now

    def _begin(self) -> None:
        """The bias and the noise of the difference, from the rest."""
        rest = np.array(self.resting)
        if len(rest) < 10:
            raise TiltcalError(
                "estimator field_scale",
                found=f"{len(rest)} readings at rest",
                need="a first rest of ten readings or more",
                do="state a longer rest_s, or rest longer",
            )
        self.mean = rest.mean(axis=0)
        self.noise = max(float(np.var(rest[:, :3] @ self.axis - rest[:, 3])), 1e-24)
        self.filter.P = np.diag([SCALE_PRIOR**2] * 3 + [self.noise / len(rest)])

    def _step(self, turned: np.ndarray, count: int) -> None:
        """One update by a block: readings less the means at rest."""
        H = np.append(self.axis * turned[:3], 1.0)[None]
        self.filter.R[0, 0] = self.noise / count
        self.filter.update(turned[:3] @ self.axis - turned[3], H=H)


def field_scale(setup: Setup, *, rest_s: float = 20.0) -> FieldScale:
    """Scale factors of a gyro triad against one FOG from turns by hand, after a rest.

    Raises:
        TiltcalError: the set-up has no gyro triad, or no FOG.
    """
    gyros = [s for s in setup.sensors("gyro") if len(s.axes) == 3]
    fogs = setup.sensors("fog")
    if not gyros or not fogs:
        raise TiltcalError(
            "estimator field_scale",
            found=f"{len(gyros)} gyro triads and {len(fogs)} FOGs in the scenario",
            need="one of each",
            do="correct the [[sensor]] tables",
        )
    return FieldScale(gyros[0], fogs[0], rest_s)
