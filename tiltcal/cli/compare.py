"""``tiltcal compare``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tiltcal.api.comparing import report_comparison
from tiltcal.api.instruments import load_instrument
from tiltcal.cli.options import SEVERAL, Json
from tiltcal.cli.output import paragraph, print_json, print_line, print_note
from tiltcal.validation.comparison import Range
from tiltcal.validation.comparison import compare as compared


def compare(
    *calibrations: Annotated[
        Path, Parameter("CAL", help="Calibrations (JSON) or amended.toml: two or more.")
    ],
    within: Annotated[
        tuple[str, ...],
        Parameter(
            name="--range",
            help="tilt=DEG from level, temperature=LOW:HIGH, rate=DEG_S, angle=LOW:HIGH;"
            " may be repeated.",
        ),
        SEVERAL,
    ] = (),
    output: Annotated[
        Path | None,
        Parameter(alias="-o", help="Folder for comparison.json and report.html."),
    ] = None,
    as_json: Json = False,
) -> int:
    """Compare calibrations over the working range: do they say the same?

    The same readings are corrected by each. The difference of the corrected
    tilt, norm, rate or table is shown over the range with its uncertainty.

      tiltcal compare MAY.json JUNE.json --range tilt=30 -o out

    Exit status: 0 they agree within their uncertainty at 0.1 %; 1 they differ;
    2 unusable input.
    """
    models = [load_instrument(path) for path in calibrations]
    names = [str(path) for path in calibrations]
    found = compared(models, names, Range.of(within))
    if output is not None:
        report_comparison(found, output)
        print_note(f"{output / 'report.html'}: the differences over the range")
    if as_json:
        print_json(found.to_json())
        return 0 if found.agree else 1
    for curve in found.curves:
        for k, name in enumerate(names[1:]):
            print_line(
                f"{curve.sensor} {curve.quantity}, {name} less {names[0]}:"
                f" {curve.rms[k]:.4g} {curve.unit} rms,"
                f" {abs(curve.difference[k]).max():.4g} worst,"
                f" {(curve.sigma[k] ** 2).mean() ** 0.5:.3g} expected"
            )
    paragraph(found.headline())
    return 0 if found.agree else 1
