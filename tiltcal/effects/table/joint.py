"""Errors of the readout of a joint that a gear stands behind, of a user's own model."""

from tiltcal.effects.parameter import Parameter
from tiltcal.effects.spans import CoordinateRanges
from tiltcal.effects.table.readout import ReadoutError
from tiltcal.setup.trajectory import Jet


class HarmonicDriveError(ReadoutError):
    id = "joint_harmonic_drive"
    title = "kinematic error of a harmonic drive"
    parameters = (
        Parameter("cos", "arcsec", (10, 60, 120)),
        Parameter("sin", "arcsec", (10, 60, 120)),
        Parameter("ratio", "", (100, 100, 100), positive=True, default=100.0),
    )
    physics = (
        "The wave generator presses the flexspline out at two places, so that a readout at the"
        " motor is wrong twice a turn of the motor."
    )
    equation = "readout = true + c cos(2 N a) + s sin(2 N a), N the gear ratio"
    source = "Ghorbel, Gandhi and Alpeter 2001; Physics: Joints and links"
    excited_by = "angles that are no multiple of half a turn of the motor; a slow sweep"
    look = "a fast ripple over the joint's angle, twice a turn of the motor"
    linear = True
    of_model = True
    distinguished_by = {"table_encoder_sde": "read motor and joint both"}

    @classmethod
    def shapes(cls, span: CoordinateRanges) -> list[dict[str, float]]:
        return [{"ratio": n} for n in span.gears]

    def error(self, true: Jet, axis: str) -> Jet:
        return true.harmonic(2 * self.value("ratio"), self.value("cos"), self.value("sin"))
