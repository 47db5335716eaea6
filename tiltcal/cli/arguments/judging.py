"""run, verify, prove, demo: how good methods and the diagnosis are."""

import argparse

from tiltcal.cli.arguments.commands import Commands, output_option


def add(commands: Commands) -> None:
    """Add them to the parser."""
    _run(commands)
    _verify(commands)
    _prove(commands)
    _demo(commands)


def _run(commands: Commands) -> None:
    sub = commands.add(
        "run",
        "judging",
        "run",
        "simulate, calibrate and judge scenarios",
        "A scenario with [[method]] tables says which methods have to reach what.\n\n"
        "  tiltcal run bench.toml -o out        writes out/report.html and out/junit.xml as well",
    )
    sub.add_argument("scenario", nargs="+", metavar="SCENARIO")
    _judging_options(sub)


def _verify(commands: Commands) -> None:
    sub = commands.add(
        "verify",
        "judging",
        "verify",
        "run a folder of scenarios; JUnit XML, HTML report, exit status for CI",
        "  tiltcal verify scenarios -o out\n  tiltcal verify                     the built-in"
        " scenarios",
    )
    sub.add_argument("folder", nargs="?", metavar="DIR", help="the built-in scenarios unless given")
    _judging_options(sub)


def _prove(commands: Commands) -> None:
    sub = commands.add(
        "prove",
        "proving",
        "prove",
        "blind trials of `diagnose`: how often it is right, with intervals",
        "A generator of its own (closed form, none of this program's code) conceals physics in"
        " recordings of seven kinds of\nset-up. The diagnosis gets copies of recording and"
        " scenario; the truth is written once its answer is in.\nNeeds a source checkout. Finished"
        " trials in DIR are not run again. Exit status 1: a figure is out of reach of chance.\n\n "
        " tiltcal prove --n 30 -j 4 -o proof             30 trials of each type\n  tiltcal prove"
        " --n 100 --types null unlisted --kinds dual_tumble three_rates",
    )
    sub.add_argument("--n", type=int, default=5, help="trials of each type (default 5)")
    sub.add_argument("--kinds", nargs="+", metavar="KIND", help="of set-ups (default: all seven)")
    sub.add_argument(
        "--types",
        nargs="+",
        metavar="TYPE",
        help="null single odd data pair unlisted impossible (default: all)",
    )
    sub.add_argument("--seed", type=int, default=0, help="other trials (default 0)")
    sub.add_argument("-j", "--jobs", type=int, default=1, help="at once (default 1)")
    sub.add_argument(
        "--trials",
        metavar="TESTS",
        help="folder that holds blind/ (default: tests of this checkout)",
    )
    output_option(sub, "folder for cases, answers and truth (a temporary one unless given)", "DIR")


def _demo(commands: Commands) -> None:
    sub = commands.add(
        "demo",
        "demo",
        "demo",
        "a tour: simulate, calibrate, verify; then conceal an effect and diagnose it",
        "The concealed effect is drawn at random; the seed is printed, --seed repeats it.",
    )
    sub.add_argument("--seed", type=int, help="what is concealed (drawn at random unless given)")
    output_option(sub, "folder for the report (default: demo-output)", "DIR", default="demo-output")


def _judging_options(sub: argparse.ArgumentParser) -> None:
    output_option(sub, "folder for report.html and junit.xml", "DIR")
    sub.add_argument(
        "--allow-commands", action="store_true", help="let scenarios run programs as methods"
    )
