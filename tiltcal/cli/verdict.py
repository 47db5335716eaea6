"""The verdict of a calibration that a command uses."""

from tiltcal.calibration.result import Calibration
from tiltcal.cli.output import print_note


def print_verdict(calibration: Calibration) -> None:
    """Print the verdict with the tests that failed, to stderr."""
    print_note(calibration.headline())
