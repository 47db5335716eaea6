"""``tiltcal check``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tiltcal.api.calibrating import judged
from tiltcal.calibration.result import load_calibration
from tiltcal.cli.options import DescribedBy, Json, SegmentsFile
from tiltcal.cli.output import paragraph, print_json, print_line
from tiltcal.core.units import ARCSEC
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.recordings.recording_files import read_recording
from tiltcal.recordings.segment_files import read_segments
from tiltcal.validation.cross_check import Check


def check(
    calibration: Annotated[Path, Parameter("CAL", help="Calibration, JSON.")],
    recording_file: Annotated[Path, Parameter("REC", help="Another recording.")],
    /,
    *,
    scenario: DescribedBy,
    limit_arcsec: Annotated[float | None, Parameter(help="Largest accepted rms error.")] = None,
    segments: SegmentsFile = None,
    as_json: Json = False,
) -> int:
    """Check a calibration against another recording.

    Where attitudes are known (table readout or labels) the tilt error is judged,
    otherwise the norm. Without a limit the error has to agree with its own
    uncertainty.

    Exit status: 0 accepted; 1 not accepted; 2 unusable input.
    """
    recording = read_recording(recording_file).require_increasing()
    dwells = read_segments(segments, recording) if segments else None
    known, described = load_calibration(calibration), load_scenario(scenario)
    result = judged(known, recording, described, limit_arcsec, dwells)
    if as_json:
        print_json(to_json(result))
    else:
        _print_result(result)
    return 0 if result.accepted else 1


def _print_result(result: Check) -> None:
    paragraph(result.statement)
    for t in result.tests:
        paragraph(
            f"{t.name}: {'yes' if t.passed else 'NO'} (chi2 {t.statistic:.4g}, {t.dof} degrees"
            f" of freedom, p {t.p_value:.2g})"
        )
    print_line("accepted" if result.accepted else "not accepted")


def to_json(result: Check) -> dict[str, object]:
    """The result with all poses, in arcseconds."""
    return {
        "accepted": result.accepted,
        "judged_by": result.judged_by,
        "rms_arcsec": result.rms / ARCSEC,
        "worst_arcsec": result.worst / ARCSEC,
        "expected_arcsec": result.expected / ARCSEC,
        "poses": [
            {"start_s": a, "end_s": b, "error_arcsec": float(e / ARCSEC)}
            for (a, b), e in zip(result.spans, result.poses, strict=False)
        ],
        "tests": [vars(t) for t in result.tests],
        "statement": result.statement,
    }
