"""What all commands of the command line share."""

import argparse
import importlib
from collections.abc import Callable
from typing import Any


def lazily(module: str, function: str) -> Callable[[argparse.Namespace], int]:
    """A command whose module is imported only when it runs."""

    def run(args: argparse.Namespace) -> int:
        return int(getattr(importlib.import_module(f"tiltcal.cli.{module}"), function)(args))

    return run


class Commands:
    """Adds commands to the parser, all alike."""

    def __init__(self, parser: argparse.ArgumentParser) -> None:
        self.group = parser.add_subparsers(dest="command", metavar="COMMAND", title="commands")

    def add(
        self, name: str, module: str, function: str, help: str, more: str = ""
    ) -> argparse.ArgumentParser:
        """A command that runs ``function`` of ``tiltcal.cli.module``; every one has ``--json``."""
        sub = self.group.add_parser(
            name,
            help=help,
            description=help[0].upper() + help[1:] + ".",
            epilog=more,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        sub.add_argument("--json", action="store_true", help="machine-readable output on stdout")
        sub.set_defaults(run=lazily(module, function))
        return sub


def scenario_option(sub: argparse.ArgumentParser, required: bool = True) -> None:
    """The scenario that describes a recording."""
    sub.add_argument(
        "--scenario",
        required=required,
        metavar="TOML",
        help="site, rig and sensors of the recording",
    )


def output_option(
    sub: argparse.ArgumentParser, help: str, metavar: str = "FILE", **more: Any
) -> None:
    """Where the result goes."""
    sub.add_argument("-o", "--output", metavar=metavar, help=help, **more)


def segments_option(sub: argparse.ArgumentParser) -> None:
    """Dwells in place of those that would be found."""
    sub.add_argument(
        "--segments", metavar="SEG.csv", help="dwells as `tiltcal segments` writes them, edited"
    )


def angles_option(sub: argparse._ActionsContainer) -> None:
    """Where the axes may go."""
    sub.add_argument(
        "--angles",
        action="append",
        default=[],
        metavar="AXIS=LOW:HIGH",
        help="allowed angles of an axis, deg; may be repeated",
    )
