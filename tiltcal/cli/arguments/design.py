"""design: which poses to record."""

import argparse

from tiltcal.cli.arguments.commands import Commands, angles_option, output_option

Group = argparse._ArgumentGroup


def add(commands: Commands) -> None:
    """Add them to the parser."""
    _design(commands)


def _design(commands: Commands) -> None:
    sub = commands.add(
        "design",
        "designing",
        "design_",
        "the sequence of poses with the most information for a table time",
        "Writes design.toml (simulate follows it), steps.csv (a laboratory does), steps.txt,"
        " segments.csv and design.json under\n-o DIR. Terms: what the sensors' adjustable lists and"
        " [[effect]] tables with fit = true name, unless --terms does.\n\n  tiltcal design"
        " bench.toml --budget-s 300 -o out\n  tiltcal design bench.toml --budget-s 900 --terms bias"
        " scale cross_axis K2 K3 --angles outer=-90:90\n  tiltcal design bench.toml --budget-s 900"
        " --terms all --nuisance drift table_levelling\n  tiltcal design --textbook quadratic"
        " --budget-s 300\n  tiltcal design --split out/diagnosis.json --scenario bench.toml -o next"
        "      sequence.csv, next_block.json",
    )
    sub.add_argument(
        "scenario", nargs="?", metavar="SCENARIO", help="site, rig, sensors, noise, climate"
    )
    sub.add_argument("--seed", type=int, default=0, help="of the search (default 0)")
    _what_is_wanted(sub.add_argument_group("what is wanted"))
    _table_time(sub.add_argument_group("what table and readings can do"))
    _instead(sub.add_argument_group("instead"))
    output_option(sub, "folder for the plan", "DIR")


def _what_is_wanted(group: Group) -> None:
    group.add_argument(
        "--terms",
        nargs="+",
        default=[],
        metavar="TERM",
        help="of interest: bias, scale, cross_axis, K2 ..., an id, or all",
    )
    group.add_argument(
        "--nuisance",
        nargs="+",
        default=["drift"],
        metavar="TERM",
        help="fitted too, not of interest (default drift; or none)",
    )
    group.add_argument(
        "--textbook",
        metavar="KIND",
        help="linear, K2, K2K3, quadratic or cubic, in place of the product's own terms",
    )
    group.add_argument(
        "--criterion",
        default="both",
        help="tilt (or I), D, A, or both: the mean of D and tilt (default)",
    )
    group.add_argument(
        "--grade",
        choices=("precision", "mid_mems", "consumer"),
        default="mid_mems",
        help="whose plausible sizes are the prior",
    )
    group.add_argument(
        "--prior",
        type=float,
        help="one relative size for all priors instead: g, or g per power of g",
    )
    group.add_argument(
        "--range-deg",
        type=float,
        default=180.0,
        help="working range about level for the tilt error (default: everywhere)",
    )
    group.add_argument("--sensor", help="which, when several fit")


def _table_time(group: Group) -> None:
    group.add_argument(
        "--budget-s", dest="budget", type=float, default=300.0, help="s of table time (default 300)"
    )
    group.add_argument(
        "--rate-deg-s", type=float, default=20.0, help="of moves, all axes at once (default 20)"
    )
    group.add_argument("--settle-s", type=float, default=5.0, help="after each move (default 5)")
    group.add_argument(
        "--dwell-s",
        type=float,
        nargs=2,
        default=(5.0, 60.0),
        metavar=("LEAST", "MOST"),
        help="of reading (default 5 60)",
    )
    angles_option(group)
    group.add_argument(
        "--step-deg", type=float, default=0.0, help="angles are multiples of this (default: any)"
    )
    group.add_argument(
        "--floor-ug",
        type=float,
        default=20.0,
        help="what no averaging removes from a pose mean (default 20)",
    )


def _instead(group: Group) -> None:
    group.add_argument(
        "--blind-to-nothing",
        type=int,
        metavar="POSES",
        help=(
            "instead: so many poses whose least visible effect (of all that this table and sensor"
            " can have, or of --terms) is seen best; the bounds that no design can pass are printed"
            " beside it"
        ),
    )
    group.add_argument(
        "--split",
        metavar="DIAGNOSIS.json",
        help="propose the block that tells the rivals of a diagnosis apart instead",
    )
    group.add_argument(
        "--scenario",
        dest="diagnosed",
        metavar="TOML",
        help="with --split: the scenario that was diagnosed",
    )
    group.add_argument(
        "--recordings",
        nargs="+",
        default=[],
        metavar="REC",
        help="with --split: what was diagnosed (default: as the diagnosis has it)",
    )
