"""Small laboratories for the tests: set-ups, drives and courses in one line each."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from tiltcal.effects import make_effect
from tiltcal.effects.base import Effect
from tiltcal.forward.kinematics import closed_form
from tiltcal.forward.signal_chain import readings
from tiltcal.setup.schedule import Schedule, build_schedule
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.sequence import Climate, Step
from tiltcal.setup.setup import Rig, Setup, Site
from tiltcal.setup.tables import BUILT_IN
from tiltcal.setup.trajectory import Attitude, Drive, Jet, Motion

G = 9.80123
LATITUDE = 39.9
TABLES = tuple(BUILT_IN)
AXLED = tuple(name for name, table in BUILT_IN.items() if table.axes)
ACCEL = Sensor(name="accel", kind="accelerometer", rate_hz=20)
INCL = Sensor(name="incl", kind="inclinometer", axes=("x", "y"), rate_hz=20)
GYRO = Sensor(name="gyro", kind="gyro", rate_hz=20)
FOG = Sensor(name="fog", kind="fog", axes=("a",), input_axis=(1, 1, 1), rate_hz=20)
INSTRUMENT = (ACCEL, INCL, GYRO, FOG)


def setup_of(table: str, *sensors: Sensor, heading: float = 0.0, **rig: object) -> Setup:
    """A laboratory at 39.9 deg North with this table."""
    site = Site(gravity_m_s2=G, latitude_deg=LATITUDE, heading_deg=heading)
    return Setup(site=site, rig=Rig(table=table, **rig), sensor=sensors)


def still(
    setup: Setup, temperature: np.ndarray | None = None, **degrees: float | np.ndarray
) -> Drive:
    """The table at rest, one pose a row, a second apart; axes that are not named stand at zero."""
    n = max([np.size(a) for a in degrees.values()] + [1])
    axes = {
        name: Jet(np.radians(np.broadcast_to(degrees.get(name, 0.0), n)), np.zeros(n), np.zeros(n))
        for name in setup.rig.axis_names
    }
    return drive_of(axes, np.arange(n, dtype=float), temperature=temperature, rest=True)


def drive_of(
    axes: dict[str, Jet],
    time: np.ndarray,
    *,
    temperature: np.ndarray | None = None,
    attitude: Attitude | None = None,
    rest: bool = False,
    mounts: tuple[tuple[int, np.ndarray], ...] = ((0, np.eye(3)),),
) -> Drive:
    """A drive with everything else ordinary."""
    n = len(time)
    warm = np.full(n, 23.0) if temperature is None else temperature
    stop = np.arange(n) if rest else np.full(n, -1)
    return Drive(
        time, axes, 0.0, warm, float(np.mean(warm)), stop, mounts, attitude, np.ones(n, bool)
    )


def tossed(setup: Setup, rng: np.random.Generator, n: int, *, moving: bool) -> Drive:
    """Random states: any angles; when moving, rates and accelerations of some rad/s and rad/s2."""
    speed = 1.0 if moving else 0.0
    time = np.arange(n, dtype=float)
    if not setup.rig.axes:
        R = Rotation.random(n, random_state=rng).as_matrix()
        attitude = Attitude(R, speed * rng.normal(size=(n, 3)), speed * rng.normal(size=(n, 3)))
        return drive_of({}, time, attitude=attitude, rest=not moving)
    axes = {
        name: Jet(
            rng.uniform(-np.pi, np.pi, n), speed * rng.normal(size=n), speed * rng.normal(size=n)
        )
        for name in setup.rig.axis_names
    }
    return drive_of(axes, time, rest=not moving)


def motion_of(setup: Setup, *effects: Effect, **degrees: float | np.ndarray) -> Motion:
    """The closed form at rest in these poses."""
    return closed_form(setup, still(setup, **degrees), effects)


@dataclass(frozen=True)
class Poses:
    """A Course that only knows its own stamps."""

    known: Drive

    @property
    def times(self) -> tuple[float, float]:
        return float(self.known.time[0]), float(self.known.time[-1])

    def drive(self, time: np.ndarray) -> Drive:
        np.testing.assert_array_equal(time, self.known.time)
        return self.known


def read_poses(
    setup: Setup, drive: Drive, *effects: Effect, seed: int | None = None
) -> dict[str, np.ndarray]:
    """What every sensor reads on the stamps of a drive."""
    return readings(
        setup, Poses(drive), {s.name: drive.time for s in setup.sensor}, effects, seed=seed
    )


def schedule_of(setup: Setup, *steps: dict[str, object], **climate: float) -> Schedule:
    """A schedule from the words of a scenario."""
    return build_schedule([Step(**step) for step in steps], setup.rig, Climate(**climate))


def effect_of(
    id: str, setup: Setup, sensor: str | None = None, axis: str | None = None, **values: float
) -> Effect:
    """An effect from the words of a scenario."""
    return make_effect(id, values, setup, sensor=sensor, axis=axis)
