"""Laboratories drawn at random: a rig, a sequence, ordinary sensors, a room that warms and
cools.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from blind.motion import Plan, Track
from blind.nuisance import Nuisance
from blind.rotations import DEG, G0

TABLES = {"vertical": (2,), "placing": (1,), "dual": (0, 2), "three": (2, 1, 0)}
AXIS_NAMES = ("outer", "middle", "inner")
EARTH_RATE = 7.292115e-5


@dataclass(frozen=True)
class Sensor:
    """An ordinary sensor: reading = M x + b, with noise. sigma: white, one sample; SI units."""

    name: str
    kind: str
    axes: tuple[str, ...]
    rate_hz: float
    unit: str
    sigma: float
    M: np.ndarray
    b: np.ndarray
    input_axis: np.ndarray | None = None

    @property
    def adjustable(self) -> list[str]:
        """What ordinary calibration may re-tune."""
        return ["bias", "scale"] if self.kind == "fog" else ["bias", "scale", "cross_axis"]


@dataclass(frozen=True)
class Noise:
    """Beyond white: random walk per root second and flicker, both in units of a sample's sigma;
    nuisances of the log.
    """

    walk: float
    walk_stratum: int
    flicker: float
    heavy_share: float
    jitter: float
    missing: float
    readout_rad: float
    nuisance: Nuisance | None = None


@dataclass(frozen=True)
class Room:
    """Temperature: T(t) = mean + slope + slow waves. waves: (k, 3) amplitude, rad/s, phase."""

    mean: float
    slope: float
    waves: np.ndarray

    def at(self, t: np.ndarray) -> np.ndarray:
        """degC at t. t: (n,)."""
        a, w, p = self.waves.T
        return self.mean + self.slope * t + (a * np.sin(np.outer(t, w) + p)).sum(1)

    def lagged(self, t: np.ndarray, tau_s: float) -> np.ndarray:
        """degC behind a thermal lag, exact, settled at the start."""
        a, w, p = self.waves.T
        z = a * np.exp(1j * p) / (1 + 1j * w * tau_s)
        slow = self.slope * (t - tau_s) + (np.exp(1j * np.outer(t, w)) @ z).imag
        start = self.slope * -tau_s + z.imag.sum() - (a * np.sin(p)).sum()
        return self.mean + slow - start * np.exp(-t / tau_s)

    def slope_at(self, t: np.ndarray) -> np.ndarray:
        """degC/s at t."""
        a, w, p = self.waves.T
        return self.slope + (a * w * np.cos(np.outer(t, w) + p)).sum(1)


@dataclass(frozen=True)
class Lab:
    """One recording to be: what the scenario states, how it moves, what its sensors are."""

    kind: str
    table: str
    readout: str
    gravity: float
    latitude: float
    lever: np.ndarray
    sensors: tuple[Sensor, ...]
    noise: Noise
    track: Track
    room: Room
    T0: float = 0.0
    written: bool = True  # table columns stand in the file
    unlocked: bool = False  # they are empty while moving
    # body to faceplate
    mount: tuple[tuple[float, float, float], ...] = (
        (1.0, 0.0, 0.0),
        (0.0, 1.0, 0.0),
        (0.0, 0.0, 1.0),
    )
    past: dict = field(default_factory=dict, compare=False)

    @property
    def axes(self) -> tuple[int, ...]:
        """Which body directions the axes turn about, outermost first (hand turns: as a three-axis
        table).
        """
        return TABLES[self.table if self.table in TABLES else "three"]

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Names of the axes in columns."""
        return {1: ("outer",), 2: ("outer", "inner"), 3: AXIS_NAMES}[len(self.axes)]

    @property
    def channels(self) -> list[tuple[int, int]]:
        """(sensor, axis) of every channel, in file order."""
        return [(s, i) for s, sensor in enumerate(self.sensors) for i in range(len(sensor.axes))]

    @property
    def rate_hz(self) -> float:
        """Samples a second, of all sensors."""
        return self.sensors[0].rate_hz


# -------------------------------------------------------------------------------------------------
# sensors and the room


