"""The text of a C99 header that corrects what ``tiltcal correct`` corrects.

Placing-angle tables with look-ups and the corrector, in floating point and in integers.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np

from tiltcal import __version__
from tiltcal.calibration.correction import temperature_terms
from tiltcal.calibration.firmware.fixed_functions import ARCTANGENT, RATE_PLACES, SINE, decay
from tiltcal.calibration.firmware.fixed_model import (
    STEEPEST,
    FixedSensor,
    fixed_sensor,
    range_of,
    stated,
)
from tiltcal.calibration.firmware.fixed_point import FixedMatrix, decimals, integers
from tiltcal.calibration.firmware.fixed_temperature import (
    FixedTemperature,
    fixed_temperature,
    temperature_range,
)
from tiltcal.calibration.firmware.log_units import LogUnit, log_unit, with_recorded_units
from tiltcal.calibration.firmware.model_export import float_numbers, sensor_models
from tiltcal.calibration.result import Calibration
from tiltcal.core.errors import TiltcalError
from tiltcal.core.safe_text import plain
from tiltcal.core.units import DEG
from tiltcal.instrument.placing import PASSES, STEEP, BiasTable, PlacingCorrector
from tiltcal.recordings.recording import Recording
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup

FOLDER = Path(__file__).parent


def header(
    calibration: Calibration,
    setup: Setup,
    name: str = "tiltcal",
    log: Recording | None = None,
    *,
    integers: bool = True,
) -> str:
    """The text of a C header.

    Args:
        calibration: with placing-angle tables of one sensor, or with terms that depend on one
            reading and the temperature.
        setup: it was made with.
        name: what every C name begins with.
        log: recording whose units are used. If not given they are those of the columns that the
            calibration was made from, or what the set-up states where it does not name them.
        integers: whether it corrects in integers as well.

    Raises:
        TiltcalError: tables that differ in their angles, a smooth look-up, terms that C does not
            have, a range over which integers have no bound or a reading stands for several inputs,
            or a name that is no C name.
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
    else:
        template = "model.h.jinja"
        numbers = model_numbers(calibration, setup, name, log, integers)
    return text.get_template(template).render(
        version=__version__,
        source=in_comment(str(calibration.provenance.get("recording", "a calibration"))),
        verdict=calibration.verdict,
        p=name,
        P=name.upper(),
        **numbers,
    )


def model_numbers(
    calibration: Calibration,
    setup: Setup,
    name: str,
    log: Recording | None = None,
    in_integers: bool = True,
) -> dict[str, Any]:
    """What the template of models needs.

    Raises:
        TiltcalError: see ``sensor_models`` and ``fixed_sensor``.
    """
    models, terms = sensor_models(calibration, setup, log), temperature_terms(calibration, setup)
    found = float_numbers(models, terms, name) | {"fixed": []}
    if not in_integers:
        return found
    fixed, heat = fixed_sensors(calibration, setup, name, log)
    used = set[str]().union(*(s.used for s in fixed), {"gain"} if heat else set())
    return found | {
        "fixed": [stated(s) for s in fixed],
        "used": used,
        "sine": SINE.coefficients,
        "arctangent": ARCTANGENT.coefficients,
        "decay": decay(),
        "rate_places": RATE_PLACES,
        "heat": None if heat is None else heat.numbers,
    }


def fixed_sensors(
    calibration: Calibration, setup: Setup, name: str = "tiltcal", log: Recording | None = None
) -> tuple[list[FixedSensor], FixedTemperature | None]:
    """All sensors of a calibration in integers, and the temperature where it has one.

    Args:
        calibration, setup, name, log: see ``header``.

    Raises:
        TiltcalError: see ``sensor_models`` and ``fixed_sensor``.
    """
    terms = temperature_terms(calibration, setup)
    heat = None if terms is None else fixed_temperature(terms, *temperature_range(calibration))
    models = sensor_models(calibration, setup, log)
    return [fixed_sensor(m, heat, name) for m in models], heat


def in_comment(text: str) -> str:
    """A text from a file, on one line and without what ends or begins a comment in C."""
    line = plain(" ".join(text.split()))
    return line.replace("*/", "* /").replace("/*", "/ *")


WIDEST = 170.0  # deg, of a table that integers can be searched by their cross product
SHARE_BITS = 14  # of the share of a step, and of the sines at 1 g that it is the quotient of
ROOT_UM = 2048  # um/s2: half the last of the leading digits of a root; see the template


