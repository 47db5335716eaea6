"""The command line application: parses arguments and runs one command. Only the module of the
command that runs is imported.
"""

from collections.abc import Sequence
from itertools import takewhile
from pathlib import Path

from cyclopts import (
    App,
    CycloptsError,
    Group,
    MissingArgumentError,
    Parameter,
    UnknownCommandError,
    UnusedCliTokensError,
)

from tiltcal import __version__
from tiltcal.cli.commands import COMMANDS, GROUPS
from tiltcal.cli.options import finite
from tiltcal.cli.output import print_note, telling
from tiltcal.core.errors import TiltcalError, nearest
from tiltcal.core.figure_folder import FigureFolder, figures_into

ABOUT = """\
A testbed for calibrating inclinometers, accelerometers and gyroscopes.

Simulate a table and an instrument with known errors in MuJoCo. Calibrate
recordings, with uncertainties and a verdict. Verify algorithms, including
yours, against the injected errors. Find out which physics a model leaves out.

Every command takes, before or after its name, --json (machine-readable output)
and --quiet, -q (no progress and no notices on stderr). Progress is shown on a
terminal; --progress shows it in a pipe, too. Every command that writes a report
takes --figures DIR: its figures as SVG and PDF files, too.
"""
JSON, FIGURES, PROGRESS = "--json", "--figures", "--progress"
QUIET = ("--quiet", "-q")
FIRST_STEPS = """\
First steps:

  tiltcal init -o bench.toml
  tiltcal simulate bench.toml -o run.csv --truth truth.json
  tiltcal calibrate run.csv --scenario bench.toml --method norm -o CAL.json
  tiltcal correct CAL.json run.csv -o corrected.csv
  tiltcal run bench.toml
"""


def make_app() -> App:
    """The application with all commands, none of them imported yet."""
    app = App(
        name="tiltcal",
        help=ABOUT,
        help_epilogue=FIRST_STEPS,
        help_format="plaintext",
        version=f"tiltcal {__version__}",
        group_commands=Group("Options", sort_key=len(GROUPS)),
        default_parameter=Parameter(
            negative=(),
            allow_repeating=True,
            show_default=_shown,
            json_list=False,
            validator=finite,
        ),
        suppress_keyboard_interrupt=False,
    )
    order = list(COMMANDS)
    for position, (title, commands) in enumerate(GROUPS.items()):
        group = Group(title, sort_key=position)
        for name, command in commands.items():
            app.command(
                f"tiltcal.cli.{command.target}",
                name=name,
                help=command.summary,
                help_epilogue="",
                group=group,
                sort_key=order.index(name),
            )
    return app


def run(arguments: Sequence[str]) -> int:
    """Run one command and return its exit status; without a command print the help.

    Raises:
        TiltcalError: the command line is wrong.
    """
    arguments, given = _everywhere(arguments)
    quiet, progress = not given.isdisjoint(QUIET), PROGRESS in given
    arguments, folder = _with_value(arguments, FIGURES)
    folder_of_figures = None if folder is None else Path(folder)
    with telling(quiet, progress), figures_into(folder_of_figures) as figures:
        status = _run(arguments)
    if figures is not None:
        _require_figures(figures)
    return status


def _with_value(arguments: Sequence[str], option: str) -> tuple[list[str], str | None]:
    """Arguments without an option of every command, and its value; nothing after ``--`` is
    touched.

    Raises:
        TiltcalError: it has no value.
    """
    end = list(arguments).index("--") if "--" in arguments else len(arguments)
    kept: list[str] = []
    value: str | None = None
    texts = iter(arguments[:end])
    for text in texts:
        name, equals, given = text.partition("=")
        if name != option:
            kept.append(text)
            continue
        value = given if equals else next(texts, "")
        if not value or value.startswith("--"):
            raise TiltcalError(
                option, found="no folder", need="the name of one", do=f"write {option} DIR"
            )
    return [*kept, *arguments[end:]], value


def _require_figures(figures: FigureFolder) -> None:
    """Say how many figures were written.

    Raises:
        TiltcalError: none: the command wrote no report with a figure.
    """
    if not figures.written:
        raise TiltcalError(
            FIGURES,
            found="no report with a figure",
            need="a command that writes one",
            do="add its report, such as -o DIR or --report FILE, or leave the option out",
        )
    print_note(f"{figures.path}: {len(figures.written)} files of figures")


def _everywhere(arguments: Sequence[str]) -> tuple[list[str], set[str]]:
    """Arguments with ``--json`` behind the command, without ``--quiet`` and ``--progress``, and
    which of these stood there. Nothing after ``--`` is touched.
    """
    end = list(arguments).index("--") if "--" in arguments else len(arguments)
    texts = [argument for argument in arguments[:end] if argument not in (*QUIET, PROGRESS)]
    before = list(takewhile(lambda argument: argument == JSON, texts))
    texts = [*texts[len(before) : len(before) + 1], *before, *texts[len(before) + 1 :]]
    return [*texts, *arguments[end:]], {*QUIET, PROGRESS} & {*arguments[:end]}


def _run(arguments: Sequence[str]) -> int:
    app = make_app()
    name = arguments[0] if arguments else ""
    if name in COMMANDS:
        app[name].help = None  # show the whole docstring, not only the summary
    try:
        status = app(
            arguments, exit_on_error=False, print_error=False, result_action="return_value"
        )
    except CycloptsError as error:
        raise _refusal(error, name, arguments) from error
    return int(status or 0)


def _refusal(error: CycloptsError, name: str, arguments: Sequence[str]) -> TiltcalError:
    if isinstance(error, UnknownCommandError):
        return TiltcalError(
            "command line of `tiltcal`",
            found=f"the unknown command '{name}'",
            need="one of the commands that `tiltcal --help` lists",
            do=nearest(name, list(COMMANDS)),
        )
    program = f"tiltcal {name}".strip()
    return TiltcalError(
        f"command line of `{program}`",
        found=_found(error, arguments),
        need="the arguments its help lists",
        do=f"see `{program} --help`",
    )


def _found(error: CycloptsError, arguments: Sequence[str]) -> str:
    if isinstance(error, MissingArgumentError) and error.argument is not None:
        if error.keyword is not None:
            return f"too few values for {error.keyword}"
        return "no " + ", ".join(_missing(error, arguments))
    if isinstance(error, UnusedCliTokensError):
        return "arguments that are not used: " + " ".join(error.unused_tokens or ())
    text = str(error).strip().rstrip(".")
    return text[:1].lower() + text[1:]


def _missing(error: MissingArgumentError, arguments: Sequence[str]) -> list[str]:
    """The missing argument that the error names, and all required options that are missing."""
    given = {argument.partition("=")[0] for argument in arguments}
    collection = error.app.assemble_argument_collection() if error.app else ()
    required = [a for a in collection if a.required and a.name.startswith("--")]
    options = [a.name for a in required if not given & set(a.names)]
    first = error.argument.name if error.argument else ""
    return [first, *(name for name in options if name != first)]


def _shown(default: object) -> str | None:
    """A default as the help shows it; one that only means "not given" is left out."""
    if default is None or default is False or default == ():
        return None
    if isinstance(default, tuple):
        return " ".join(f"{item:g}" if isinstance(item, float) else str(item) for item in default)
    return f"{default:g}" if isinstance(default, float) else str(default)
