"""The parser of the command line. Imports nothing heavy: ``--help`` answers at once, each command
loads its own room.
"""

import argparse
from typing import NoReturn

from tiltcal import __version__
from tiltcal.cli.arguments import calibration, design, diagnosis, judging, recordings, reference
from tiltcal.cli.arguments.commands import Commands
from tiltcal.core.errors import TiltcalError

TOP = """\
A testbed for calibrating inclinometers, accelerometers and gyroscopes.

  simulate a table and an instrument with known errors, in MuJoCo
  calibrate recordings, real or simulated, with uncertainties and a verdict
  verify algorithms, yours too, against what was injected
"""
FIRST = """\
first steps:
  tiltcal init -o bench.toml              a commented scenario to start from
  tiltcal simulate bench.toml -o run.csv --truth truth.json
  tiltcal calibrate run.csv --scenario bench.toml --method six_position -o CAL.json
  tiltcal correct CAL.json run.csv -o corrected.csv
  tiltcal run bench.toml                  all of it, judged against the injected truth
"""


class _Parser(argparse.ArgumentParser):
    """Says in the words of all other messages what is wrong with a command line."""

    def error(self, message: str) -> NoReturn:
        """Refuse the command line."""
        found = message.replace("the following arguments are required:", "no")
        raise TiltcalError(
            f"command line of `{self.prog}`",
            found=found,
            need="the arguments its help lists",
            do=f"see `{self.prog} --help`",
        )


def build_parser() -> argparse.ArgumentParser:
    """The parser of all commands."""
    parser = _Parser(
        prog="tiltcal",
        description=TOP,
        epilog=FIRST,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"tiltcal {__version__}")
    commands = Commands(parser)
    for family in (recordings, calibration, diagnosis, design, judging, reference):
        family.add(commands)
    return parser
