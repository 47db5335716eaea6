"""Errors of the angle readout, and what makes the axis stand elsewhere than it reads."""

from abc import abstractmethod

import numpy as np

from tiltcal.effects.base import AngleEffect
from tiltcal.effects.hysteresis_and_lag import crossed
from tiltcal.effects.mechanisms import Gap, Mechanism, Spring
from tiltcal.effects.parameter import Parameter, PerTable
from tiltcal.effects.spans import CoordinateRanges
from tiltcal.effects.traits import Family
from tiltcal.setup.setup import Rig
from tiltcal.setup.tables import axis_names
from tiltcal.setup.trajectory import Drive, Jet


class ReadoutError(AngleEffect):
    """readout = true + error(true): the true angle solves it by fixed point."""

    row_wise = True
    stage = "table"

    @abstractmethod
    def error(self, true: Jet, axis: str) -> Jet:
        """The error of an axis' readout at a true angle."""

    def deviation(self, drive: Drive, axis: str, rng: np.random.Generator | None) -> Jet:
        true = readout = drive.axes[axis]
        for _ in range(4):  # contracts by the error's slope, < 1e-2 each time
            true = readout - self.error(true, axis)
        return true - readout

    def slight(self, drive: Drive, axis: str) -> Jet:
        return self.error(drive.axes[axis], axis).scaled(-1.0)


def zero_of(axis: str) -> str:
    """Bare name of the parameter that is the zero of an axis."""
    return f"{axis}_zero"


class EncoderZero(ReadoutError):
    id = "table_encoder_zero"
    title = "zero of the angle readout"
    parameters = PerTable(
        lambda table: tuple(map(zero_of, table.turning)),
        "arcsec",
        (3, 60, 1800),
        order=lambda: tuple(map(zero_of, axis_names())),
    )
    axis_wise = False
    physics = "The readout's zero is not where the scenario's frame has it."
    equation = "readout = true + zero, each axis its own"
    source = "IEEE 1554; Physics: Table mechanics"
    excited_by = "any tilt"
    look = "a constant rotation about the axis; one with the mounting until a remount"
    linear = True
    ordinary = True

    def acts_on(self, axis: str, rig: Rig) -> bool:
        return bool(self.value(zero_of(axis)))

    def error(self, true: Jet, axis: str) -> Jet:
        return Jet(self.value(zero_of(axis)) + 0 * true.x)


class EncoderEccentricity(ReadoutError):
    id = "table_encoder_eccentricity"
    title = "once-per-revolution readout error"
    parameters = (
        Parameter("cos", "arcsec", (3, 40, 400)),
        Parameter("sin", "arcsec", (3, 40, 400)),
    )
    physics = (
        "A graduated disc off centre by e on a diameter D reads 412.5 arcsec e[um]/D[mm] wrong,"
        " once a turn."
    )
    equation = "readout = true + c cos a + s sin a"
    source = "Slocum 1992; Physics: Table mechanics"
    excited_by = "a full turn of a tilting axis"
    look = "constant and second harmonic on one channel, second on the other; norm unchanged"
    linear = True
    harmonic = 1
    ordinary = True
    family = Family(readout=("table_{axis}",))
    distinguished_by = {"table_sag": "change the payload: sag changes, the encoder does not"}

    def error(self, true: Jet, axis: str) -> Jet:
        return true.harmonic(self.harmonic, self.value("cos"), self.value("sin"))


class Encoder2Rev(EncoderEccentricity):
    id = "table_encoder_2rev"
    title = "twice-per-revolution readout error"
    parameters = (
        Parameter("cos", "arcsec", (1, 15, 150)),
        Parameter("sin", "arcsec", (1, 15, 150)),
    )
    physics = "An elliptic disc, or the residue of two opposed reading heads."
    equation = "readout = true + c cos 2a + s sin 2a"
    look = "first and third harmonics on both channels; norm unchanged"
    harmonic = 2
    distinguished_by = {}


