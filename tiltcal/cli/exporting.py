"""``tiltcal export``: a calibration as a C header."""

import argparse
import sys
from pathlib import Path

from tiltcal.calibration.c_export import header
from tiltcal.calibration.correction import setup_of
from tiltcal.calibration.result import load_calibration
from tiltcal.cli.output import print_json, require_output
from tiltcal.core.files import write_text


def export(args: argparse.Namespace) -> int:
    """Write the header."""
    require_output(args, "the header")
    calibration = load_calibration(args.calibration)
    text = header(calibration, setup_of(calibration), args.name)
    if not args.output:
        sys.stdout.write(text)
        return 0
    write_text(Path(args.output), text)
    if args.json:
        print_json({"output": args.output, "name": args.name, "bytes": len(text)})
    else:
        print(f"{args.output}: {len(text.splitlines())} lines of C", file=sys.stderr)
    return 0
