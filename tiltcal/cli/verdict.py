"""The verdict of a calibration that a command uses."""

from tiltcal.calibration.result import Calibration
from tiltcal.cli.output import tell


def print_verdict(calibration: Calibration) -> None:
    """Print the verdict with the tests that failed, to stderr."""
    failed = [f"{t.name}: {t.statement}" for t in calibration.tests if not t.passed]
    words = f"calibration by {calibration.method}: {calibration.verdict}"
    tell("; ".join([words, *failed]))
