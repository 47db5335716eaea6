"""The drive: where the axis stands against the command, at standstill, while moving and just
after.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tiltcal.effects.base import AngleEffect
from tiltcal.effects.mechanisms import (
    Ballast,
    Cable,
    Cogging,
    Friction,
    Lag,
    Mechanism,
    Spring,
)
from tiltcal.effects.parameter import Parameter
from tiltcal.effects.spans import CoordinateRanges
from tiltcal.effects.table.readout import CROSSING, CROSSINGS, ReadoutError, TableSag, lost_motion
from tiltcal.effects.traits import Family
from tiltcal.setup.setup import Rig
from tiltcal.setup.trajectory import Drive, Jet


class ServoDroop(TableSag):
    id = "servo_droop"
    title = "finite static stiffness of the drive"
    parameters = (Parameter("droop", "arcsec", (0.05, 5, 60)),)
    physics = (
        "A proportional loop gives way to gravity's torque: true minus command = tau_g / kp. The"
        " encoder sees it."
    )
    equation = "true = command + d sin(angle), on the axis that gravity loads (readout = command)"
    look = "as sag, but visible in the encoder"
    size = "droop"
    ordinary = False
    same_form_as = "table_sag"
    seen_by_encoder = True
    of_drive = True

    def dynamics(self, rig: Rig, gravity: float) -> tuple[Mechanism, ...]:
        axis = rig.kind.loaded
        return (
            (Ballast(axis, self.value("droop")),)
            if axis is not None and self.acts_on(axis, rig)
            else ()
        )


class TableUnbalance(AngleEffect):
    row_wise = True
    id = "table_unbalance"
    stage = "table"
    title = "gravity torque of an unbalanced load"
    parameters = (Parameter("cos", "arcsec", (2, 20, 60)), Parameter("sin", "arcsec", (2, 20, 60)))
    physics = "A load off the axis in any direction bends the drive train by its gravity torque."
    equation = "true = readout + c cos(angle) + s sin(angle), on the axis that gravity loads"
    source = "Physics: Table mechanics"
    excited_by = "a turn of a horizontal axis"
    look = "sag with a phase; a payload change moves it"
    linear = True
    mechanised = True
    same_form_as = "table_encoder_eccentricity"
    axis_by_gravity = True
    distinguished_by = {"table_sag": "change the payload's mass and position"}

    def acts_on(self, axis: str, rig: Rig) -> bool:
        return axis == (self.axis or rig.kind.loaded)

    def deviation(self, drive: Drive, axis: str, rng: np.random.Generator | None) -> Jet:
        return drive.axes[axis].harmonic(1, self.value("cos"), self.value("sin"))

    def mechanisms(self, rig: Rig, gravity: float) -> tuple[Mechanism, ...]:
        axis = rig.kind.loaded
        size = float(np.hypot(self.value("cos"), self.value("sin")))
        if size == 0 or axis is None or not self.acts_on(axis, rig):
            return ()
        # a ballast at angle p from z towards the next axis but one: torque m g l sin(angle + p)
        phase = np.arctan2(self.value("cos"), self.value("sin"))
        i = "xyz".index(dict(rig.axes)[axis])
        arm = np.zeros(3)
        arm[2] = 0.1 * np.cos(phase)
        arm[3 - 2 - i] = 0.1 * np.sin(phase) * (1 if i == 1 else -1)
        mass = 0.5
        return (
            Spring(
                axis,
                "xyz"[i],
                mass * gravity * 0.1 / size,
                mass,
                (float(arm[0]), float(arm[1]), float(arm[2])),
            ),
        )


ON_JOINTS = (1.0, 50.0, 500.0)
"""arcsec/rad, of cables on the joints of a robot: taken that hoses pull with 20 to 25 N m/rad on
joints that give way by 0.05 to 20 arcsec/(N m) (``load.SPRING``).
"""


class CableTorque(AngleEffect):
    row_wise = True
    id = "cable_torque"
    stage = "table"
    title = "cables pull the table"
    parameters = (Parameter("pull", "arcsec_rad", (0.3, 3, 20)),)
    physics = (
        "A cable wound up by the turn pulls the axis back or on, in proportion to the angle; it"
        " does not repeat after 360 deg."
    )
    equation = "true = readout + k readout"
    source = "Physics: Table mechanics"
    excited_by = "a large range of the angle"
    look = "a rotation that grows with the angle and does not close at 360 deg"
    linear = True
    family = Family(readout=("table_{axis}",))
    on_joints = ON_JOINTS

    @classmethod
    def sizes_on(cls, channels: Sequence[str], rig: Rig) -> dict[str, Parameter]:
        found = super().sizes_on(channels, rig)
        if rig.kind.chain is None:
            return found
        return {name: replace(p, plausible=cls.on_joints) for name, p in found.items()}

    def deviation(self, drive: Drive, axis: str, rng: np.random.Generator | None) -> Jet:
        return drive.axes[axis].scaled(self.value("pull"))

    def dynamics(self, rig: Rig, gravity: float) -> tuple[Mechanism, ...]:
        return (Cable(self.axis or rig.axis_names[0], self.value("pull")),)


class RateError(CableTorque):
    id = "rate_error"
    title = "scale of an axis: its rate, or its readout"
    parameters = (Parameter("rate", "ppm", (10, 100, 10000)),)
    physics = (
        "The table's rate reference is off: every turn is longer or shorter than commanded. The"
        " readout of a joint behind a gear, a belt or a lead screw, or of a potentiometer, counts"
        " more or less than the joint moves; a graduated disc on the joint itself cannot."
    )
    equation = "true = readout (1 + e)"
    excited_by = "turning"
    look = "a common scale of all gyro axes; angle closure after whole turns shows it"
    source = "IEEE 1554; Mooring, Roth and Driels 1991; Physics: Table mechanics"
    same_form_as = "cable_torque"
    apart_on_joints = True
    on_joints = (10.0, 1000.0, 10000.0)  # ppm: tolerance of gears, belts and potentiometers
    on_slides = True
    distinguished_by = {"cable_torque": "turn the joint a whole turn further, against a reference"}

    def deviation(self, drive: Drive, axis: str, rng: np.random.Generator | None) -> Jet:
        return drive.axes[axis].scaled(self.value("rate"))

    def dynamics(self, rig: Rig, gravity: float) -> tuple[Mechanism, ...]:
        return ()


class ServoFrictionDeadband(AngleEffect):
    id = "servo_friction_deadband"
    needs = "direction"
    stage = "table"
    title = "stops short of the command by friction"
    parameters = (Parameter("width", "arcsec", (2, 20, 60), positive=True), CROSSING)
    physics = (
        "Below the friction torque the loop does not pull any more: the axis stops tau_f / kp"
        " short."
    )
    equation = (
        "the true angle stops width/2 short of the command, in the direction of the last motion"
        " (readout ="
        " command); with a crossing, the play state of the command instead of the sign"
    )
    source = "Armstrong-Helouvry et al. 1994; Physics: Table mechanics"
    excited_by = "approaching the same angle from both sides"
    look = "as backlash; does not scale with the load"
    linear = True
    alike_on_axes = True
    seen_by_encoder = True
    of_drive = True

    @classmethod
    def shapes(cls, span: CoordinateRanges) -> list[dict[str, float]]:
        return [{"crossing": w} for w in CROSSINGS]

    def deviation(self, drive: Drive, axis: str, rng: np.random.Generator | None) -> Jet:
        return lost_motion(drive.axes[axis], self.value("width"), self.value("crossing"))

    def dynamics(self, rig: Rig, gravity: float) -> tuple[Mechanism, ...]:
        if self.value("crossing"):  # dry friction lets go at once
            return ()
        return (Friction(self.axis or rig.axis_names[0], self.value("width") / 2),)


class ServoLag(AngleEffect):
    row_wise = True
    id = "servo_lag"
    needs = "motion"
    stage = "table"
    title = "lag proportional to rate"
    parameters = (Parameter("tau", "ms", (1, 10, 50), positive=True),)
    physics = "A servo follows a ramp with (kv + damping) / kp of lag."
    equation = "true = command - tau rate (readout = command)"
    source = "Physics: Table mechanics"
    excited_by = "moves"
    look = "as latency, but in the encoder too; nothing at rest"
    linear = True
    alike_on_axes = True
    seen_by_encoder = True
    of_drive = True

    def deviation(self, drive: Drive, axis: str, rng: np.random.Generator | None) -> Jet:
        jet, tau = drive.axes[axis], self.value("tau")
        return Jet(-tau * jet.v, -tau * jet.a, np.zeros_like(drive.time))

    def dynamics(self, rig: Rig, gravity: float) -> tuple[Mechanism, ...]:
        return (Lag(self.axis or rig.axis_names[0], self.value("tau")),)


class ServoInertia(AngleEffect):
    row_wise = True
    id = "servo_inertia"
    needs = "motion"
    stage = "table"
    title = "lag proportional to acceleration"
    parameters = (Parameter("inertia", "ms2", (1, 100, 3000), positive=True),)
    physics = (
        "The torque that accelerates rotor and load bends the loop: J / kp, the armature's inertia"
        " among it; one over the square of the loop's natural frequency."
    )
    equation = "true = command - k acceleration (readout = command)"
    source = "Physics: Table mechanics"
    excited_by = "moves that begin and end quickly"
    look = "where a move begins and ends, of opposite signs; nothing at rest or a steady rate"
    linear = True
    alike_on_axes = True
    seen_by_encoder = True
    of_drive = True

    def deviation(self, drive: Drive, axis: str, rng: np.random.Generator | None) -> Jet:
        nothing = np.zeros_like(drive.time)
        return Jet(-self.value("inertia") * drive.axes[axis].a, nothing, nothing)


class ServoRipple(AngleEffect):
    row_wise = True
    id = "servo_ripple"
    stage = "table"
    title = "periodic rate ripple"
    parameters = (
        Parameter("ripple", "ppm", (100, 1000, 300000)),
        Parameter("poles", "", (12, 12, 12), positive=True, default=12.0),
    )
    physics = "Cogging and commutation modulate the rate with the angle."
    equation = "rate = readout rate (1 + r cos(n angle)): true = readout + r/n sin(n angle)"
    source = "IEEE 1554; Physics: Table mechanics"
    excited_by = "turning, and stops at odd angles"
    look = "rate modulated at constant angle spacing; gyro and encoder both see it"
    of_drive = True
    same_form_as = "table_encoder_sde"

    def deviation(self, drive: Drive, axis: str, rng: np.random.Generator | None) -> Jet:
        n = self.value("poles")
        return drive.axes[axis].harmonic(n, 0.0, self.value("ripple") / n)

    def dynamics(self, rig: Rig, gravity: float) -> tuple[Mechanism, ...]:
        n = self.value("poles")
        return (Cogging(self.axis or rig.axis_names[0], n, self.value("ripple") / n),)


class EncoderSde(ReadoutError):
    id = "table_encoder_sde"
    title = "subdivisional (interpolation) error of the readout"
    parameters = (
        Parameter("cos", "arcsec", (0.3, 3, 10)),
        Parameter("sin", "arcsec", (0.3, 3, 10)),
        Parameter("lines", "", (360, 360, 36), positive=True, default=360.0),
    )
    physics = (
        "Two sine tracks of unequal size or phase make the interpolation between lines err, once a"
        " line."
    )
    equation = "readout = true + c cos(n a) + s sin(n a), n the number of lines"
    source = "Slocum 1992; Physics: Table mechanics"
    excited_by = "angles that are no multiple of the line pitch"
    look = "a fast ripple over the angle; round steps alias it into a constant"
    linear = True
    family = Family(readout=("table_{axis}",))
    spectral_line = "angle"

    @classmethod
    def shapes(cls, span: CoordinateRanges) -> list[dict[str, float]]:
        usual = (20.0, 36.0, 72.0, 90.0, 180.0, 360.0, 720.0, 1024.0)
        return [{"lines": n} for n in (*usual, *map(float, span.lines.ripples))]

    def error(self, true: Jet, axis: str) -> Jet:
        return true.harmonic(self.value("lines"), self.value("cos"), self.value("sin"))
