"""Estimators of tilt that are fed sample by sample, and how one is found by its name."""

from collections.abc import Callable, Mapping
from math import sin
from typing import Any, Protocol

from tiltcal.calibration.methods.options import check_options
from tiltcal.calibration.methods.registry import import_named
from tiltcal.calibration.result import Calibration, tilt_angles
from tiltcal.core.errors import TiltcalError, nearest
from tiltcal.core.frames import force_of_tilt
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.validation.online.field_scale import field_scale
from tiltcal.validation.online.filters import Complementary, Kalman

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
    """The accelerometer or inclinometer alone: exact at rest, wrong by a/g in motion."""
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
    bare = Setup(site=setup.site, rig=setup.rig, sensor=setup.sensor)
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
