"""C headers: placing-angle tables with look-ups and the corrector, in floating point and in
integers; bias, scale, axes and their temperature.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np

from tiltcal import __version__
from tiltcal.calibration.bias_table import PASSES, STEEP, BiasTable, PlacingCorrector
from tiltcal.calibration.linear_export import TEMPLATE as LINEAR
from tiltcal.calibration.linear_export import linear_numbers
from tiltcal.calibration.result import Calibration
from tiltcal.core.errors import TiltcalError
from tiltcal.core.plain_text import plain
from tiltcal.core.units import DEG
from tiltcal.setup.setup import Setup

TEMPLATE = Path(__file__).parent / "table.h.jinja"
WIDEST = 170.0  # deg, of a table that integers can be searched by their cross product


def header(calibration: Calibration, setup: Setup, name: str = "tiltcal") -> str:
    """The text of a C header that corrects what ``tiltcal correct`` corrects.

    Args:
        calibration: with placing-angle tables of one sensor, or with bias, scale and axes of
            triads, over temperature too.
        setup: it was made with.
        name: what every C name begins with.

    Raises:
        TiltcalError: tables that differ in their angles, a smooth look-up, terms that C does not
            have, or a name that is no C name.

    Errors:
        Integers: 1 um/s2 (0.02 arcsec) of rounding; float: some 1e-6 m/s2.
    """
    from jinja2 import Environment, StrictUndefined

    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        raise TiltcalError(
            f"name '{name}'",
            found="no C name",
            need="letters, digits and _, a letter first",
            do="choose another",
        )
    text = Environment(
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    source = in_comment(str(calibration.provenance.get("recording", "a calibration")))
    if not calibration.bias_tables:
        linear = text.from_string(LINEAR.read_text(encoding="utf-8"))
        return linear.render(
            version=__version__,
            source=source,
            verdict=calibration.verdict,
            p=name,
            P=name.upper(),
            **linear_numbers(calibration, setup),
        )
    corrector = _corrector(calibration, setup)
    table = text.from_string(TEMPLATE.read_text(encoding="utf-8"))
    return table.render(
        title=f"{name}: placing-angle bias tables",
        version=__version__,
        source=source,
        verdict=calibration.verdict,
        p=name,
        P=name.upper(),
        passes=PASSES,
        **_numbers(corrector, name),
    )


def in_comment(text: str) -> str:
    """A text from a file, on one line and without what ends or begins a comment in C."""
    line = plain(" ".join(text.split()))
    return line.replace("*/", "* /").replace("/*", "/ *")


def _corrector(calibration: Calibration, setup: Setup) -> PlacingCorrector:
    found = [
        c
        for n in calibration.sensors()
        if (c := calibration.placing(setup.named(n), setup.site.gravity, "interpolated"))
    ]
    if len(found) != 1:
        raise TiltcalError(
            f"calibration by {calibration.method}",
            found=f"placing-angle tables of {len(found)} sensors",
            need="those of one",
            do="make it with `tiltcal calibrate --method placing_table`",
        )
    if calibration.lookup == "smooth":
        raise TiltcalError(
            f"calibration by {calibration.method}",
            found="look-up smooth",
            need="interpolated or rounded: what firmware looks up",
            do="calibrate again with --option lookup=interpolated",
        )
    found[0].lookup = calibration.lookup
    grids = {
        (round(t.start / DEG, 6), round(t.step / DEG, 6), len(t.values))
        for t in found[0].tables.values()
    }
    if len(grids) > 1:
        raise TiltcalError(
            f"calibration by {calibration.method}",
            found="tables of x and y at different angles",
            need="one 2-D array",
            do="sweep both axes over the same angles",
        )
    return found[0]


def _numbers(corrector: PlacingCorrector, name: str) -> dict[str, Any]:
    table = next(iter(corrector.tables.values()))
    count, g = len(table.values), corrector.gravity
    zero = BiasTable(table.start, table.step, np.zeros(count), np.zeros(count))
    rows = [corrector.tables.get(axis, zero).values for axis in "xy"]
    start_deg, end_deg = table.range_deg
    start_mdeg, step_mdeg = start_deg * 1e3, table.step / DEG * 1e3
    if abs(step_mdeg - round(step_mdeg)) > 1e-6 or abs(start_mdeg - round(start_mdeg)) > 1e-6:
        raise TiltcalError(
            "placing-angle table",
            found=f"a step of {step_mdeg:g} mdeg",
            need="whole millidegrees",
            do="sweep again",
        )
    return {
        "count": count,
        "start": repr(float(table.start)),
        "per": repr(float(1 / table.step)),
        "gravity": repr(g),
        "per_gravity": repr(1 / g),
        "share_shift": int(g * 1e6 * np.sin(table.step) * 2**30).bit_length() - 15,
        "lookup": corrector.lookup,
        "start_deg": f"{start_deg:.6g}",
        "end_deg": f"{end_deg:.6g}",
        "step_deg": f"{table.step / DEG:.6g}",
        "start_mdeg": round(start_mdeg),
        "step_mdeg": round(step_mdeg),
        "steep": repr((STEEP * g) ** 2),
        "steep_um": int((STEEP * g * 1e6) ** 2),
        "gravity_um": round(g * 1e6),
        "held": [int(a in corrector.tables) for a in "xy"],
        "bias": [[repr(float(v)) for v in row] for row in rows],
        "bias_um": [[round(float(v) * 1e6) for v in row] for row in rows],
        "polynomial": _arctangent(),
        "root_bits": 2 * (round(g * 1e6).bit_length() - 13),
        "directions": _directions(table) if end_deg - start_deg < WIDEST else [],
        "rounded_condition": "1"
        if corrector.lookup == "rounded"
        else f"defined({name.upper()}_ROUNDED)",
    }


def _arctangent(terms: int = 8) -> str:
    """atan(q) / q on [0, 1] as a polynomial of w = q^2 in Horner's form, by Chebyshev
    interpolation.
    """
    series = np.polynomial.chebyshev.Chebyshev.interpolate(
        lambda w: np.arctan(np.sqrt(w)) / np.sqrt(w), terms - 1, domain=[0, 1]
    )
    text = ""
    for c in reversed(series.convert(kind=np.polynomial.Polynomial).coef):
        text = f"{c:.9g}f + w * ({text})" if text else f"{c:.9g}f"
    return text


def _directions(table: BiasTable) -> list[tuple[int, int]]:
    count = len(table.values)
    angles = table.start + table.step * np.array([-0.5, *range(count), count - 0.5])
    return [(round(float(np.cos(a)) * 2**30), round(float(np.sin(a)) * 2**30)) for a in angles]
