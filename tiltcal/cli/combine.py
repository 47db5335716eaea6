"""``tiltcal combine``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tiltcal.api.instruments import load_instrument
from tiltcal.calibration.combination import combine as joined
from tiltcal.cli.options import Json
from tiltcal.cli.output import paragraph, print_json, print_note, require_output


def combine(
    *calibrations: Annotated[Path, Parameter("CAL", help="Calibrations, JSON: two or more.")],
    output: Annotated[
        Path | None, Parameter(alias="-o", help="Calibration to write; none is if they disagree.")
    ] = None,
    as_json: Json = False,
) -> int:
    """Combine calibrations of one instrument: of a room and a chamber, of several days.

    Parameters that several have must agree within their uncertainty at 0.1 %;
    the joint estimate weighs them by it. Parameters that one has are added.

      tiltcal combine ROOM.json CHAMBER.json -o CAL.json

    Exit status: 0 combined; 1 common parameters disagree; 2 unusable input.
    """
    require_output("combine", output, as_json, "the combined calibration")
    found = joined([load_instrument(path) for path in calibrations])
    if not found.agrees:
        listed = ", ".join(f"{name} by {z:.3g} sigma" for name, z in found.differing.items())
        print_note(f"not combined: {found.test.statement}: no; they differ most in {listed}")
    elif output is not None:
        found.calibration.save(output)
        print_note(f"{output}: {len(found.calibration.parameters)} parameters")
    if as_json:
        print_json(
            {
                "agrees": found.agrees,
                "differing": dict(found.differing),
                "calibration": found.calibration.to_json() if found.agrees else None,
            }
        )
    elif found.agrees:
        paragraph(f"{found.test.statement} (p {found.test.p_value:.2g})")
    return 0 if found.agrees else 1
