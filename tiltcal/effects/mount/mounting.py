"""How the instrument sits on the faceplate."""

from collections.abc import Sequence

import numpy as np

from tiltcal.core.units import G0
from tiltcal.effects.base import FrameEffect
from tiltcal.effects.hysteresis_and_lag import onset
from tiltcal.effects.mechanisms import Context, Mechanism, Ring, Spring, Turn
from tiltcal.effects.parameter import Parameter
from tiltcal.effects.table.ringing import EARLY, ringing
from tiltcal.effects.traits import Family
from tiltcal.setup.setup import Rig
from tiltcal.setup.trajectory import Jet, sampled_jet


class MountMisalignment(FrameEffect):
    row_wise = True
    id = "mount_misalignment"
    stage = "mount"
    title = "instrument not aligned to the faceplate"
    parameters = tuple(Parameter(f"tilt_{a}", "arcsec", (60, 1000, 7200)) for a in "xyz")
    physics = (
        "The body's axes are turned against the faceplate by the mounting surface and the screws."
    )
    equation = "R_mount gains Rx(x) Ry(y) Rz(z)"
    source = "Geist et al. 2017; Physics: Mount"
    excited_by = "any two poses"
    look = "antisymmetric part of the sensitivity matrix: inside a full cross-axis calibration"
    linear = True
    ordinary = True

    def turns(self, slot: str, context: Context) -> Sequence[Turn]:
        return (
            tuple(Turn(a, Jet(self.value(f"tilt_{a}"))) for a in "xyz") if slot == "mount" else ()
        )


class MountSlip(FrameEffect):
    id = "mount_slip"
    needs = "time"
    stage = "mount"
    title = "the instrument shifts at an instant"
    parameters = (
        *(Parameter(f"slip_{a}", "arcsec", (3, 60, 360)) for a in "xyz"),
        Parameter("time", "s", (1e5, 1e5, 1e5), positive=True, shape=True),
        Parameter("creep", "s", (30, 30, 30), positive=True, shape=True),
    )
    physics = "A screw or an adhesive lets go a little; all channels step as one rotation."
    equation = "R_mount gains a small rotation from time_s on"
    source = "Physics: Mount"
    excited_by = "time"
    look = "a step of all channels at once, norm unchanged"
    family = Family(tilt=(("mount", "time"),))
    acts_from_an_instant = True

    def turns(self, slot: str, context: Context) -> Sequence[Turn]:
        if slot != "mount":
            return ()
        elapsed, start, creep = context.drive.elapsed, self.value("time"), self.value("creep")
        on = onset(elapsed, start, creep)
        rate = np.where(elapsed >= start, (1 - on) / creep, 0.0) if creep > 0 else np.zeros_like(on)
        acceleration = -rate / creep if creep > 0 else rate
        return tuple(
            Turn(a, Jet(on, rate, acceleration).scaled(self.value(f"slip_{a}"))) for a in "xyz"
        )


class MountThermalTilt(FrameEffect):
    id = "mount_thermal_tilt"
    needs = "temperature"
    stage = "mount"
    title = "the mount tilts with temperature"
    parameters = tuple(Parameter(f"tilt_{a}", "arcsec_degC", (0.3, 3, 10)) for a in "xyz")
    physics = "Brackets of unequal expansion turn the instrument with temperature."
    equation = "R_mount gains a small rotation k (T - T0)"
    source = "Physics: Mount"
    excited_by = "a temperature change in several poses"
    look = "follows T, turns with the pose, norm unchanged"
    linear = True
    family = Family(tilt=(("mount", "temperature"),))
    lags_thermometer = True

    def turns(self, slot: str, context: Context) -> Sequence[Turn]:
        if slot != "mount":
            return ()
        warm = sampled_jet(
            context.drive.time, context.drive.temperature - context.drive.reference_temperature
        )
        return tuple(Turn(a, warm.scaled(self.value(f"tilt_{a}"))) for a in "xyz")