def placing_numbers(
    calibration: Calibration, setup: Setup, name: str, log: Recording | None = None
) -> dict[str, Any]:
    """What the template of placing-angle tables needs.

    Errors:
        Integers: see ``worst_um``; float: some 1e-6 m/s2.

    Raises:
        TiltcalError: tables that differ in their angles, or a smooth look-up.
    """
    sensor, corrector = _corrector(calibration, setup)
    return {
        "title": f"{name}: placing-angle bias tables",
        "passes": PASSES,
        **_numbers(corrector, name),
        **_in_log_units(sensor, log_unit(sensor, log), corrector),
    }


def worst_um(corrector: PlacingCorrector, of_reading: float, channels: int) -> float:
    """Bound of the error of a corrected reading in integers, um/s2, by interpolation: with two
    channels up to an inclination of ``STEEPEST``, with three wherever the tables hold.

    Args:
        corrector: with the tables.
        of_reading: error of a reading, um/s2.
        channels: of the sensor.
    """
    g, tables = corrector.gravity * 1e6, corrector.tables.values()
    most = max(float(np.abs(t.values).max()) for t in tables) * 1e6
    change = max(float(np.abs(np.diff(t.values)).max()) for t in tables) * 1e6
    step = next(iter(tables)).step
    along = 0.0  # error of the third component per error of the others, beyond its own rounding
    across, root = STEEP * g, of_reading
    if channels == 2:
        # of the reading, where that of the corrected one is what the steepest inclination leaves
        across = np.sqrt((g * np.cos(STEEPEST)) ** 2 - 2 * np.sqrt(2) * g * most)
        root = ROOT_UM**2 / (2 * across) + 1
        along = np.sqrt(2) * g / across
    part = np.linspace(0, 1, 1001)
    sines = np.sin(part * step), np.sin((1 - part) * step)
    bent = float(np.abs(sines[0] / (sines[0] + sines[1]) - part).max())
    # both sines are cut off, and their quotient
    share = bent + 2 * g / (across * 2.0**SHARE_BITS) + 2.0**-SHARE_BITS
    error = of_reading
    for _ in range(PASSES):
        turned = (error * (1 + along) + root) / across
        # entries and their weighted mean are rounded
        error = of_reading + change * (share + turned / step) + 1.0
    return error


def _in_log_units(sensor: Sensor, unit: LogUnit, corrector: PlacingCorrector) -> dict[str, Any]:
    """What turns readings of the log into m/s2 or um/s2, and the result back."""
    readings = range_of(sensor, unit)
    um = np.array([[unit.factor * 1e6]])
    farthest = readings.limit + float(np.abs(unit.zero).max())
    inward = FixedMatrix.of(um, np.zeros(1), np.array([farthest]), [readings.places])
    largest = np.array(
        [float(um[0, 0]) * readings.limit + float(np.abs(unit.zero).max() * um[0, 0])]
    )
    outward = FixedMatrix.of(np.array([[1e-6 / unit.corrected_factor]]), np.zeros(1), largest, [0])
    places = {axis: sensor.axes.index(axis) for axis in "xyz" if axis in sensor.axes}
    shift = inward.shift + inward.places
    worst = worst_um(corrector, inward.error + 0.5, len(sensor.axes))
    return {
        "sensor": sensor.name,
        "axes": sensor.axes,
        "at": [places["x"], places["y"], places.get("z", -1)],
        "unit": unit.written,
        "corrected_unit": unit.corrected,
        "factor": repr(unit.factor),
        "per_corrected": repr(1 / unit.corrected_factor),
        "zero": [repr(float(z)) for z in unit.zero],
        "in": {"factor": inward.matrix[0][0], "shift": shift, "places": readings.places}
        | {"zero": [integers(-z * um[0], shift)[0] for z in unit.zero]}
        | {"limit": f"{readings.limit:.6g}", "whole": readings.whole},
        "out": {"factor": outward.matrix[0][0], "shift": outward.shift, "places": outward.places},
        "error": decimals(worst * 1e-6 / unit.corrected_factor + outward.error),
        "slanted": len(sensor.axes) == 2,
    }


def _corrector(calibration: Calibration, setup: Setup) -> tuple[Sensor, PlacingCorrector]:
    found = [
        (setup.named(n), c)
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
    ((sensor, corrector),) = found
    corrector.lookup = calibration.lookup
    grids = {
        (round(t.start / DEG, 6), round(t.step / DEG, 6), len(t.values))
        for t in corrector.tables.values()
    }
    if len(grids) > 1:
        raise TiltcalError(
            f"calibration by {calibration.method}",
            found="tables of x and y at different angles",
            need="one 2-D array",
            do="sweep both axes over the same angles",
        )
    return sensor, corrector


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
        "root_um": ROOT_UM,
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
