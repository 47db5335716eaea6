"""Estimators that are fed sample by sample, and how one is found by its name: tilt filters
(complementary, and Kalman by filterpy, both of gravity's direction in the body frame) and the
scale factors of a gyro triad against one FOG.
"""

from collections.abc import Callable, Mapping
from math import asin, exp, hypot, sin, sqrt
from typing import Any, Protocol

import numpy as np

from tiltcal.calibration.methods.field_log import BLOCK
from tiltcal.calibration.methods.fog_filter import SCALE_PRIOR
from tiltcal.calibration.methods.options import check_options
from tiltcal.calibration.methods.registry import import_named
from tiltcal.calibration.result import Calibration, tilt_angles
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError, nearest
from tiltcal.core.frames import force_of_tilt, skew
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup


class FieldScale:
    """A Kalman filter of ``u . r - F = sum_i u_i r_i X_i + c``, X = S / (1 + S).

    The first ``rest_s`` seconds are a standstill: their means are subtracted from both sensors, so
    that the Earth's rate cancels, and c is the error of that mean. Then every block updates the
    filter.

    Args:
        gyro: triad.
        fog: FOG with its input axis.
        rest_s: length of the first standstill, s.

    Source: docs/sources.md, "Gyro triad in the field". `fog_scale` estimates the same from the
    whole recording.
    """

    columns = tuple(f"scale_{a}_ppm" for a in "xyz")

    def __init__(self, gyro: Sensor, fog: Sensor, rest_s: float) -> None:
        from filterpy.kalman import KalmanFilter

        self.gyro, self.fog, self.standstill_s = gyro.name, fog.name, rest_s
        self.axis = fog.input_vector
        self.start: float | None = None
        self.at_standstill: list[np.ndarray] = []
        self.block: list[np.ndarray] = []
        self.opened = 0.0
        self.mean = np.zeros(4)
        self.noise = 0.0
        self.filter = KalmanFilter(dim_x=4, dim_z=1)
        self.filter.x, self.filter.F = np.zeros((4, 1)), np.eye(4)

    def update(self, sample: Mapping[str, Any]) -> tuple[float, ...]:
        """Scale errors of x, y, z, ppm; NaN during the first standstill."""
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
        if self.start is not None and now - self.start < self.standstill_s:
            self.at_standstill.append(reading)
            self.opened = now
            return
        if not self.noise:
            self._begin()
        self.block.append(reading)
        if now - self.opened >= BLOCK:
            self._step(np.mean(self.block, axis=0) - self.mean, len(self.block))
            self.block, self.opened = [], now

    def _begin(self) -> None:
        """The bias and the noise of the difference, from the first standstill."""
        standstill = np.array(self.at_standstill)
        if len(standstill) < 10:
            raise TiltcalError(
                "estimator field_scale",
                found=f"{len(standstill)} readings at rest",
                need="a first standstill of ten readings or more",
                do="state a longer rest_s, or stand still longer",
            )
        self.mean = standstill.mean(axis=0)
        self.noise = max(float(np.var(standstill[:, :3] @ self.axis - standstill[:, 3])), 1e-24)
        self.filter.P = np.diag([SCALE_PRIOR**2] * 3 + [self.noise / len(standstill)])

    def _step(self, turned: np.ndarray, count: int) -> None:
        """One update by a block: readings less the means at standstill."""
        H = np.append(self.axis * turned[:3], 1.0)[None]
        self.filter.R[0, 0] = self.noise / count
        self.filter.update(turned[:3] @ self.axis - turned[3], H=H)


def field_scale(setup: Setup, *, rest_s: float = 20.0) -> FieldScale:
    """Scale factors of a gyro triad against one FOG from hand turns, after a standstill.

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


Vector = tuple[float, float, float]


class Complementary:
    """Up is carried by the gyro, ``du/dt = u x w``, and pulled towards f/|f| with time constant
    tau: plain floats.

    Args:
        accel, gyro: triads.
        gravity: m/s2.
        calibration: of the accelerometer, or None.
        tau_s: s.

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
        accel, gyro: triads.
        gravity: m/s2.
        calibration: of the accelerometer, or None.
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


Sample = Mapping[str, Any]
"""One instant: ``time_s``, and for each sensor sampled then its readings in SI, a tuple in the
order of its axes.
"""


class Estimator(Protocol):
    """What is judged: fed once a sample, it answers with the elevations of the body axes x and
    y, or with the numbers that its attribute ``columns`` names.
    """

    def update(self, sample: Sample) -> tuple[float, ...]:
        """Tilt of x and y, rad; NaN where it has none to give."""


Factory = Callable[..., Estimator]
LEVELS = ("accelerometer", "inclinometer")


class Level:
    """The plain level: the arcsine of each accelerometer over g, corrected where a calibration is
    given.

    An inclinometer's tilts are taken back to ``g sin(tilt)`` first: its calibration acts there.
    """

    def __init__(self, sensor: Sensor, gravity: float, calibration: Calibration | None) -> None:
        self.sensor, self.gravity, self.calibration = sensor, gravity, calibration

    def update(self, sample: Sample) -> tuple[float, float]:
        """Tilt of x and y, rad."""
        import numpy as np

        f = np.array([sample[self.sensor.name]])
        if self.sensor.kind == "inclinometer":
            f = force_of_tilt(f, self.gravity)
        if self.calibration is not None:
            f = self.calibration.correct(self.sensor, f, self.gravity)
        tilt = tilt_angles(f, self.sensor, self.gravity)
        return float(tilt["x"][0]), float(tilt["y"][0])


