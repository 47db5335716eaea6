"""Plain data that effects hand to the closed form and to the rig: how the world, a frame or a joint
differs.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.setup.loads import Loads, Mass
from tiltcal.setup.setup import Rig, Setup
from tiltcal.setup.tables import up_in_body
from tiltcal.setup.trajectory import Drive, Jet


@dataclass(frozen=True)
class Turn:
    """A small prescribed rotation about a coordinate axis of its slot's frame, right-handed."""

    axis: str
    angle: Jet


@dataclass(frozen=True)
class Shake:
    """A sinusoidal acceleration of the base, world frame.

    Args:
        cos, sin: amplitudes along East, North, Up, m/s2, (3,).
        frequency: Hz.
    """

    cos: Array
    sin: Array
    frequency: float

    def jets(self, time: Array) -> tuple[Jet, Jet, Jet]:
        """Displacement, velocity, acceleration along East, North, Up. time: s, (n,)."""
        p = 2 * np.pi * self.frequency
        c, s = np.cos(p * time), np.sin(p * time)
        return tuple(  # type: ignore[return-value]
            Jet(-(C * c + S * s) / p**2, (C * s - S * c) / p, C * c + S * s)
            for C, S in zip(self.cos, self.sin, strict=True)
        )


@dataclass(frozen=True)
class Spring:
    """A compliant hinge loaded by a ballast: MuJoCo finds the equilibrium.

    Args:
        body: the body it is inserted in, after that body's own joints.
        axis: coordinate axis of the hinge.
        stiffness: N m/rad.
        mass: of the ballast behind the hinge, kg.
        arm: position of the ballast in the body's frame, m, (3,).
    """

    body: str
    axis: str
    stiffness: float
    mass: float
    arm: tuple[float, float, float]


@dataclass(frozen=True)
class Compliance:
    """A joint in series that gives way to the moment on it.

    Args:
        slot: the frame that it turns: ``base``, or ``<axis>_bearing``.
        axis: coordinate axis of that frame.
        value: rad/(N m).
    """

    slot: str
    axis: str
    value: float


@dataclass(frozen=True)
class Gap:
    """Lost motion of a table axis: the load follows the drive within +- half the width (rad),
    dragged by friction.
    """

    axis: str
    width: float


@dataclass(frozen=True)
class Friction:
    """Dry friction of a table axis: its servo lets it stop ``short`` (rad) of the command. Runs by
    time steps only.
    """

    axis: str
    short: float


@dataclass(frozen=True)
class Lag:
    """Damping of an axis' servo: on a ramp it follows ``tau`` (s) behind. Runs by time steps
    only.
    """

    axis: str
    tau: float


@dataclass(frozen=True)
class Ballast:
    """A load above an axis (below: negative) under which its servo gives way by ``droop`` (rad),
    held out level.

    Runs by time steps only.
    """

    axis: str
    droop: float


@dataclass(frozen=True)
class Cable:
    """A cable wound up by an axis against its servo: the axis stands ``pull`` further, in rad per
    rad. Time steps only.
    """

    axis: str
    pull: float


@dataclass(frozen=True)
class Cogging:
    """A motor's torque against its angle: the servo gives way by ``size`` (rad) sin(poles x angle).
    Time steps only.
    """

    axis: str
    poles: float
    size: float


@dataclass(frozen=True)
class Ring:
    """A compliant hinge wound up by each move and let go when it stops. Runs by time steps only.

    Args:
        body: the body it is inserted in, after that body's own joints.
        axis: coordinate axis of the hinge.
        size: where it is let go, rad.
        frequency, tau: of its ringing, Hz and s.
    """

    body: str
    axis: str
    size: float
    frequency: float
    tau: float

    @property
    def joint(self) -> str:
        """Name of its hinge, in the model and in ``Drive.structure``."""
        return f"{self.body}_ring_{self.axis}"


Mechanism = Spring | Gap | Friction | Lag | Ballast | Cable | Cogging | Ring


@dataclass(frozen=True)
class World:
    """What is the same everywhere on the rig.

    Args:
        gravity: m/s2.
        earth: Earth's rate in the world frame as gyros see it, rad/s, (3,).
        coriolis: the same for the Coriolis acceleration.
        lever: sensors' position from the axes' common point, body frame, m, (3,).
        shakes: vibration of the base.
    """

    gravity: float
    earth: Array
    coriolis: Array
    lever: Array
    shakes: tuple[Shake, ...] = ()

    @classmethod
    def of(cls, setup: Setup) -> "World":
        """The nominal world of a set-up."""
        earth = setup.site.earth_rate
        return cls(setup.site.gravity, earth, earth, np.array(setup.rig.lever_arm_m))


@dataclass(frozen=True)
class Context:
    """Where and when a geometric effect acts.

    Args:
        drive: the readout and the time base.
        axes: true angles of the table's axes.
        rig: table and mounting.
        gravity: m/s2.
        loads: moments that the links of a user's own model carry.
        force: specific force in the frame of the slot, m/s2, (n, 3); None where MuJoCo will find
            it.
        rng: the effect's own random stream; None when random effects are switched off.
    """

    drive: Drive
    axes: Mapping[str, Jet]
    rig: Rig
    gravity: float
    loads: Loads
    force: Array | None = None
    rng: np.random.Generator | None = None

    def gravity_in_body(self) -> Array:
        """The specific force of an instrument at rest in each instant's pose, in its body, m/s2,
        (n, 3).
        """
        up = up_in_body(self.rig.kind.moving, self.rig.kind.chain, self.axes, self.drive)
        return self.gravity * up

    @classmethod
    def along(
        cls,
        drive: Drive,
        axes: Mapping[str, Jet],
        rig: Rig,
        gravity: float,
        masses: Sequence[Mass] = (),
    ) -> "Context":
        """A motion, with the loads that follow from it. gravity: m/s2."""
        loads = Loads(rig.kind.chain, drive.time, axes, gravity, masses, drive.rows_apart)
        return cls(drive, axes, rig, gravity, loads)
