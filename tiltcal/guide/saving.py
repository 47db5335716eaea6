"""The files that a guide leaves."""

from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING

from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import write_json, write_text
from tiltcal.recordings.segment_files import write_segments
from tiltcal.report.stated import Stated

if TYPE_CHECKING:
    from tiltcal.guide.guide import Guide


def save_all(guide: "Guide", folder: Path, stated: Stated | None) -> dict[str, Path]:
    """Write all files of a guide; what they are is said by ``Guide.save``.

    Args:
        guide: with a recording.
        folder: that exists.
        stated: what only the laboratory knows; None: no certificate.

    Raises:
        TiltcalError: a file cannot be written.
    """
    state = guide.state
    written = {"recording": folder / "recording.csv"}
    if not state.rows:
        return {}
    guide.recording.save(written["recording"])
    if any(d.reason for d in state.dwells):
        written["raw"] = folder / "raw.csv"
        guide.raw.save(written["raw"])
    with StringIO() as text:
        write_segments(list(guide.segments), text)
        written["segments"] = folder / "segments.csv"
        write_text(written["segments"], text.getvalue())
    try:
        calibration = guide.calibrate()
    except TiltcalError as error:
        guide.note("calibration", str(error))
    else:
        written["calibration"] = folder / "CAL.json"
        calibration.save(written["calibration"])
        written |= {} if stated is None else _certificate(guide, folder, stated)
    written["state"] = folder / "state.json"
    write_json(written["state"], guide.state.to_json())
    return written


def _certificate(guide: "Guide", folder: Path, stated: Stated) -> dict[str, Path]:
    certificate = guide.certify(stated)
    written = {"certificate": folder / "certificate.html"}
    if stated.date:
        written["dcc"] = folder / "certificate.xml"
    for path in written.values():
        certificate.save(path)
    return written