def _matrix(rng: np.random.Generator, size: int) -> np.ndarray:
    return np.eye(size) + rng.normal(0, 0.004, (size, size))


def accelerometer(rng: np.random.Generator, rate_hz: float) -> Sensor:
    """A triad."""
    sigma = 10 ** rng.uniform(-3.9, -2.9) if rate_hz < 40 else 10 ** rng.uniform(-3.3, -2.9)
    unit = str(rng.choice(["m_s2", "g", "mg"]))
    return Sensor(
        "accel",
        "accelerometer",
        ("x", "y", "z"),
        rate_hz,
        unit,
        sigma,
        _matrix(rng, 3),
        rng.normal(0, 0.15, 3),
    )


def inclinometer(rng: np.random.Generator, rate_hz: float) -> Sensor:
    """Two axes, sensing specific force."""
    sigma = 10 ** rng.uniform(-4.4, -3.9)
    unit = str(rng.choice(["deg", "arcsec"]))
    return Sensor(
        "incl",
        "inclinometer",
        ("x", "y"),
        rate_hz,
        unit,
        sigma,
        _matrix(rng, 2),
        rng.normal(0, 0.02, 2),
    )


def gyro(rng: np.random.Generator, rate_hz: float) -> Sensor:
    """A triad."""
    sigma = 10 ** rng.uniform(-3.6, -3.1)
    unit = str(rng.choice(["deg_s", "rad_s"]))
    return Sensor(
        "gyro",
        "gyro",
        ("x", "y", "z"),
        rate_hz,
        unit,
        sigma,
        _matrix(rng, 3),
        rng.normal(0, 0.3 * DEG, 3),
    )


def fog(rng: np.random.Generator, rate_hz: float) -> Sensor:
    """One axis between the body's."""
    u = np.ones(3) / np.sqrt(3) + rng.normal(0, 0.06, 3)
    sigma = 10 ** rng.uniform(-4.3, -3.6)
    M, b = np.eye(1) + rng.normal(0, 5e-4), rng.normal(0, 5e-6, 1)
    return Sensor(
        "fog",
        "fog",
        ("a",),
        rate_hz,
        str(rng.choice(["deg_h", "deg_s"])),
        sigma,
        M,
        b,
        u / np.linalg.norm(u),
    )


def noise(rng: np.random.Generator, stratum: int) -> Noise:
    """Ordinary nuisances. ``stratum`` multiplies the random walk."""
    return Noise(
        walk=stratum * rng.uniform(1e-3, 4e-3),
        walk_stratum=stratum,
        flicker=float(rng.choice([0.0, rng.uniform(0.01, 0.03)])),
        heavy_share=float(rng.choice([0.0, 0.0, 0.03])),
        jitter=float(rng.choice([0.0, 0.0, 0.02])),
        missing=float(rng.choice([0.0, 0.001])),
        readout_rad=rng.uniform(0.02, 0.1) * DEG / 3600,
    )


def room(rng: np.random.Generator, lasts_s: float) -> Room:
    """A few degrees, at the paces of air conditioning and doors."""
    periods = lasts_s * rng.uniform(0.25, 1.6, 3)
    waves = np.stack(
        [rng.uniform(0.2, 1.6, 3), 2 * np.pi / periods, rng.uniform(0, 2 * np.pi, 3)], 1
    )
    return Room(rng.uniform(20, 27), rng.uniform(-1.5, 1.5) / lasts_s, waves)


# --------------------------------------------------------------------------------------------------
# ------------ sequences


def _tumble(rng: np.random.Generator) -> Track:
    """Dual: tilts one after the other, several inner angles at each."""
    step, first = float(rng.choice([45.0, 60.0, 60.0])), rng.uniform(0, 30)
    tilts, inner = (
        first + np.arange(0, 360, step),
        rng.uniform(0, 40) + np.arange(0, 360, rng.choice([72.0, 90.0])),
    )
    plan = Plan([tilts[0] * DEG, inner[0] * DEG])
    dwell, rate = rng.uniform(2.5, 3.5), rng.uniform(15, 30) * DEG
    for n, tilt in enumerate(tilts):
        for angle in inner if n % 2 == 0 else inner[::-1]:
            plan.go({0: tilt * DEG, 1: angle * DEG}, rate)
            plan.dwell(dwell)
    for _ in range(3):
        plan.go({0: rng.choice(tilts) * DEG, 1: rng.choice(inner) * DEG}, rate)
        plan.dwell(dwell)
    return plan.track()


