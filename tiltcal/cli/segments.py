"""``tiltcal segments``."""

import io
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tiltcal.cli.options import Json
from tiltcal.cli.output import print_json, print_note, stdout_bytes
from tiltcal.core.errors import TiltcalError
from tiltcal.recordings.recording_files import read_recording
from tiltcal.recordings.segment_files import save_segments, write_segments
from tiltcal.recordings.segmentation import dwells, find_segments


def segments(
    recording: Annotated[Path, Parameter("REC", help="Recording to search.")],
    /,
    *,
    window: Annotated[float, Parameter(help="Duration over which standstill is judged, s.")] = 0.5,
    output: Annotated[
        Path | None, Parameter(alias="-o", help="File of the list, CSV; stdout if not given.")
    ] = None,
    as_json: Json = False,
) -> int:
    """Find the dwells and moves of a recording.

    The file can be edited and used with `calibrate --segments` and `check
    --segments`.
    """
    if not 0 < window < float("inf"):
        raise TiltcalError(
            "--window",
            found=f"{window:g} s",
            need="a time above zero",
            do="leave it out, or try 0.5",
        )
    found = find_segments(read_recording(recording), window=window)
    if output:
        save_segments(found, output)
    if as_json:
        print_json([vars(s) for s in found])
    elif output:
        still = len(dwells(found))
        print_note(f"{output}: {still} dwells, {len(found) - still} moves")
    else:
        with stdout_bytes() as out:
            text = io.StringIO()
            write_segments(found, text)
            out.write(text.getvalue().encode(errors="replace"))
    return 0
