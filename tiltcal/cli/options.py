"""Parameters that several commands share."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Group, Parameter, Token

from tiltcal.core.budget import allow

Grade = Literal["precision", "mid_mems", "consumer"]
Json = Annotated[bool, Parameter("--json", help="Print machine-readable output on stdout.")]
ScenarioFile = Annotated[Path, Parameter("SCENARIO", help="Scenario file.")]
DescribedBy = Annotated[
    Path, Parameter(help="Scenario with the site, rig and sensors of the recording.")
]
SegmentsFile = Annotated[
    Path | None, Parameter(help="Edited list of dwells, as `tiltcal segments` writes it.")
]
AxisLimits = Annotated[
    tuple[str, ...],
    Parameter(help="Allowed range of an axis, AXIS=LOW:HIGH in deg (slides: mm); may be repeated."),
]
StartAngles = Annotated[
    tuple[str, ...],
    Parameter(
        "--from",
        help="Where an axis stands before the first move, AXIS=ANGLE in deg (slides: mm); may be"
        " repeated.",
    ),
]
SEVERAL = Parameter(consume_multiple=(1, None))
"""An option with one or more values, separated by spaces."""


def _whole_number(_: Any, tokens: Sequence[Token]) -> int:
    text = tokens[0].value
    try:
        return int(text)
    except ValueError as error:
        raise ValueError(f"'{text}' is not a whole number") from error


WHOLE = Parameter(converter=_whole_number)
"""An option with an integer value: 1.5 is refused, not rounded."""


@dataclass(frozen=True)
class Allowed:
    """More than the default budget of one command."""

    allow_rows: Annotated[
        float | None, Parameter(help="Most rows of a recording; 1e8 by default.")
    ] = None
    allow_memory: Annotated[
        float | None, Parameter(help="Most memory of the work, MiB; 2048 by default.")
    ] = None
    allow_hours: Annotated[
        float | None, Parameter(help="Longest estimated computing time, h; 240 by default.")
    ] = None

    def apply(self) -> None:
        """Allow it to this process and those it starts."""
        allow(self.allow_rows, self.allow_memory, self.allow_hours)


MoreBudget = Annotated[Allowed, Parameter(name="*", group=Group("Budget", sort_key=2))]
DEFAULT_BUDGET = Allowed()


def _seed(kind: Any, tokens: Sequence[Token]) -> int:
    number = _whole_number(kind, tokens)
    if number < 0:
        raise ValueError(f"{number} is below 0")
    return number


SEED = Parameter(converter=_seed)
"""An option with a whole number from 0 on."""


def finite(_: Any, value: Any) -> None:
    """Refuse numbers that are not finite, wherever a command takes a number."""
    for number in value if isinstance(value, tuple) else (value,):
        if isinstance(number, float) and not abs(number) <= LARGEST:
            raise ValueError(f"{number:g} is no number of at most {LARGEST:g}")


def between(low: float, high: float, or_zero: bool = False) -> Callable[[Any, Any], None]:
    """A validator of an option: a number within bounds, both included."""

    def check(_: Any, number: float | None) -> None:
        if number is not None and not (low <= number <= high or (or_zero and number == 0)):
            zero = "0, or " if or_zero else ""
            raise ValueError(f"{number:g} is not {zero}from {low:g} to {high:g}")

    return check


LARGEST = 1e30  # of a number on the command line: its powers are still numbers
AllowCommands = Annotated[
    bool,
    Parameter("--allow-commands", help="Permit scenarios to run external programs as methods."),
]
Jobs = Annotated[
    int, WHOLE, Parameter(alias="-j", help="Processes at the same time; the result is the same.")
]
EngineName = Annotated[
    str, Parameter(help="processes, dask (workers on this machine) or dask://HOST:PORT.")
]