def _sweep(rng: np.random.Generator, quarter: bool, steep: float = 360.0) -> Track:
    """Placing: up and down."""
    step = 5.0 if quarter else 10.0
    start, top = (0.0, 90.0) if quarter else (0.0, 360.0)
    if steep < 360:  # an inclinometer's range
        start, top, step = -steep, steep, float(rng.choice([5.0, 10.0]))
    plan = Plan([start * DEG])
    dwell, rate = rng.uniform(2.5, 3.5), rng.uniform(12, 28) * DEG
    up = np.arange(start, top + 1e-6, step)
    for angle in [*up, *up[::-1][1:]]:  # at the top nothing moves
        plan.go({0: angle * DEG}, rate)
        plan.dwell(dwell)
    return plan.track()


def _turns(rng: np.random.Generator) -> Track:
    """Vertical: two revolutions one way, two back, and some reversals."""
    plan = Plan([0.0])
    dwell, rate = rng.uniform(2.5, 3.5), rng.uniform(15, 35) * DEG
    up = np.arange(0, 720 + 1e-6, float(rng.choice([30.0, 45.0])))
    for angle in [*up, *up[::-1][1:], *rng.uniform(0, 180, 6)]:
        plan.go({0: angle * DEG}, rate)
        plan.dwell(dwell)
    return plan.track()


def _rates(rng: np.random.Generator) -> Track:
    """Three axes: whole turns both ways at several rates, swings, poses."""
    plan = Plan([0.0, 0.0, 0.0])
    plan.dwell(5)
    for axis in (0, 1, 2):
        for rate in rng.uniform(40, 140, 2):
            for target in (2 * np.pi, 0.0):
                plan.go({axis: target}, rate * DEG, 0.3)
                plan.dwell(2)
        plan.swing(axis, rng.uniform(15, 40) * DEG, rng.uniform(0.2, 0.4), 3)
        plan.dwell(2)
    for _ in range(12):
        plan.go(
            dict(enumerate(rng.choice([-90, -60, -45, 0, 30, 45, 90, 135, 180, 200], 3) * DEG)),
            rng.uniform(30, 60) * DEG,
        )
        plan.dwell(3.5)
    plan.go({0: 0.0, 1: 0.0, 2: 0.0}, 50 * DEG)
    plan.dwell(4)
    return plan.track()


def _by_hand(rng: np.random.Generator) -> Track:
    """Turns by hand about each axis, uneven, with rests."""
    plan = Plan([0.0, 0.0, 0.0])
    plan.dwell(8)
    for axis in (0, 1, 2, *rng.permutation(3)):
        for target in rng.choice([180, 270, 360], 2) * DEG * (1, -1):
            plan.go(
                {
                    axis: plan.at[axis] + target,
                    (axis + 1) % 3: plan.at[(axis + 1) % 3] + rng.normal(0, 0.1),
                },
                rng.uniform(60, 160) * DEG,
                rng.uniform(0.3, 0.5),
            )
            plan.dwell(rng.uniform(1.5, 4))
    plan.dwell(6)
    return plan.track()


def _faces(rng: np.random.Generator) -> Track:
    """Six faces of a cube on a dual head."""
    poses = np.array([[0, 0], [180, 0], [90, 0], [90, 90], [90, 180], [90, -90]]) * DEG
    return _poses(rng, poses[rng.permutation(6)])


def _any_six(rng: np.random.Generator) -> Track:
    """Six poses set down by hand."""
    return _poses(rng, rng.uniform(-180, 180, (6, 3)) * DEG)


