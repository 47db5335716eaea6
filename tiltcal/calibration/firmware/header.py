"""The text of a C99 header that corrects what ``tiltcal correct`` corrects."""

import re
from pathlib import Path
from typing import Any

from tiltcal import __version__
from tiltcal.calibration.firmware.fixed_linear import fixed_sensors, stated
from tiltcal.calibration.firmware.fixed_point import UNIT_PLACES
from tiltcal.calibration.firmware.fixed_temperature import (
    HYSTERESIS_PLACES,
    MEMORY_PLACES,
    RATE_PLACES,
    STATE_PLACES,
)
from tiltcal.calibration.firmware.inclinometer_export import inclinometer_numbers
from tiltcal.calibration.firmware.linear_export import float_numbers
from tiltcal.calibration.firmware.linear_terms import LinearTerms, linear_terms
from tiltcal.calibration.firmware.log_units import with_recorded_units
from tiltcal.calibration.firmware.placing_export import placing_numbers
from tiltcal.calibration.result import Calibration
from tiltcal.core.errors import TiltcalError
from tiltcal.core.safe_text import plain
from tiltcal.recordings.recording import Recording
from tiltcal.setup.setup import Setup

FOLDER = Path(__file__).parent


def header(
    calibration: Calibration, setup: Setup, name: str = "tiltcal", log: Recording | None = None
) -> str:
    """The text of a C header.

    Args:
        calibration: with placing-angle tables of one sensor, with bias, scale and axes of
            inclinometers, or with those of other sensors, over temperature too.
        setup: it was made with.
        name: what every C name begins with.
        log: recording whose units are used. If not given they are those of the columns that the
            calibration was made from, or what the set-up states where it does not name them.

    Raises:
        TiltcalError: tables that differ in their angles, a smooth look-up, terms that C does not
            have, or a name that is no C name.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        raise TiltcalError(
            f"name '{name}'",
            found="no C name",
            need="letters, digits and _, a letter first",
            do="choose another",
        )
    text = Environment(
        loader=FileSystemLoader(FOLDER),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    setup = with_recorded_units(setup, calibration)
    if calibration.bias_tables:
        template, numbers = "table.h.jinja", placing_numbers(calibration, setup, name, log)
    elif any(setup.named(n).kind == "inclinometer" for n in calibration.sensors()):
        template = "inclinometer.h.jinja"
        numbers = inclinometer_numbers(calibration, setup, log)
    else:
        template, numbers = "linear.h.jinja", _linear_numbers(linear_terms(calibration, setup, log))
    return text.get_template(template).render(
        version=__version__,
        source=in_comment(str(calibration.provenance.get("recording", "a calibration"))),
        verdict=calibration.verdict,
        p=name,
        P=name.upper(),
        **numbers,
    )


def _linear_numbers(terms: LinearTerms) -> dict[str, Any]:
    """What the template of linear terms needs."""
    fixed, heat = fixed_sensors(terms)
    found = float_numbers(terms) | {"fixed": [stated(s) for s in fixed]}
    if heat is None or terms.memory is None:
        return found
    lag = terms.memory.kind != "hysteresis"
    return found | {
        "heat": heat.numbers,
        "rate_places": RATE_PLACES,
        "state_places": STATE_PLACES,
        "unit_places": UNIT_PLACES,
        "memory_places": MEMORY_PLACES,
        "memory_state_places": STATE_PLACES if lag else HYSTERESIS_PLACES,
    }


def in_comment(text: str) -> str:
    """A text from a file, on one line and without what ends or begins a comment in C."""
    line = plain(" ".join(text.split()))
    return line.replace("*/", "* /").replace("/*", "/ *")
