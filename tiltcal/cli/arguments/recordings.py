"""simulate, init, import: where recordings and scenarios come from."""

from tiltcal.cli.arguments.commands import Commands, output_option


def add(commands: Commands) -> None:
    """Add them to the parser."""
    _simulate(commands)
    _init(commands)
    _import(commands)


def _simulate(commands: Commands) -> None:
    sub = commands.add(
        "simulate",
        "laboratory",
        "simulate",
        "make a recording of a scenario, through MuJoCo",
        "The ending of -o decides the format: .csv, .parquet or .npz; without -o the CSV goes to"
        " stdout.\nThe recording holds no truth; --truth writes the injected values and noiseless"
        " attitudes apart.\n\n  tiltcal simulate bench.toml -o run.csv --seed 7 --truth"
        " truth.json\n  tiltcal simulate model.toml --motion real.csv --noise off -o predicted.csv "
        "  what should it have read?",
    )
    sub.add_argument("scenario", metavar="SCENARIO", help="the scenario's TOML")
    output_option(sub, "where the recording goes")
    sub.add_argument(
        "--motion", metavar="REC", help="replay the time stamps and table readout of this recording"
    )
    sub.add_argument(
        "--noise",
        choices=("on", "off"),
        default="on",
        help="off: no random effect and no quantisation",
    )
    sub.add_argument("--seed", type=int, help="of the random effects (the scenario's unless given)")
    sub.add_argument("--truth", metavar="FILE", help="write the truth here, as JSON")


def _init(commands: Commands) -> None:
    sub = commands.add(
        "init",
        "start",
        "init",
        "write a commented scenario to start from",
        "  tiltcal init -o bench.toml\n  tiltcal init --from run.csv -o bench.toml     sensors and"
        " table from its columns\n  tiltcal init --latitude 52.5 --height 40      gravity from"
        " latitude and height (WGS 84)",
    )
    sub.add_argument(
        "--from",
        dest="recording",
        metavar="REC",
        help="take sensors and table from this recording's columns",
    )
    sub.add_argument("--latitude", type=float, help="deg; gravity is computed from it")
    sub.add_argument("--height", type=float, default=0.0, help="m above sea level")
    sub.add_argument(
        "--json-schema", action="store_true", help="print the JSON Schema of scenario files instead"
    )
    output_option(sub, "where the scenario goes (stdout unless given)")


def _import(commands: Commands) -> None:
    sub = commands.add(
        "import",
        "start",
        "import_",
        "bring a foreign text log in by a mapping file",
        "A mapping file says which column is what:\n\n" + _mapping_example(),
    )
    sub.add_argument("file", metavar="FILE", help="the foreign log")
    sub.add_argument("--map", required=True, metavar="MAP.toml", help="what its columns are")
    output_option(sub, "where the recording goes", required=True)


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
