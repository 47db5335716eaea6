"""Comparison and combination of calibrations from Python, and the report of a comparison."""

from collections.abc import Sequence
from pathlib import Path

from tiltcal.calibration.combination import Combination
from tiltcal.calibration.combination import combine as joined
from tiltcal.calibration.result import Calibration
from tiltcal.core.files import write_json
from tiltcal.report.comparison import write_comparison
from tiltcal.validation.comparison import Comparison, Range
from tiltcal.validation.comparison import compare as compared


def combine(*calibrations: Calibration) -> Combination:
    """The joint estimate of calibrations of one instrument.

    Args:
        calibrations: two or more.

    Raises:
        TiltcalError: they are not of one instrument, or cannot be joined.
    """
    return joined(calibrations)


def compare(
    *calibrations: Calibration, names: Sequence[str] | None = None, within: Sequence[str] = ()
) -> Comparison:
    """The differences of calibrations over the working range.

    Args:
        calibrations: two or more.
        names: of them.
        within: ranges such as ``tilt=30``, ``temperature=-40:85``, ``rate=200``, ``angle=-90:90``.

    Raises:
        TiltcalError: fewer than two, or nothing in common.
    """
    return compared(calibrations, names, Range.of(within))


def report_comparison(found: Comparison, folder: Path) -> None:
    """Write comparison.json and report.html.

    Args:
        found: what they show.
        folder: that they are written to.

    Raises:
        TiltcalError: a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "comparison.json", found.to_json())
    write_comparison(found, folder / "report.html")
