"""calibrate, correct, export, check, segments, noise: from a recording to a calibration."""

from tiltcal.cli.arguments.commands import Commands, output_option, scenario_option, segments_option


def add(commands: Commands) -> None:
    """Add them to the parser."""
    _calibrate(commands)
    _correct(commands)
    _export(commands)
    _check(commands)
    _segments(commands)
    _noise(commands)


def _calibrate(commands: Commands) -> None:
    sub = commands.add(
        "calibrate",
        "calibrating",
        "calibrate",
        "recover parameters with covariance, tests and a verdict",
        "METHOD is one of `tiltcal methods`, an installed entry point, or your own"
        " package.module:function,\ncalled with the Recording and the Setup; it returns a"
        " Calibration.\n\n  tiltcal calibrate run.csv --scenario bench.toml --method norm --option"
        " terms=9 -o CAL.json\n\nexit status: 0 good; 1 suspect or cannot_tell; 2 unusable input",
    )
    sub.add_argument("recording", metavar="REC")
    scenario_option(sub)
    sub.add_argument("--method", required=True, metavar="METHOD")
    sub.add_argument(
        "--option",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="of the method; may stand several times",
    )
    segments_option(sub)
    sub.add_argument(
        "--budget",
        action="store_true",
        help="the uncertainty budget as well: sources of [[budget]], or the usual ones",
    )
    output_option(sub, "where the calibration goes", "CAL.json")


def _correct(commands: Commands) -> None:
    sub = commands.add(
        "correct",
        "calibrating",
        "correct",
        "correct a recording, streaming in fixed memory",
        "Adds <sensor>_<axis>_corrected_<unit> and, where defined, tilt_x_deg and tilt_y_deg.\n\n"
        "  tiltcal correct CAL.json run.csv -o corrected.csv",
    )
    sub.add_argument("calibration", metavar="CAL.json")
    sub.add_argument("recording", metavar="REC")
    output_option(sub, "where the CSV goes (stdout unless given)", "OUT.csv")


def _export(commands: Commands) -> None:
    sub = commands.add(
        "export",
        "exporting",
        "export",
        "write a placing-angle table as a C header for firmware",
        "2-D array, rounding and interpolating look-up and the corrector, in float (or double) and"
        " in integers; no malloc.\n\n  tiltcal export CAL.json -o bias.h --name level",
    )
    sub.add_argument("calibration", metavar="CAL.json")
    sub.add_argument(
        "--name", default="tiltcal", help="what every C name begins with (default: tiltcal)"
    )
    output_option(sub, "where the header goes (stdout unless given)", "TABLE.h")


def _check(commands: Commands) -> None:
    sub = commands.add(
        "check",
        "calibrating",
        "check",
        "is this calibration good on that other recording?",
        "Where attitudes are known (table readout, labels) the tilt error is judged, else the"
        " norm.\nWithout a limit the error has to agree with its own uncertainty.",
    )
    sub.add_argument("calibration", metavar="CAL.json")
    sub.add_argument("recording", metavar="REC")
    scenario_option(sub)
    sub.add_argument(
        "--limit-arcsec", type=float, metavar="X", help="largest rms error that is good enough"
    )
    segments_option(sub)


def _segments(commands: Commands) -> None:
    sub = commands.add(
        "segments",
        "calibrating",
        "segments",
        "find the dwells and moves of a recording",
        "The file can be edited and given back to `calibrate --segments`.",
    )
    sub.add_argument("recording", metavar="REC")
    sub.add_argument(
        "--window", type=float, default=0.5, help="s over which quiet is judged (default 0.5)"
    )
    output_option(sub, "where the list goes (stdout unless given)", "SEG.csv")


def _noise(commands: Commands) -> None:
    sub = commands.add(
        "noise",
        "noise",
        "noise",
        "Allan coefficients of a record at rest, and the effect tables that simulate it",
        "The longest dwell is used. A slope that the record does not hold is said so, not guessed.",
    )
    sub.add_argument("recording", metavar="REC")
