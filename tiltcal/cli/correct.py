"""``tiltcal correct``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tiltcal.api.instruments import load_instrument
from tiltcal.calibration.correction import correct_pieces
from tiltcal.cli.options import Json
from tiltcal.cli.output import print_json, print_note, progress_line, require_output, stdout_bytes
from tiltcal.cli.verdict import print_verdict
from tiltcal.core.progress import report_pieces
from tiltcal.recordings.csv_files import csv_writer
from tiltcal.recordings.pieces import estimated_rows, read_pieces, writing


def correct(
    calibration_file: Annotated[Path, Parameter("CAL", help="Calibration (JSON) or amended.toml.")],
    recording: Annotated[Path, Parameter("REC", help="Recording to correct.")],
    /,
    *,
    output: Annotated[
        Path | None,
        Parameter(alias="-o", help="File of the corrected recording; CSV to stdout if not given."),
    ] = None,
    as_json: Json = False,
) -> int:
    """Correct a recording, streaming in constant memory.

    Adds <sensor>_<axis>_corrected_<unit> and, where defined, tilt_x_deg and
    tilt_y_deg. The suffix of -o sets the format: .csv, .parquet or .npz (NPZ is
    written whole).

      tiltcal correct CAL.json run.csv -o corrected.csv
    """
    require_output("correct", output, as_json, "the corrected recording")
    calibration = load_instrument(calibration_file)
    print_verdict(calibration)
    with progress_line() as progress:
        pieces = report_pieces(read_pieces(recording), estimated_rows(recording), progress)
        if output is None:
            with stdout_bytes() as out, csv_writer(out) as write:
                done = correct_pieces(pieces, calibration, write)
        else:
            with writing(output) as write:
                done = correct_pieces(pieces, calibration, write)
    _print_notes(done.notes)
    if output is None:
        return 0
    if as_json:
        print_json({"output": str(output), "rows": done.rows, "notes": done.notes})
    else:
        print_note(f"{output}: {done.rows} rows corrected")
    return 0


def _print_notes(notes: list[str]) -> None:
    for note in notes:
        print_note(f"note: {note}")
