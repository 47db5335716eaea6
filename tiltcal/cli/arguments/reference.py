"""methods, effects, confuse, explain-frames: what is there to know."""

from tiltcal.cli.arguments.commands import Commands


def add(commands: Commands) -> None:
    """Add them to the parser."""
    _methods(commands)
    _effects(commands)
    _confuse(commands)
    _explain_frames(commands)


def _methods(commands: Commands) -> None:
    commands.add("methods", "reference", "methods", "list the calibration methods")


def _effects(commands: Commands) -> None:
    sub = commands.add(
        "effects",
        "reference",
        "effects",
        "list the physical effects, or explain one",
        "  tiltcal effects             all\n  tiltcal effects acc_K2      one, with its equation,"
        " look and parameters",
    )
    sub.add_argument("word", nargs="?", metavar="ID", help="an id, or a word to search for")


def _confuse(commands: Commands) -> None:
    sub = commands.add(
        "confuse",
        "confuse",
        "confuse_",
        "what a scenario's recording can and cannot tell apart",
        "For every effect of the catalogue: the share that the adjustable terms absorb, the size it"
        " would be found at,\nthe share that nothing else explains, and what it cannot be told"
        " from, with what to record to split them.",
    )
    sub.add_argument("scenario", metavar="SCENARIO")
    sub.add_argument(
        "--grade",
        choices=("precision", "mid_mems", "consumer"),
        default="mid_mems",
        help="whose plausible sizes",
    )


def _explain_frames(commands: Commands) -> None:
    sub = commands.add(
        "explain-frames",
        "confuse",
        "explain_frames",
        "what each channel should read at the six faces and small turns",
        "The first thing to compare with a real set-up.",
    )
    sub.add_argument("scenario", metavar="SCENARIO")
