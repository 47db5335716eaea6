"""The words of the command line. Imports nothing heavy: ``--help`` answers at once, each command loads its own room."""

import argparse
import importlib
from collections.abc import Callable
from typing import Any, NoReturn

from tiltcal import __version__
from tiltcal.errors import TiltcalError

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


def lazily(module: str, function: str) -> Callable[[argparse.Namespace], int]:
    """A command whose module is imported only when it runs."""

    def run(args: argparse.Namespace) -> int:
        return int(getattr(importlib.import_module(f"tiltcal.cli.{module}"), function)(args))

    return run


class _Parser(argparse.ArgumentParser):
    """Says in the words of all other messages what is wrong with a command line."""

    def error(self, message: str) -> NoReturn:
        """Refuse the command line."""
        found = message.replace("the following arguments are required:", "no")
        raise TiltcalError(
            f"command line of `{self.prog}`", found=found, need="the arguments its help lists", do=f"see `{self.prog} --help`"
        )


class _Commands:
    """Adds commands to the parser, all alike."""

    def __init__(self, parser: argparse.ArgumentParser) -> None:
        self.group = parser.add_subparsers(dest="command", metavar="COMMAND", title="commands")

    def add(self, name: str, module: str, function: str, help: str, more: str = "") -> argparse.ArgumentParser:
        sub = self.group.add_parser(
            name, help=help, description=help[0].upper() + help[1:] + ".", epilog=more,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )  # fmt: skip
        sub.add_argument("--json", action="store_true", help="machine-readable output on stdout")
        sub.set_defaults(run=lazily(module, function))
        return sub


