"""``tiltcal export``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tiltcal.calibration.c_export import header
from tiltcal.calibration.correction import setup_of
from tiltcal.calibration.result import load_calibration
from tiltcal.cli.options import Json
from tiltcal.cli.output import print_json, require_output, say, tell
from tiltcal.core.files import write_text


def export(
    calibration_file: Annotated[Path, Parameter("CAL", help="Calibration, JSON.")],
    /,
    *,
    name: Annotated[str, Parameter(help="Prefix of all C names.")] = "tiltcal",
    output: Annotated[
        Path | None, Parameter(alias="-o", help="File of the header; stdout if not given.")
    ] = None,
    as_json: Json = False,
) -> int:
    """Export a placing-angle table as a C header for firmware.

    The header has the 2-D array, look-up with rounding and with interpolation,
    and the corrector, in floating point and in integers. It does not use malloc.

      tiltcal export CAL.json -o bias.h --name level
    """
    require_output("export", output, as_json, "the header")
    calibration = load_calibration(calibration_file)
    text = header(calibration, setup_of(calibration), name)
    if output is None:
        say(text.rstrip("\n"))
        return 0
    write_text(output, text)
    if as_json:
        print_json({"output": str(output), "name": name, "bytes": len(text)})
    else:
        tell(f"{output}: {len(text.splitlines())} lines of C")
    return 0
