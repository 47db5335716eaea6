"""``tiltcal export``."""

import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tiltcal.calibration.c_export import header
from tiltcal.calibration.correction import setup_of
from tiltcal.calibration.result import load_calibration
from tiltcal.cli.options import Json
from tiltcal.cli.output import print_json, require_output
from tiltcal.cli.verdict import print_verdict
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
    """Export a calibration as a C header for firmware.

    Placing-angle tables: the 2-D array, look-up with rounding and with
    interpolation, and the corrector, in floating point and in integers. Triads:
    bias, scale and axes, over temperature too, in floating point. No malloc.

      tiltcal export CAL.json -o bias.h --name level
    """
    require_output("export", output, as_json, "the header")
    calibration = load_calibration(calibration_file)
    print_verdict(calibration)
    text = header(calibration, setup_of(calibration), name)
    if output is None:
        sys.stdout.write(text)
        return 0
    write_text(output, text)
    if as_json:
        print_json({"output": str(output), "name": name, "bytes": len(text)})
    else:
        print(f"{output}: {len(text.splitlines())} lines of C", file=sys.stderr)
    return 0