def build_parser() -> argparse.ArgumentParser:
    """The parser of all commands."""
    parser = _Parser(prog="tiltcal", description=TOP, epilog=FIRST, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--version", action="version", version=f"tiltcal {__version__}")
    commands = _Commands(parser)
    _add_laboratory(commands)
    _add_calibration(commands)
    _add_noise(commands)
    _add_diagnosis(commands)
    _add_design(commands)
    _add_investigation(commands)
    _add_judging(commands)
    _add_reference(commands)
    return parser


def _scenario(sub: argparse.ArgumentParser, required: bool = True) -> None:
    sub.add_argument("--scenario", required=required, metavar="TOML", help="site, rig and sensors of the recording")


def _output(sub: argparse.ArgumentParser, help: str, metavar: str = "FILE", **more: Any) -> None:
    sub.add_argument("-o", "--output", metavar=metavar, help=help, **more)


def _add_laboratory(commands: _Commands) -> None:
    sub = commands.add(
        "simulate", "laboratory", "simulate", "make a recording of a scenario, through MuJoCo",
        "The ending of -o decides the format: .csv, .parquet or .npz; without -o the CSV goes to stdout.\n"
        "The recording holds no truth; --truth writes the injected values and noiseless attitudes apart.\n\n"
        "  tiltcal simulate bench.toml -o run.csv --seed 7 --truth truth.json\n"
        "  tiltcal simulate model.toml --motion real.csv --noise off -o predicted.csv   what should it have read?",
    )  # fmt: skip
    sub.add_argument("scenario", metavar="SCENARIO", help="the scenario's TOML")
    _output(sub, "where the recording goes")
    sub.add_argument("--motion", metavar="REC", help="replay the time stamps and table readout of this recording")
    sub.add_argument("--noise", choices=("on", "off"), default="on", help="off: no random effect and no quantisation")
    sub.add_argument("--seed", type=int, help="of the random effects (the scenario's unless given)")
    sub.add_argument("--truth", metavar="FILE", help="write the truth here, as JSON")
    sub = commands.add(
        "init", "start", "init", "write a commented scenario to start from",
        "  tiltcal init -o bench.toml\n  tiltcal init --from run.csv -o bench.toml     sensors and table from its columns\n"
        "  tiltcal init --latitude 52.5 --height 40      gravity from latitude and height (WGS 84)",
    )  # fmt: skip
    sub.add_argument("--from", dest="recording", metavar="REC", help="take sensors and table from this recording's columns")
    sub.add_argument("--latitude", type=float, help="deg; gravity is computed from it")
    sub.add_argument("--height", type=float, default=0.0, help="m above sea level")
    sub.add_argument("--json-schema", action="store_true", help="print the JSON Schema of scenario files instead")
    _output(sub, "where the scenario goes (stdout unless given)")
    sub = commands.add(
        "import", "start", "import_", "bring a foreign text log in by a mapping file",
        "A mapping file says which column is what:\n\n" + _mapping_example(),
    )  # fmt: skip
    sub.add_argument("file", metavar="FILE", help="the foreign log")
    sub.add_argument("--map", required=True, metavar="MAP.toml", help="what its columns are")
    _output(sub, "where the recording goes", required=True)


def _mapping_example() -> str:
    return """\
  [file]
  separator = "space"        # space (any white space), comma, tab, semicolon
  header = false
  [time]
  column = 1                 # number, or name in the header; or rate_hz = 100 where there is none
  unit = "s"
  [[column]]
  from = 2                   # number or name
  to = "accel_x_LSB"         # <sensor>_<axis>_<unit>
  [[column]]
  file = "gyro.txt"          # a second file beside the first, row by row
  from = 2
  to = "gyro_x_LSB"
"""


def _add_calibration(commands: _Commands) -> None:
    sub = commands.add(
        "calibrate", "calibrating", "calibrate", "recover parameters with covariance, tests and a verdict",
        "METHOD is one of `tiltcal methods`, an installed entry point, or your own package.module:function,\n"
        "called with the Recording and the Setup; it returns a Calibration.\n\n"
        "  tiltcal calibrate run.csv --scenario bench.toml --method norm --option terms=9 -o CAL.json\n\n"
        "exit status: 0 good; 1 suspect or cannot_tell; 2 unusable input",
    )  # fmt: skip
    sub.add_argument("recording", metavar="REC")
    _scenario(sub)
    sub.add_argument("--method", required=True, metavar="METHOD")
    sub.add_argument(
        "--option",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="of the method; may stand several times",
    )
    sub.add_argument("--segments", metavar="SEG.csv", help="dwells as `tiltcal segments` writes them, edited")
    sub.add_argument(
        "--budget", action="store_true", help="the uncertainty budget as well: sources of [[budget]], or the usual ones"
    )
    _output(sub, "where the calibration goes", "CAL.json")
    sub = commands.add(
        "correct", "calibrating", "correct", "correct a recording, streaming in fixed memory",
        "Adds <sensor>_<axis>_corrected_<unit> and, where defined, tilt_x_deg and tilt_y_deg.\n\n"
        "  tiltcal correct CAL.json run.csv -o corrected.csv",
    )  # fmt: skip
    sub.add_argument("calibration", metavar="CAL.json")
    sub.add_argument("recording", metavar="REC")
    _output(sub, "where the CSV goes (stdout unless given)", "OUT.csv")
    sub = commands.add(
        "export", "exporting", "export", "write a placing-angle table as a C header for firmware",
        "2-D array, rounding and interpolating look-up and the corrector, in float (or double) and in integers; no malloc.\n\n"
        "  tiltcal export CAL.json -o bias.h --name level",
    )  # fmt: skip
    sub.add_argument("calibration", metavar="CAL.json")
    sub.add_argument("--name", default="tiltcal", help="what every C name begins with (default: tiltcal)")
    _output(sub, "where the header goes (stdout unless given)", "TABLE.h")
    sub = commands.add(
        "check", "calibrating", "check", "is this calibration good on that other recording?",
        "Where attitudes are known (table readout, labels) the tilt error is judged, else the norm.\n"
        "Without a limit the error has to agree with its own uncertainty.",
    )  # fmt: skip
    sub.add_argument("calibration", metavar="CAL.json")
    sub.add_argument("recording", metavar="REC")
    _scenario(sub)
    sub.add_argument("--limit-arcsec", type=float, metavar="X", help="largest rms error that is good enough")
    sub.add_argument("--segments", metavar="SEG.csv", help="dwells as `tiltcal segments` writes them, edited")
    sub = commands.add(
        "segments", "calibrating", "segments", "find the dwells and moves of a recording",
        "The file can be edited and given back to `calibrate --segments`.",
    )  # fmt: skip
    sub.add_argument("recording", metavar="REC")
    sub.add_argument("--window", type=float, default=0.5, help="s over which quiet is judged (default 0.5)")
    _output(sub, "where the list goes (stdout unless given)", "SEG.csv")


def _add_noise(commands: _Commands) -> None:
    sub = commands.add(
        "noise", "noise", "noise", "Allan coefficients of a record at rest, and the effect tables that simulate it",
        "The longest dwell is used. A slope that the record does not hold is said so, not guessed.",
    )  # fmt: skip
    sub.add_argument("recording", metavar="REC")


def _add_diagnosis(commands: _Commands) -> None:
    sub = commands.add(
        "diagnose", "diagnosing", "diagnose", "what physics was left out: locate the mismatch, name it, model it",
        "Writes diagnosis.json, amended.toml and report.html under -o DIR. Several recordings of one set-up are explained\n"
        "together. Faults of the data (time going back, repeats, frozen channels) are findings.\n\n"
        "  tiltcal diagnose run.csv --scenario bench.toml -o out\n"
        "  tiltcal diagnose run.csv --scenario out/amended.toml --check        exit status 1 unless it matches",
    )  # fmt: skip
    sub.add_argument("recording", nargs="+", metavar="REC")
    _scenario(sub)
    sub.add_argument("--static", metavar="REC", help="a record at rest to take the noise from")
    sub.add_argument("--check", action="store_true", help="exit status 1 on anything but match")
    _output(sub, "folder for the answer", "DIR")


def _add_investigation(commands: _Commands) -> None:
    sub = commands.add(
        "investigate", "investigating", "investigate_", "diagnose, record what splits the rivals, diagnose again, until explained",
        "LAB is called as `LAB SEQUENCE.csv RECORDING.csv`, without a shell; a real table, or a simulated one, may be behind it.\n"
        "Everything is kept under -o DIR: log.md, investigation.json, sequences, recordings, diagnoses.\n\n"
        "  tiltcal investigate first.csv --scenario bench.toml --lab './record --table 2' -o out\n"
        "  tiltcal investigate --scenario bench.toml --lab 'tiltcal lab concealed.toml' -o out\n\n"
        "exit status: 0 explained; 1 not explained within the budget, or out of this table's reach; 2 unusable input",
    )  # fmt: skip
    sub.add_argument("recording", nargs="*", metavar="REC", help="recorded so far; without any the scenario's sequence comes first")
    _scenario(sub)
    sub.add_argument("--lab", required=True, metavar="COMMAND", help="who records")
    sub.add_argument("--blocks", type=int, default=2, help="designed blocks at most (default 2)")
    sub.add_argument("--budget-min", type=float, default=10.0, help="minutes of table time for all of them (default 10)")
    sub.add_argument("--resume", action="store_true", help="go on where the folder stands; nothing is recorded twice")
    _block_limits(sub)
    _output(sub, "folder for everything (default: investigation)", "DIR", default="investigation")
    sub = commands.add(
        "lab", "investigating", "lab", "a simulated laboratory: record a sequence file with a scenario's effects, through MuJoCo",
        "Events of the scenario (steps, slips) lie behind it; the seed follows from the sequence and the scenario's own.",
    )  # fmt: skip
    sub.add_argument("scenario", metavar="SCENARIO", help="with what is concealed")
    sub.add_argument("sequence", metavar="SEQUENCE.csv")
    sub.add_argument("recording", metavar="RECORDING.csv")
    sub.add_argument("--seed", type=int, help="in place of the scenario's")


def _block_limits(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--block-min", type=float, default=3.0, help="minutes of table time of one block at most (default 3)")
    sub.add_argument("--rate-deg-s", type=float, default=30.0, help="of moves; turns go up to twice of it (default 30)")
    sub.add_argument("--dwell-s", type=float, default=3.0, help="at each pose (default 3)")
    sub.add_argument(
        "--angles", action="append", default=[], metavar="AXIS=LOW:HIGH", help="allowed angles of an axis, deg; may be repeated"
    )


def _add_design(commands: _Commands) -> None:
    sub = commands.add(
        "design", "designing", "design_", "the sequence of poses with the most information for a table time",
        "Writes design.toml (simulate follows it), steps.csv (a laboratory does), steps.txt, segments.csv and design.json under\n"
        "-o DIR. Terms: what the sensors' adjustable lists and [[effect]] tables with fit = true name, unless --terms does.\n\n"
        "  tiltcal design bench.toml --budget-s 300 -o out\n"
        "  tiltcal design bench.toml --budget-s 900 --terms bias scale cross_axis K2 K3 --angles outer=-90:90\n"
        "  tiltcal design bench.toml --budget-s 900 --terms all --nuisance drift table_levelling\n"
        "  tiltcal design --textbook quadratic --budget-s 300\n"
        "  tiltcal design --split out/diagnosis.json --scenario bench.toml -o next      sequence.csv, next_block.json",
    )  # fmt: skip
    sub.add_argument("scenario", nargs="?", metavar="SCENARIO", help="site, rig, sensors, noise, climate")
    sub.add_argument("--budget-s", dest="budget", type=float, default=300.0, help="s of table time (default 300)")
    sub.add_argument(
        "--terms", nargs="+", default=[], metavar="TERM", help="of interest: bias, scale, cross_axis, K2 ..., an id, or all"
    )
    sub.add_argument(
        "--nuisance", nargs="+", default=["drift"], metavar="TERM", help="fitted too, not of interest (default drift; or none)"
    )
    sub.add_argument("--textbook", metavar="KIND", help="linear, K2, K2K3, quadratic or cubic, in place of the product's own terms")
    sub.add_argument("--criterion", default="both", help="tilt (or I), D, A, or both: the mean of D and tilt (default)")
    sub.add_argument(
        "--grade", choices=("precision", "mid_mems", "consumer"), default="mid_mems", help="whose plausible sizes are the prior"
    )
    sub.add_argument("--prior", type=float, help="one relative size for all priors instead: g, or g per power of g")
    sub.add_argument(
        "--range-deg", type=float, default=180.0, help="working range about level for the tilt error (default: everywhere)"
    )
    sub.add_argument("--rate-deg-s", type=float, default=20.0, help="of moves, all axes at once (default 20)")
    sub.add_argument("--settle-s", type=float, default=5.0, help="after each move (default 5)")
    sub.add_argument(
        "--dwell-s", type=float, nargs=2, default=(5.0, 60.0), metavar=("LEAST", "MOST"), help="of reading (default 5 60)"
    )
    sub.add_argument(
        "--angles", action="append", default=[], metavar="AXIS=LOW:HIGH", help="allowed angles of an axis, deg; may be repeated"
    )
    sub.add_argument("--step-deg", type=float, default=0.0, help="angles are multiples of this (default: any)")
    sub.add_argument("--floor-ug", type=float, default=20.0, help="what no averaging removes from a pose mean (default 20)")
    sub.add_argument(
        "--blind-to-nothing", type=int, metavar="POSES",
        help="instead: so many poses whose least visible effect (of second and third order, kinks, table harmonics, drifts) "
        "is seen best; the bound that no design can pass is printed beside it",
    )  # fmt: skip
    sub.add_argument("--sensor", help="which, when several fit")
    sub.add_argument("--seed", type=int, default=0, help="of the search (default 0)")
    sub.add_argument(
        "--split", metavar="DIAGNOSIS.json", help="propose the block that tells the rivals of a diagnosis apart instead"
    )
    sub.add_argument("--scenario", dest="diagnosed", metavar="TOML", help="with --split: the scenario that was diagnosed")
    sub.add_argument(
        "--recordings",
        nargs="+",
        default=[],
        metavar="REC",
        help="with --split: what was diagnosed (default: as the diagnosis has it)",
    )
    _output(sub, "folder for the plan", "DIR")


def _add_judging(commands: _Commands) -> None:
    sub = commands.add(
        "run", "judging", "run", "simulate, calibrate and judge scenarios",
        "A scenario with [[method]] tables says which methods have to reach what.\n\n"
        "  tiltcal run bench.toml -o out        writes out/report.html and out/junit.xml as well",
    )  # fmt: skip
    sub.add_argument("scenario", nargs="+", metavar="SCENARIO")
    _judging_options(sub)
    sub = commands.add(
        "verify", "judging", "verify", "run a folder of scenarios; JUnit XML, HTML report, exit status for CI",
        "  tiltcal verify scenarios -o out\n  tiltcal verify                     the built-in scenarios",
    )  # fmt: skip
    sub.add_argument("folder", nargs="?", metavar="DIR", help="the built-in scenarios unless given")
    _judging_options(sub)
    sub = commands.add(
        "prove", "proving", "prove", "blind trials of `diagnose`: how often it is right, with intervals",
        "A generator of its own (closed form, none of this program's code) conceals physics in recordings of seven kinds of\n"
        "set-up. The diagnosis gets copies of recording and scenario; the truth is written once its answer is in.\n"
        "Needs a source checkout. Finished trials in DIR are not run again. Exit status 1: a figure is out of reach of chance.\n\n"
        "  tiltcal prove --n 30 -j 4 -o proof             30 trials of each type\n"
        "  tiltcal prove --n 100 --types null unlisted --kinds dual_tumble three_rates",
    )  # fmt: skip
    sub.add_argument("--n", type=int, default=5, help="trials of each type (default 5)")
    sub.add_argument("--kinds", nargs="+", metavar="KIND", help="of set-ups (default: all seven)")
    sub.add_argument("--types", nargs="+", metavar="TYPE", help="null single odd data pair unlisted impossible (default: all)")
    sub.add_argument("--seed", type=int, default=0, help="other trials (default 0)")
    sub.add_argument("-j", "--jobs", type=int, default=1, help="at once (default 1)")
    sub.add_argument("--trials", metavar="TESTS", help="folder that holds blind/ (default: tests of this checkout)")
    _output(sub, "folder for cases, answers and truth (a temporary one unless given)", "DIR")
    sub = commands.add(
        "demo", "demo", "demo", "a tour: simulate, calibrate, verify; then conceal an effect and diagnose it",
        "The concealed effect is drawn at random; the seed is printed, --seed repeats it.",
    )  # fmt: skip
    sub.add_argument("--seed", type=int, help="what is concealed (drawn at random unless given)")
    _output(sub, "folder for the report (default: demo-output)", "DIR", default="demo-output")


def _judging_options(sub: argparse.ArgumentParser) -> None:
    _output(sub, "folder for report.html and junit.xml", "DIR")
    sub.add_argument("--allow-commands", action="store_true", help="let scenarios run programs as methods")


def _add_reference(commands: _Commands) -> None:
    commands.add("methods", "reference", "methods", "list the calibration methods")
    sub = commands.add(
        "effects", "reference", "effects", "list the physical effects, or explain one",
        "  tiltcal effects             all\n  tiltcal effects acc_K2      one, with its equation, look and parameters",
    )  # fmt: skip
    sub.add_argument("word", nargs="?", metavar="ID", help="an id, or a word to search for")
    sub = commands.add(
        "confuse", "confusing", "confuse_", "what a scenario's recording can and cannot tell apart",
        "For every effect of the catalogue: the share that the adjustable terms absorb, the size it would be found at,\n"
        "the share that nothing else explains, and what it cannot be told from, with what to record to split them.",
    )  # fmt: skip
    sub.add_argument("scenario", metavar="SCENARIO")
    sub.add_argument("--grade", choices=("precision", "mid_mems", "consumer"), default="mid_mems", help="whose plausible sizes")
    sub = commands.add(
        "explain-frames", "confusing", "explain_frames", "what each channel should read at the six faces and small turns",
        "The first thing to compare with a real set-up.",
    )  # fmt: skip
    sub.add_argument("scenario", metavar="SCENARIO")