class MountCompliance(FrameEffect):
    id = "mount_compliance"
    stage = "mount"
    title = "bracket or adhesive bends under the instrument's weight"
    parameters = (
        Parameter("bend_x", "arcsec_g", (0.5, 30, 300)),
        Parameter("bend_y", "arcsec_g", (0.5, 30, 300)),
    )
    physics = (
        "The instrument's weight bends its bracket; the bend turns with the specific force in the"
        " body frame."
    )
    equation = "small rotation of the mount (-c_x f_y, c_y f_x, 0) / g"
    source = "Physics: Mount"
    excited_by = "tilting about two axes"
    look = (
        "products of two force components on all channels, norm unchanged; follows the body at a"
        " remount"
    )
    on_table = True
    linear = True
    mechanised = True

    def turns(self, slot: str, context: Context) -> Sequence[Turn]:
        if slot != "mount" or context.force is None:
            return ()
        time, force = context.drive.time, context.force / G0
        return (
            Turn("x", sampled_jet(time, -self.value("bend_x") * force[:, 1])),
            Turn("y", sampled_jet(time, self.value("bend_y") * force[:, 0])),
        )

    def mechanisms(self, rig: Rig, gravity: float) -> tuple[Mechanism, ...]:
        """Two hinges in series, x then y, each with its ballast; a positive bend hangs the ballast
        below (-z). gravity: m/s2.
        """
        cx, cy = self.value("bend_x"), self.value("bend_y")
        mass, length = 0.5, 0.05  # the instrument's own
        arm_y = float(-np.copysign(length, cy)) if cy else 0.0
        # hinge x carries both ballasts
        arm_x = float(-np.copysign(length, cx)) - arm_y if cx else 0.0
        load = mass * G0 * length
        springs = []
        if cx:
            springs.append(Spring("bend_x", "x", load / abs(cx), mass, (0.0, 0.0, arm_x)))
        if cy:
            springs.append(Spring("bend_y", "y", load / abs(cy), mass, (0.0, 0.0, arm_y)))
        return tuple(springs)


class MountResonance(FrameEffect):
    id = "mount_resonance"
    needs = "motion"
    stage = "mount"
    title = "resonance of the mount"
    parameters = (
        Parameter("ring_x", "arcsec", (1, 10, 100)),
        Parameter("ring_y", "arcsec", (1, 10, 100)),
        Parameter("frequency", "hz", (100, 40, 20), positive=True, default=40.0),
        Parameter("tau", "s", (0.1, 0.3, 1), positive=True, default=0.3),
        EARLY,
    )
    physics = "The bracket rings at its own frequency when a move stops."
    equation = (
        "R_mount gains rotations (x, y) exp(-s/tau) cos(2 pi f s), s = early + time since the end"
        " of the move"
    )
    source = "Piersol and Paez 2009; Physics: Mount"
    excited_by = "the first samples after each move"
    look = "a decaying tone in body axes, whichever table axis moved"
    same_form_as = "settling_transient"

    def turns(self, slot: str, context: Context) -> Sequence[Turn]:
        if slot != "mount":
            return ()
        wave = ringing(context.drive, 1.0, *map(self.value, ("frequency", "tau", "early")))
        return tuple(Turn(a, wave.scaled(self.value(f"ring_{a}"))) for a in "xy")

    def dynamics(self, rig: Rig, gravity: float) -> tuple[Mechanism, ...]:
        if self.value("early"):
            return ()  # a bracket is let go when the move ends
        sizes = {a: self.value(f"ring_{a}") for a in "xy"}
        return tuple(
            Ring("mount", a, size, self.value("frequency"), self.value("tau"))
            for a, size in sizes.items()
            if size
        )


class RemountRepeatability(FrameEffect):
    id = "remount_repeatability"
    needs = "remount"
    stage = "mount"
    title = "orientation changes at each remount"
    parameters = (Parameter("sigma", "arcsec", (3, 60, 360), positive=True),)
    physics = "Screws and dowels seat the instrument a little differently each time."
    equation = "R_mount gains a rotation N(0, sigma) about each axis, new at each mounting"
    source = "Physics: Mount"
    excited_by = "remounts"
    look = "a step of all channels at a remount, norm unchanged"
    random = True
    like_event = "mount_slip"
    distinguished_by = {"mount_slip": "record twice more, once without a remount between"}

    def turns(self, slot: str, context: Context) -> Sequence[Turn]:
        if slot != "mount" or context.rng is None:
            return ()
        starts = np.array([row for row, _ in context.drive.mounts])
        which = np.searchsorted(starts, np.arange(len(context.drive.time)), side="right") - 1
        drawn = context.rng.normal(0.0, self.value("sigma"), (3, len(starts)))
        zero = np.zeros(len(which))
        return tuple(Turn(a, Jet(drawn[i][which], zero, zero)) for i, a in enumerate("xyz"))
