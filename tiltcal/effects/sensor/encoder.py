"""Errors of an encoder that is read beside the command."""

from tiltcal.effects.parameter import Parameter
from tiltcal.effects.sense import ENCODER
from tiltcal.effects.sensor.gyro import GyrBias


class EncBias(GyrBias):
    id = "enc_bias"
    title = "zero of an encoder"
    kinds = ENCODER
    parameters = (Parameter("bias_{axis}", "arcsec", (10, 100, 10000)),)
    physics = "The encoder's zero is not where the command's is."
    source = "Physics: Table mechanics"