class SettingScatter(AngleEffect):
    id = "table_index_error"
    stage = "table"
    title = "random setting error at each stop"
    parameters = (Parameter("sigma", "arcsec", (1, 20, 3600), positive=True),)
    physics = "Each stop lands elsewhere by chance; averaging longer does not help."
    equation = "true_k = readout_k + N(0, sigma) at stop k"
    source = "Geist and Gaitan 2022; Physics: Table mechanics"
    excited_by = "several stops"
    look = "white from pose to pose, a common rotation of all channels, norm unchanged"
    random = True
    scatters = True

    def deviation(self, drive: Drive, axis: str, rng: np.random.Generator | None) -> Jet:
        zero = np.zeros(len(drive.time))
        if rng is None or len(drive.stop) == 0:
            return Jet(zero, zero, zero)
        drawn = rng.normal(
            0.0, self.value("sigma"), int(drive.stop.max()) + 1 if drive.stop.max() >= 0 else 1
        )
        still = drive.stop >= 0
        knots = np.flatnonzero(still)
        if len(knots) == 0:
            return Jet(zero, zero, zero)
        offset = np.interp(np.arange(len(drive.time)), knots, drawn[drive.stop[knots]])
        return Jet(offset, zero, zero)


class TableSag(AngleEffect):
    row_wise = True
    id = "table_sag"
    stage = "table"
    title = "the structure bends under gravity"
    parameters = (Parameter("sag", "arcsec", (2, 20, 60)),)
    physics = (
        "An unbalanced platform on a compliant structure bends by m g l sin(angle) / k, unseen by"
        " the encoder."
    )
    equation = "true = readout + d sin(angle), on the axis that gravity loads"
    source = "Physics: Table mechanics"
    excited_by = "a turn of a horizontal axis"
    look = "twin of the encoder's once-per-turn sine on one table; a payload change splits them"
    linear = True
    mechanised = True
    size = "sag"
    ordinary = True
    family = Family(readout=("table_{axis}",))
    harmonic = 1
    axis_by_gravity = True

    def acts_on(self, axis: str, rig: Rig) -> bool:
        return axis == (self.axis or rig.kind.loaded)

    def deviation(self, drive: Drive, axis: str, rng: np.random.Generator | None) -> Jet:
        return drive.axes[axis].harmonic(1, 0.0, self.value(self.size))

    def mechanisms(self, rig: Rig, gravity: float) -> tuple[Mechanism, ...]:
        sag, axis = self.value(self.size), rig.kind.loaded
        if sag == 0 or axis is None or not self.acts_on(axis, rig):
            return ()
        mass, arm = 0.5, np.copysign(0.1, sag)  # only m g l / k = d matters
        return (
            Spring(
                axis,
                dict(rig.axes)[axis],
                mass * gravity * abs(arm / sag),
                mass,
                (0.0, 0.0, float(arm)),
            ),
        )


CROSSING = Parameter("crossing", "deg", (0.01, 1, 5), positive=True, shape=True)
"""Travel over which lost motion passes from one side to the other; 0: at once."""
CROSSINGS = (0.0, 0.01, 0.03, 0.1, 0.3, 1.0)  # rad


def lost_motion(readout: Jet, width: float, crossing: float) -> Jet:
    """Half the width behind the readout, in the direction of its last motion, once it has crossed
    over, rad, (n,).
    """
    return crossed(readout, crossing).scaled(-0.5 * width)


class TableBacklash(AngleEffect):
    id = "table_backlash"
    needs = "direction"
    stage = "table"
    title = "lost motion on reversal"
    parameters = (Parameter("width", "arcsec", (0.5, 60, 1800), positive=True), CROSSING)
    physics = (
        "Gears and couplings have play; the load rests against the side it was last pushed from."
    )
    equation = (
        "true = readout - width/2 sign(last motion); with a crossing, the play state of the readout"
        " instead of the sign"
    )
    source = "Nordin and Gutman 2002; Physics: Table mechanics"
    excited_by = "approaching the same angle from both sides"
    look = "a rotation that changes sign with the direction of approach; norm unchanged"
    linear = True
    mechanised = True
    superposes = True
    distinguished_by = {"servo_friction_deadband": "read encoder and command both"}

    @classmethod
    def shapes(cls, span: CoordinateRanges) -> list[dict[str, float]]:
        return [{"crossing": w} for w in CROSSINGS]

    def deviation(self, drive: Drive, axis: str, rng: np.random.Generator | None) -> Jet:
        return lost_motion(drive.axes[axis], self.value("width"), self.value("crossing"))

    def mechanisms(self, rig: Rig, gravity: float) -> tuple[Mechanism, ...]:
        return (Gap(self.axis or rig.axis_names[0], self.value("width")),)

    def dynamics(self, rig: Rig, gravity: float) -> tuple[Mechanism, ...]:
        # a gap is crossed over its own width
        return self.mechanisms(rig, gravity) if self.value("crossing") == 0 else ()
