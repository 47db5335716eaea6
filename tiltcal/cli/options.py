"""Parameters that several commands share."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter, Token

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
    Parameter(help="Allowed angles of an axis, AXIS=LOW:HIGH in deg; may be repeated."),
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
