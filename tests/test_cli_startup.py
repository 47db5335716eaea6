"""What the start of a command loads: the help answers without numerical libraries."""

import importlib
import inspect
import subprocess
import sys

import pytest

from tiltcal.cli.commands import COMMANDS

HEAVY = {
    "gymnasium",
    "jinja2",
    "matplotlib",
    "mujoco",
    "numpy",
    "plotly",
    "pyarrow",
    "pydantic",
    "scipy",
}
PROGRAM = """
import sys
from tiltcal.cli import main
status = main({words})
print("loaded", *sorted({{name.split(".")[0] for name in sys.modules}}))
sys.exit(status)
"""


def started(*words):
    """What a command prints, and the packages that it loads."""
    program = PROGRAM.format(words=list(words))
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    said, _, loaded = done.stdout.rpartition("loaded ")
    return said, set(loaded.split())


def test_the_help_lists_every_command_and_loads_nothing_heavy():
    said, loaded = started("--help")
    listed = {words[1] for line in said.splitlines() if len(words := line.split()) > 2}
    assert set(COMMANDS) <= listed
    assert "cyclopts" in loaded
    assert not loaded & HEAVY


def test_no_command_prints_the_help():
    assert started()[0] == started("--help")[0]


def test_parsing_loads_no_terminal_library_either():
    program = "import sys, tiltcal.cli.app as a; a.make_app(); print('rich' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout == "False\n"


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_is_listed_by_the_first_sentence_of_its_own_help(name):
    module, _, function = COMMANDS[name].target.partition(":")
    run = getattr(importlib.import_module(f"tiltcal.cli.{module}"), function)
    assert inspect.getdoc(run).splitlines()[0] == COMMANDS[name].summary
