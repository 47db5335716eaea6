"""diagnose, investigate, lab: what physics was left out."""

import argparse

from tiltcal.cli.arguments.commands import Commands, angles_option, output_option, scenario_option


def add(commands: Commands) -> None:
    """Add them to the parser."""
    _diagnose(commands)
    _investigate(commands)
    _lab(commands)


def _diagnose(commands: Commands) -> None:
    sub = commands.add(
        "diagnose",
        "diagnosing",
        "diagnose",
        "what physics was left out: locate the mismatch, name it, model it",
        "Writes diagnosis.json, amended.toml and report.html under -o DIR. Several recordings of"
        " one set-up are explained\ntogether. Faults of the data (time going back, repeats, frozen"
        " channels) are findings.\n\n  tiltcal diagnose run.csv --scenario bench.toml -o out\n "
        " tiltcal diagnose run.csv --scenario out/amended.toml --check        exit status 1 unless"
        " it matches",
    )
    sub.add_argument("recording", nargs="+", metavar="REC")
    scenario_option(sub)
    sub.add_argument("--static", metavar="REC", help="a record at rest to take the noise from")
    sub.add_argument("--check", action="store_true", help="exit status 1 on anything but match")
    output_option(sub, "folder for the answer", "DIR")


def _investigate(commands: Commands) -> None:
    sub = commands.add(
        "investigate",
        "investigating",
        "investigate_",
        "diagnose, record what splits the rivals, diagnose again, until explained",
        "LAB is called as `LAB SEQUENCE.csv RECORDING.csv`, without a shell; a real table, or a"
        " simulated one, may be behind it.\nEverything is kept under -o DIR: log.md,"
        " investigation.json, sequences, recordings, diagnoses.\n\n  tiltcal investigate first.csv"
        " --scenario bench.toml --lab './record --table 2' -o out\n  tiltcal investigate --scenario"
        " bench.toml --lab 'tiltcal lab concealed.toml' -o out\n\nexit status: 0 explained; 1 not"
        " explained within the budget, or out of this table's reach; 2 unusable input",
    )
    sub.add_argument(
        "recording",
        nargs="*",
        metavar="REC",
        help="recorded so far; without any the scenario's sequence comes first",
    )
    scenario_option(sub)
    sub.add_argument("--lab", required=True, metavar="COMMAND", help="who records")
    sub.add_argument("--blocks", type=int, default=2, help="designed blocks at most (default 2)")
    sub.add_argument(
        "--budget-min",
        type=float,
        default=10.0,
        help="minutes of table time for all of them (default 10)",
    )
    sub.add_argument(
        "--resume",
        action="store_true",
        help="go on where the folder stands; nothing is recorded twice",
    )
    _block_limits(sub)
    output_option(
        sub, "folder for everything (default: investigation)", "DIR", default="investigation"
    )


def _lab(commands: Commands) -> None:
    sub = commands.add(
        "lab",
        "investigating",
        "lab",
        "a simulated laboratory: record a sequence file with a scenario's effects, through MuJoCo",
        "Events of the scenario (steps, slips) lie behind it; the seed follows from the sequence"
        " and the scenario's own.",
    )
    sub.add_argument("scenario", metavar="SCENARIO", help="with what is concealed")
    sub.add_argument("sequence", metavar="SEQUENCE.csv")
    sub.add_argument("recording", metavar="RECORDING.csv")
    sub.add_argument("--seed", type=int, help="in place of the scenario's")


def _block_limits(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "--block-min",
        type=float,
        default=3.0,
        help="minutes of table time of one block at most (default 3)",
    )
    sub.add_argument(
        "--rate-deg-s",
        type=float,
        default=30.0,
        help="of moves; turns go up to twice of it (default 30)",
    )
    sub.add_argument("--dwell-s", type=float, default=3.0, help="at each pose (default 3)")
    angles_option(sub)
