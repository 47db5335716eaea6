"""``tiltcal check``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tiltcal.api.calibrating import judged
from tiltcal.api.instruments import load_instrument
from tiltcal.cli.options import DescribedBy, Json, SegmentsFile
from tiltcal.cli.output import paragraph, print_json, print_line
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.recordings.recording_files import read_recording
from tiltcal.recordings.segment_files import read_segments
from tiltcal.validation.cross_check import Check, Limits


def check(
    calibration: Annotated[Path, Parameter("CAL", help="Calibration (JSON) or amended.toml.")],
    recording_file: Annotated[Path, Parameter("REC", help="Another recording.")],
    /,
    *,
    scenario: DescribedBy,
    limit_arcsec: Annotated[
        float | None, Parameter(help="Largest accepted rms error of the tilt.")
    ] = None,
    limit_ug: Annotated[
        float | None, Parameter(help="Largest accepted rms error of a channel's force.")
    ] = None,
    limit_ppm: Annotated[
        float | None, Parameter(help="Largest accepted rms error of the norm.")
    ] = None,
    limit_deg_h: Annotated[
        float | None, Parameter(help="Largest accepted rms error of a channel's rate.")
    ] = None,
    segments: SegmentsFile = None,
    as_json: Json = False,
) -> int:
    """Check a calibration against another recording.

    Each channel's reading is compared with what the calibration predicts: at
    standstill where attitudes are known (table readout or labels), otherwise by
    the norm; rate sensors in steady turns of a table with a readout. A base tilt,
    and rate sensors without a table, are measured again. Without a limit the
    errors have to agree with their own uncertainty.

    Exit status: 0 accepted; 1 not accepted; 2 unusable input.
    """
    recording = read_recording(recording_file).require_increasing()
    dwells = read_segments(segments, recording) if segments else None
    known, described = load_instrument(calibration), load_scenario(scenario)
    limits = Limits.of(limit_arcsec, limit_ug, limit_ppm, limit_deg_h)
    result = judged(known, recording, described, limits, dwells)
    if as_json:
        print_json(to_json(result))
    else:
        _print_result(result)
    return 0 if result.accepted else 1


def _print_result(result: Check) -> None:
    paragraph(result.statement)
    for q in result.quantities:
        limit = "" if q.limit is None else f", limit {q.limit:.4g}"
        print_line(
            f"{q.sensor} {q.quantity}: {q.rms:.4g} {q.unit} rms, {q.worst:.4g} worst,"
            f" {q.expected:.3g} expected{limit}"
        )
    for t in result.tests:
        paragraph(
            f"{t.name}: {'yes' if t.passed else 'NO'} (chi2 {t.statistic:.4g}, {t.dof} degrees"
            f" of freedom, p {t.p_value:.2g})"
        )
    print_line("accepted" if result.accepted else "not accepted")


def to_json(result: Check) -> dict[str, object]:
    """The result with all rows, in the unit of the leading quantity: arcsec of a tilt."""
    unit, factor = result.unit
    return {
        "accepted": result.accepted,
        "judged_by": result.judged_by,
        f"rms_{unit}": result.rms / factor,
        f"worst_{unit}": result.worst / factor,
        f"expected_{unit}": result.expected / factor,
        "quantities": [vars(q) for q in result.quantities],
        "not_shown": list(result.not_shown),
        "poses": [
            {"start_s": a, "end_s": b, f"error_{unit}": float(e / factor)}
            for (a, b), e in zip(result.spans, result.poses, strict=False)
        ],
        "tests": [vars(t) for t in result.tests],
        "statement": result.statement,
    }
