"""``tiltcal correct``."""

import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tiltcal.calibration.correction import correct_stream
from tiltcal.calibration.result import load_calibration
from tiltcal.cli.options import Json
from tiltcal.cli.output import print_json, require_output
from tiltcal.core.files import replacing


def correct(
    calibration_file: Annotated[Path, Parameter("CAL", help="Calibration, JSON.")],
    recording: Annotated[Path, Parameter("REC", help="Recording to correct.")],
    /,
    *,
    output: Annotated[
        Path | None,
        Parameter(alias="-o", help="File of the corrected recording, CSV; stdout if not given."),
    ] = None,
    as_json: Json = False,
) -> int:
    """Correct a recording, streaming in constant memory.

    Adds <sensor>_<axis>_corrected_<unit> and, where defined, tilt_x_deg and
    tilt_y_deg.

      tiltcal correct CAL.json run.csv -o corrected.csv
    """
    require_output("correct", output, as_json, "the corrected recording")
    calibration = load_calibration(calibration_file)
    if output is None:
        _print_notes(correct_stream(recording, calibration, sys.stdout.buffer).notes)
        return 0
    with replacing(output) as temporary, temporary.open("wb") as out:
        done = correct_stream(recording, calibration, out)
    _print_notes(done.notes)
    if as_json:
        print_json({"output": str(output), "rows": done.rows, "notes": done.notes})
    else:
        print(f"{output}: {done.rows} rows corrected", file=sys.stderr)
    return 0


def _print_notes(notes: list[str]) -> None:
    for note in notes:
        print(f"note: {note}", file=sys.stderr)