class Placing:
    """The corrector of placing-angle tables, fed with the samples of its sensor."""

    def __init__(
        self, sensor: Sensor, gravity: float, calibration: Calibration, lookup: str | None
    ) -> None:
        corrector = calibration.placing(sensor, gravity, lookup)
        if corrector is None:
            raise _unfit(
                "placing", "a calibration without placing-angle tables", "one by placing_table"
            )
        self.name, self.corrector = sensor.name, corrector
        self.gravity = gravity if sensor.kind == "inclinometer" else None
        self.axes = [sensor.axes.index(a) for a in "xyz" if a in sensor.axes]

    def update(self, sample: Sample) -> tuple[float, float]:
        """Tilt of x and y, rad."""
        read = sample[self.name]
        if self.gravity is None:
            return self.corrector.update([read[i] for i in self.axes])
        return self.corrector.update([self.gravity * sin(read[i]) for i in self.axes])


def accelerometer(
    setup: Setup, *, calibration: Calibration | None = None, sensor: str | None = None
) -> Estimator:
    """The accelerometer or inclinometer alone: exact at standstill, wrong by a/g in motion."""
    return Level(_sensor(setup, LEVELS, sensor, 2), setup.site.gravity, calibration)


def placing(
    setup: Setup,
    *,
    calibration: Calibration | None = None,
    sensor: str | None = None,
    lookup: str | None = None,
) -> Estimator:
    """The on-line corrector of S0; its tables come from ``calibrate = "placing_table"``.

    Raises:
        TiltcalError: no calibration by a placing table was given.
    """
    if calibration is None:
        raise _unfit("placing", "no calibration", 'calibrate = "placing_table" and from_s')
    return Placing(_sensor(setup, LEVELS, sensor, 2), setup.site.gravity, calibration, lookup)


def complementary(
    setup: Setup, *, calibration: Calibration | None = None, tau_s: float = 1.0
) -> Estimator:
    """The gyro carries the direction of gravity, the accelerometer pulls it back with a time
    constant.
    """
    return Complementary(*_pair(setup), setup.site.gravity, calibration, tau_s)


def kalman(
    setup: Setup,
    *,
    calibration: Calibration | None = None,
    accel_sigma: float = 1e-3,
    gyro_sigma: float = 1e-4,
    bias_walk: float = 1e-6,
    trust: float = 1.0,
) -> Estimator:
    """Kalman filter of gravity's direction and the gyro's bias (filterpy)."""
    return Kalman(
        *_pair(setup), setup.site.gravity, calibration, (accel_sigma, gyro_sigma, bias_walk, trust)
    )


ESTIMATORS: dict[str, Factory] = {
    "accelerometer": accelerometer,
    "placing": placing,
    "complementary": complementary,
    "kalman": kalman,
    "field_scale": field_scale,
}


def make_estimator(
    name: str, setup: Setup, calibration: Calibration | None, options: Mapping[str, Any]
) -> Estimator:
    """An estimator by the name of its factory: built in, or ``package.module:factory``, called with
    the Setup.

    Raises:
        TiltcalError: the name or an option is unknown, or what it makes has no ``update``.
    """
    if name not in ESTIMATORS and ":" not in name:
        raise TiltcalError(
            f"estimator '{name}'",
            found="no such estimator",
            need="a built-in, or package.module:factory",
            do=nearest(name, list(ESTIMATORS)),
        )
    factory: Factory = ESTIMATORS[name] if name in ESTIMATORS else import_named(name)
    given = dict(options) | ({} if calibration is None else {"calibration": calibration})
    check_options(factory, f"estimator {name}", given, handed=1)  # the set-up
    bare = setup.bare
    made = factory(bare, **given)
    if not callable(getattr(made, "update", None)):
        raise TiltcalError(
            f"estimator {name}",
            found=f"a {type(made).__name__}",
            need="an object with update(sample) -> (tilt_x, tilt_y)",
            do="return one",
        )
    return made


def _pair(setup: Setup) -> tuple[Sensor, Sensor]:
    return _sensor(setup, ("accelerometer",), None, 3), _sensor(setup, ("gyro",), None, 3)


def _sensor(setup: Setup, kinds: tuple[str, ...], name: str | None, axes: int) -> Sensor:
    fitting = [
        s
        for s in setup.sensors(*kinds)
        if len(s.axes) >= axes and {"x", "y"} <= set(s.axes) and name in (None, s.name)
    ]
    if not fitting:
        kind = " or ".join(kinds)
        raise _unfit(
            kinds[0], "no such sensor in the scenario", f"a sensor of kind {kind} with {axes} axes"
        )
    return fitting[0]


def _unfit(name: str, found: str, need: str) -> TiltcalError:
    return TiltcalError(
        f"estimator {name}",
        found=found,
        need=need,
        do="correct the [[estimator]] or the [[sensor]] tables",
    )
