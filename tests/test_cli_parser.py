"""The parser of the command line."""

import importlib
import inspect

from tiltcal.cli.parser import build_parser


def test_every_command_has_the_function_that_it_names():
    parser = build_parser()
    (commands,) = (a.choices for a in parser._actions if a.dest == "command")
    assert len(commands) > 15
    for name, command in commands.items():
        where = inspect.getclosurevars(command.get_default("run")).nonlocals
        module = importlib.import_module(f"tiltcal.cli.{where['module']}")
        assert callable(getattr(module, where["function"], None)), name
