"""Sources of uncertainty: the usual ones of a laboratory, and what one standard uncertainty of each
changes in the recording or the set-up.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tiltcal.calibration.result import Calibration
from tiltcal.core.errors import TiltcalError, nearest
from tiltcal.core.units import PARAMETER_UNITS, split_unit
from tiltcal.effects import make_effect
from tiltcal.effects.base import Effect
from tiltcal.effects.sensor.gyro import transverse
from tiltcal.effects.table.geometry import AxisWobble, TableLevelling
from tiltcal.effects.table.readout import EncoderZero, IndexError_
from tiltcal.laboratory.scenario_tables import SourceTable
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment
from tiltcal.setup.setup import Setup
from tiltcal.validation.perturbed_recordings import with_effect, with_gravity_error

SETUP_SOURCES = ("latitude", "heading", "fog_axis")
DIVISOR = {"normal": 1.0, "rectangular": np.sqrt(3), "expanded": 2.0}
Shift = Callable[[float, Recording, Setup], tuple[Recording, Setup]]
"""What a source does: (standard uncertainties, recording, set-up) -> both, changed."""


@dataclass(frozen=True)
class Source:
    """One line of the budget.

    Args:
        name: in words.
        size: as stated, in ``unit``, with its distribution.
        standard: standard uncertainty, in ``unit``.
        shifts: one, or one a stop for errors that are drawn at each stop.
    """

    name: str
    size: float
    unit: str
    distribution: str
    shifts: tuple[Shift, ...]

    @property
    def standard(self) -> float:
        """Standard uncertainty, in ``unit``."""
        return float(self.size / DIVISOR[self.distribution])


def usual_sources(setup: Setup, found: Calibration) -> list[SourceTable]:
    """The usual sources: a table of 3 arcsec, gravity to 10 ppm, heading to 0.1 deg."""
    tables = _table_sources(setup, found)
    if setup.sensors("accelerometer", "inclinometer"):
        tables.append({"id": "gravity", "gravity_ppm": 10.0})
    if setup.sensors("fog"):
        tables.append({"id": "fog_axis", "axis_u_arcsec": 60.0, "axis_v_arcsec": 60.0})
    if setup.sensors("gyro", "fog") and setup.site.latitude_deg is not None and setup.rig.axes:
        tables.append({"id": "latitude", "latitude_deg": 0.01})
        if "base.azimuth" not in found.parameters:
            tables.append({"id": "heading", "heading_deg": 0.1})
    return [SourceTable.model_validate(t) for t in tables]


def _table_sources(setup: Setup, found: Calibration) -> list[dict[str, Any]]:
    """Levelling, index errors and wobble of a table, 3 arcsec each, rectangular."""
    tables: list[dict[str, Any]] = []
    # with base.roll the table's own tilt is the measurand
    if setup.rig.axes and "base.roll" not in found.parameters:
        sizes = {"tilt_east_arcsec": 3.0, "tilt_north_arcsec": 3.0}
        tables.append({"id": TableLevelling.id, **sizes})
    for axis in setup.rig.axis_names if setup.rig.axes else ():
        tables.append({"id": IndexError_.id, "axis": axis, "sigma_arcsec": 3.0})
        sizes = {"m1c_arcsec": 3.0, "m1s_arcsec": 3.0}
        tables.append({"id": AxisWobble.id, "axis": axis, **sizes})
    return [{**table, "distribution": "rectangular"} for table in tables]


def sources(tables: Iterable[SourceTable], setup: Setup, stops: Sequence[Segment]) -> list[Source]:
    """One source a parameter of each table.

    Raises:
        TiltcalError: an id or parameter is unknown.
    """
    found = []
    for k, table in enumerate(tables, start=1):
        for key, size in (table.model_extra or {}).items():
            shifts, unit = _shifts(table, key, setup, stops, f"budget {k}")
            where = table.axis or table.sensor
            stem = key.removesuffix(f"_{unit}")
            named = f"{table.id}{f'[{where}]' if where else ''}"
            words = named if stem == table.id else f"{named} {stem}"
            found.append(Source(words, float(size), unit, table.distribution, shifts))
    return found


def _shifts(
    table: SourceTable, key: str, setup: Setup, stops: Sequence[Segment], subject: str
) -> tuple[tuple[Shift, ...], str]:
    """What one parameter of a table changes, and its unit."""
    name, suffix = split_unit(key, PARAMETER_UNITS)
    unit = suffix or ""
    factor = PARAMETER_UNITS[unit].factor
    if table.id == "gravity":
        return (lambda size, r, s: (with_gravity_error(r, s, size * factor), s),), unit
    if table.id in SETUP_SOURCES:
        return (
            lambda size, r, s: (r, _changed_setup(s, table.id, name, size * factor, subject)),
        ), unit
    effect = _effect(table, key, setup, subject)
    if table.id != IndexError_.id:
        return (lambda size, r, s: (with_effect(r, s, _scaled(effect, size)), s),), unit
    # index errors are drawn at each stop: there each is an error of the encoder's zero
    axis = effect.axis or setup.rig.axis_names[0]
    zero = make_effect(EncoderZero.id, {f"{axis}_zero_arcsec": 1.0}, setup, subject=subject)
    at_stops = tuple(
        (lambda size, r, s, stop=stop: (with_effect(r, s, _scaled(zero, size), stop), s))
        for stop in stops
    )
    return at_stops, unit


def _effect(table: SourceTable, key: str, setup: Setup, subject: str) -> Effect:
    """The effect behind a source, at the size of one unit."""
    try:
        return make_effect(
            table.id, {key: 1.0}, setup, sensor=table.sensor, axis=table.axis, subject=subject
        )
    except TiltcalError as error:
        if "unknown effect" in error.found:
            raise TiltcalError(
                subject,
                found=f"source '{table.id}'",
                need="an effect, or one of gravity, " + ", ".join(SETUP_SOURCES),
                do=nearest(table.id, ["gravity", *SETUP_SOURCES]),
            ) from error
        raise


def _scaled(effect: Effect, size: float) -> Effect:
    return replace(effect, values={n: v * size for n, v in effect.values.items()})


def _changed_setup(setup: Setup, id: str, name: str, size: float, subject: str) -> Setup:
    """The set-up with one of its statements changed by ``size``, SI."""
    if id == "latitude":
        latitude = (setup.site.latitude_deg or 0.0) + np.degrees(size)
        return _with_site(setup, latitude_deg=float(latitude))
    if id == "heading":
        stated = 0.0 if setup.site.heading_deg == "unknown" else setup.site.heading_deg
        return _with_site(setup, heading_deg=float(stated + np.degrees(size)))
    if name not in ("axis_u", "axis_v"):
        raise TiltcalError(
            subject,
            found=f"parameter '{name}' of fog_axis",
            need="axis_u or axis_v",
            do="correct it",
        )
    sensors = []
    for s in setup.sensor:
        if s.kind == "fog":
            across = transverse(s.input_vector)[0 if name == "axis_u" else 1]
            axis = tuple(float(a) for a in s.input_vector + size * across)
            s = s.model_copy(update={"input_axis": axis})
        sensors.append(s)
    return setup.model_copy(update={"sensor": tuple(sensors)})


def _with_site(setup: Setup, **changed: float) -> Setup:
    return setup.model_copy(update={"site": setup.site.model_copy(update=changed)})
