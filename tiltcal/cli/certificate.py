"""``tiltcal certificate``, and the options of ``tiltcal calibrate`` that write one."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from cyclopts import Group, Parameter

from tiltcal.api.certifying import certificate_of
from tiltcal.api.instruments import load_instrument
from tiltcal.api.table_scene import table_picture
from tiltcal.calibration.result import Calibration
from tiltcal.cli.options import Json
from tiltcal.cli.output import print_json, print_note
from tiltcal.cli.verdict import print_verdict
from tiltcal.core.errors import TiltcalError
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment
from tiltcal.report.certificate import Certificate, make_certificate, write_certificate
from tiltcal.report.dcc import require_date, write_dcc
from tiltcal.report.stated import NOTHING_STATED, Stated
from tiltcal.validation.uncertainty_budget import UncertaintyBudget

Statements = Annotated[
    Stated, Parameter(name="*", group=Group("Statements of the laboratory", sort_key=1))
]
DccFile = Annotated[
    Path | None,
    Parameter("--dcc", help="Digital calibration certificate (DCC 3.2.1) to write, XML."),
]
ReportFile = Annotated[
    Path | None, Parameter("--report", help="Calibration certificate to write, HTML.")
]


def certificate(
    calibration_file: Annotated[Path, Parameter("CAL", help="Calibration (JSON) or amended.toml.")],
    /,
    *,
    output: Annotated[
        Path | None, Parameter(alias="-o", help="Certificate to write, HTML.")
    ] = None,
    dcc: DccFile = None,
    stated: Statements = NOTHING_STATED,
    as_json: Json = False,
) -> int:
    """Write the certificate of a calibration.

    A page of two printed sides, and with --dcc the digital calibration certificate
    of PTB. What was measured at the poses needs the recording, and the budget of
    assumed sources too: `tiltcal calibrate ... --report out.html` has them.

      tiltcal certificate CAL.json -o out.html --serial 1234 --laboratory "Lab, City"
      tiltcal certificate CAL.json --dcc out.xml --date 2026-11-23

    Exit status: 0 written; 2 unusable input.
    """
    if output is None and dcc is None:
        raise TiltcalError(
            "command line of `tiltcal certificate`",
            found="neither -o nor --dcc",
            need="a file to write",
            do="add -o out.html",
        )
    require_statements(stated, dcc)
    calibration = load_instrument(calibration_file)
    print_verdict(calibration)
    made = make_certificate(calibration, stated)
    if output is not None:
        made = replace(made, picture=table_picture(made.setup))
    written = write_files(made, output, dcc)
    if as_json:
        print_json({"number": made.number, "verdict": calibration.verdict, "written": written})
    return 0


def require_statements(stated: Stated, dcc: Path | None) -> None:
    """Before anything is done, refuse a DCC without what its schema requires.

    Raises:
        TiltcalError: the day of measurement is missing.
    """
    if dcc is not None:
        require_date(stated)


def write_files(made: Certificate, page: Path | None, dcc: Path | None) -> list[str]:
    """Write the page and the DCC, whichever is wanted, with a note on stderr for each."""
    if page is not None:
        write_certificate(made, page)
    if dcc is not None:
        write_dcc(made, dcc)
    written = [str(path) for path in (page, dcc) if path is not None]
    for path in written:
        print_note(f"{path}: certificate {made.number}")
    return written


def write_reports(
    calibration: Calibration,
    recording: Recording,
    budget: UncertaintyBudget | None,
    segments: Sequence[Segment] | None,
    stated: Stated,
    page: Path | None,
    dcc: Path | None,
) -> None:
    """What ``tiltcal calibrate`` writes for --report and --dcc."""
    if page is not None or dcc is not None:
        made = certificate_of(calibration, stated, recording, budget, segments)
        if page is not None:
            made = replace(made, picture=table_picture(made.setup))
        write_files(made, page, dcc)