def _poses(rng: np.random.Generator, poses: np.ndarray) -> Track:
    plan = Plan(list(poses[0]))
    for pose in poses:
        plan.go(dict(enumerate(pose)), rng.uniform(30, 60) * DEG)
        plan.dwell(rng.uniform(5, 8))
    return plan.track()


# --------------------------------------------------------------------------------------------------
# ----------- the kinds

KINDS = (
    "dual_tumble",
    "placing_sweep",
    "vertical_turn",
    "three_rates",
    "field_turns",
    "six_faces",
    "six_any",
)


def draw(rng: np.random.Generator, kind: str, stratum: int) -> Lab:
    """A laboratory of one kind."""
    table = {
        "dual_tumble": "dual",
        "placing_sweep": "placing",
        "vertical_turn": "vertical",
        "three_rates": "three",
        "field_turns": "handheld",
        "six_faces": "dual",
        "six_any": "handheld",
    }[kind]
    sensors = _sensors(rng, kind)
    track = sequence(rng, kind, sensors)
    lever = rng.uniform(-0.04, 0.04, 3) if kind in ("dual_tumble", "three_rates") else np.zeros(3)
    readout = (
        str(rng.choice(["encoder", "encoder", "command"]))
        if table in ("dual", "placing", "vertical", "three")
        else "encoder"
    )
    lab = Lab(
        kind,
        table,
        readout,
        rng.uniform(9.78, 9.83),
        rng.uniform(20, 60),
        lever.round(4),
        sensors,
        noise(rng, stratum),
        track,
        room(rng, track.end_s),
        written=table != "handheld",
        unlocked=kind == "six_faces",
    )
    return replace(lab, T0=mean_temperature(lab))


def _sensors(rng: np.random.Generator, kind: str) -> tuple[Sensor, ...]:
    if kind == "vertical_turn" or (kind == "placing_sweep" and rng.random() < 0.35):
        return (inclinometer(rng, 25.0),)
    if kind == "three_rates":
        return accelerometer(rng, 50.0), gyro(rng, 50.0), fog(rng, 50.0)
    if kind == "field_turns":
        return gyro(rng, 50.0), fog(rng, 50.0)
    return (accelerometer(rng, 25.0),)


def sequence(rng: np.random.Generator, kind: str, sensors: tuple[Sensor, ...]) -> Track:
    """Moves of one recording."""
    if kind == "placing_sweep":
        steep = float(rng.choice([45.0, 55.0])) if sensors[0].kind == "inclinometer" else 360.0
        return _sweep(rng, quarter=bool(rng.random() < 0.3), steep=steep)
    plans = {
        "dual_tumble": _tumble,
        "vertical_turn": _turns,
        "three_rates": _rates,
        "field_turns": _by_hand,
        "six_faces": _faces,
        "six_any": _any_six,
    }
    return plans[kind](rng)


def another(rng: np.random.Generator, lab: Lab) -> Lab:
    """The same laboratory on another day: other poses, another course of temperature, the same
    reference temperature.
    """
    reach = lab.track.angles(np.linspace(0, lab.track.end_s, 2000))
    # no farther than the recording has been
    low, high = (
        reach.min(0),
        np.minimum(reach.max(0), reach.min(0) + 2 * np.pi),
    )
    plan = Plan(list(lab.track.home))
    rate = rng.uniform(15, 28) if lab.rate_hz < 40 else rng.uniform(40, 110)
    for _ in range(22):
        plan.dwell(3.0)
        plan.go(dict(enumerate(rng.uniform(low, high))), rate * DEG, 0.3)
    plan.dwell(3.0)
    track = plan.track()
    other = room(rng, track.end_s)
    return replace(lab, track=track, room=replace(other, mean=lab.T0 + rng.uniform(-1, 1)), past={})


def mean_temperature(lab: Lab) -> float:
    """Mean of the temperature column: one reading a second."""
    return float(np.mean(np.round(lab.room.at(np.arange(0.0, lab.track.end_s, 1.0)), 2)))


__all__ = [
    "EARTH_RATE",
    "G0",
    "KINDS",
    "Lab",
    "Noise",
    "Room",
    "Sensor",
    "another",
    "draw",
    "mean_temperature",
    "sequence",
]
