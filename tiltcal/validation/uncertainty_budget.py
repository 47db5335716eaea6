"""The uncertainty budget in the form of the GUM: each source is propagated through the method
itself.

A source of standard uncertainty u changes the recording (an effect of the catalogue, by the
difference that it makes to the predicted readings) or the set-up (gravity, latitude, heading, the
FOG's axis) by +u and by -u, and the method runs on both: half the difference of each parameter is
its contribution. The covariance of the method, from the noise of the record, is the type A line.
Combined: root sum of squares; expanded: k = 2.

Source: JCGM 100:2008 (GUM), 5.1.3 note 2 (numerical sensitivities); JCGM 101 (the Monte Carlo that
checks it).

The usual sources of a laboratory are listed here, with what one standard uncertainty of each
changes.
"""

import inspect
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tiltcal.calibration.methods.registry import Method, calibrate, find_method
from tiltcal.calibration.result import Calibration
from tiltcal.core.arrays import Array, Mask
from tiltcal.core.errors import TiltcalError, nearest
from tiltcal.core.frames import force_of_tilt, tilt_of_force
from tiltcal.core.progress import Progress, Rate, silent
from tiltcal.core.units import PARAMETER_UNITS, split_unit
from tiltcal.effects import make_effect
from tiltcal.effects.base import Effect, SignalEffect
from tiltcal.effects.sense import Sense
from tiltcal.effects.sensor.gyro import transverse
from tiltcal.effects.table.geometry import AxisWobble, TableLevelling
from tiltcal.effects.table.readout import EncoderZero, SettingScatter
from tiltcal.forward.signal_chain import readings
from tiltcal.laboratory.scenario_tables import SourceTable
from tiltcal.laboratory.sensor_columns import to_column
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.replay import replay
from tiltcal.recordings.segmentation import Segment, dwells, find_segments
from tiltcal.setup.setup import Setup

Readings = dict[str, Array]
"""By sensor, SI, (n, k)."""


def with_gravity_error(recording: Recording, setup: Setup, size: float) -> Recording:
    """The recording in a gravity larger by the share ``size``: forces, and so sines of tilts, are
    larger in proportion.
    """
    columns = {n: recording.column(n) for n in recording.column_names}
    for sensor in setup.sensors("accelerometer", "inclinometer"):
        if not recording.has(sensor):
            continue
        samples = recording.sensor(sensor)
        moved = samples.values * (1 + size)
        if sensor.kind == "inclinometer":
            g = setup.site.gravity
            moved = tilt_of_force(force_of_tilt(samples.values, g) * (1 + size), g)
        for i, axis in enumerate(sensor.axes):
            name = str(recording.channel(f"{sensor.name}_{axis}"))
            changed = to_column(sensor, moved, str(split_unit(name)[1]), False)
            columns[name] = columns[name].copy()
            columns[name][samples.rows] = changed[:, i]
    return _like(recording, columns)


def _like(recording: Recording, columns: dict[str, Array]) -> Recording:
    return Recording.from_columns(
        recording.time,
        columns,
        labels=recording.labels,
        metadata=dict(recording.metadata),
        source=recording.source,
    )


def with_effect(
    recording: Recording, setup: Setup, effect: Effect, stop: Segment | None = None
) -> Recording:
    """The recording plus the difference that an effect makes to its readings.

    Args:
        recording: to change.
        setup: it was made with.
        effect: of the catalogue.
        stop: where the effect acts; everywhere unless given.
    """
    predict = _predicted_on_table if setup.rig.axes else _predicted_by_hand
    with_, without, known = predict(recording, setup, effect)
    columns = {n: recording.column(n) for n in recording.column_names}
    inside = np.ones(len(recording), bool)
    if stop is not None:
        inside[:] = False
        inside[stop.first : stop.last] = True
    for sensor in (setup.named(n) for n in with_):
        for i, axis in enumerate(sensor.axes):
            name = str(recording.channel(f"{sensor.name}_{axis}"))
            unit = str(split_unit(name)[1])
            after = to_column(sensor, with_[sensor.name], unit, False)[:, i]
            before = to_column(sensor, without[sensor.name], unit, False)[:, i]
            columns[name] = columns[name] + np.where(inside & known, after - before, 0.0)
    return _like(recording, columns)


def _predicted_on_table(
    recording: Recording, setup: Setup, effect: Effect
) -> tuple[Readings, Readings, Mask]:
    """Predicted readings with and without an effect, and the rows where the table was read."""
    course = replay(recording, setup)
    times = {s.name: recording.time for s in setup.sensor if recording.has(s)}
    after, before = (readings(setup, course, times, effects) for effects in ([effect], []))
    return after, before, course.known


def _predicted_by_hand(
    recording: Recording, setup: Setup, effect: Effect
) -> tuple[Readings, Readings, Mask]:
    """The same without a table: the readings of a sensor are used as its true input (their errors
    are of second order here).
    """
    if not isinstance(effect, SignalEffect):
        raise TiltcalError(
            f"budget, {effect.id}",
            found="a hand-held instrument",
            need="an effect of a sensor, or gravity, fog_axis",
            do="leave it out",
        )
    sensor = setup.named(str(effect.sensor))
    plain = Sense.at_rest(
        sensor, setup.site.gravity, _readings_at_rows(recording, setup, "accelerometer")
    )
    temperature = recording.temperature()
    warm = np.zeros(len(recording)) if temperature is None else temperature - temperature.mean()
    sense = replace(
        plain,
        time=recording.time,
        elapsed=recording.time - recording.time[0],
        rate=_readings_at_rows(recording, setup, "gyro"),
        temperature=warm,
        input_vector=sensor.input_vector if sensor.kind == "fog" else plain.input_vector,
    )
    moved = effect.apply(sense.true_input(), sense, None)
    return {sensor.name: moved}, {sensor.name: sense.true_input()}, np.ones(len(recording), bool)


def _readings_at_rows(recording: Recording, setup: Setup, kind: str) -> Array:
    """Readings of the first sensor of a kind at every row, body axes, (n, 3); zero where there is
    none.
    """
    found = np.zeros((len(recording), 3))
    for sensor in [s for s in setup.sensors(kind) if recording.has(s)][:1]:
        samples = recording.sensor(sensor)
        for i, axis in enumerate(sensor.axis_indices):
            known = ~np.isnan(samples.values[:, i])
            found[:, axis] = np.interp(
                recording.time, samples.time[known], samples.values[known, i]
            )
    return found


SETUP_SOURCES = ("latitude", "heading", "fog_axis")
DIVISOR = {"normal": 1.0, "rectangular": np.sqrt(3), "expanded": 2.0}
Shift = Callable[[float, Recording, Setup], tuple[Recording, Setup]]
"""What a source does: (standard uncertainties, recording, set-up) -> both, changed."""


@dataclass(frozen=True)
class Source:
    """One line of the budget.

    Args:
        name: as text.
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
        tables.append({"id": SettingScatter.id, "axis": axis, "sigma_arcsec": 3.0})
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
            text = named if stem == table.id else f"{named} {stem}"
            found.append(Source(text, float(size), unit, table.distribution, shifts))
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
    if table.id != SettingScatter.id:
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


COVERAGE = 2.0  # k of the expanded uncertainty


@dataclass(frozen=True)
class Line:
    """What a source contributes.

    Args:
        name, kind: as text; A (from the record's own noise) or B.
        size, unit, distribution, standard: as in ``Source``; of the type A line text only.
        contributions: parameter -> standard uncertainty it contributes, in the parameter's unit.
    """

    name: str
    kind: str
    size: float
    unit: str
    distribution: str
    standard: float
    contributions: dict[str, float]

    def sensitivity(self, parameter: str) -> float:
        """Change of a parameter per unit of the source; of several stops, their root sum of
        squares.
        """
        return self.contributions[parameter] / self.standard if self.standard else 1.0


@dataclass(frozen=True)
class UncertaintyBudget:
    """All lines; ``units``: of each parameter."""

    lines: tuple[Line, ...]
    units: dict[str, str]

    @property
    def combined(self) -> dict[str, float]:
        """Combined standard uncertainty of each parameter."""
        return {
            n: float(np.sqrt(sum(line.contributions[n] ** 2 for line in self.lines)))
            for n in self.units
        }

    @property
    def expanded(self) -> dict[str, float]:
        """Expanded uncertainty, k = 2."""
        return {n: COVERAGE * u for n, u in self.combined.items()}

    def to_json(self) -> dict[str, Any]:
        """For CAL.json's reader and for machines."""
        return {
            "lines": [{**vars(line)} for line in self.lines],
            "combined": self.combined,
            "expanded": self.expanded,
            "coverage_factor": COVERAGE,
            "units": self.units,
        }


def make_budget(
    method: str | Method,
    recording: Recording,
    setup: Setup,
    tables: Sequence[SourceTable] = (),
    *,
    progress: Progress = silent,
    **options: Any,
) -> tuple[Calibration, UncertaintyBudget]:
    """A calibration and its budget; without ``tables`` a laboratory's usual ones
    (``usual_sources``).

    Args:
        method: its name, or a function.
        recording, setup: what it is called with.
        tables: the stated sources.
        progress: receives how many runs of the method are left, and how long they take.
        options: of the method.

    Raises:
        TiltcalError: a source is unknown, or does not fit the set-up.
    """
    if "segments" in inspect.signature(find_method(method)).parameters:
        # the same dwells whatever is changed
        options.setdefault("segments", find_segments(recording))
    found = calibrate(method, recording, setup, **options)
    stops = dwells(options.get("segments") or ())
    lines = [_type_a(found)]
    wanted = list(sources(tables or usual_sources(setup, found), setup, stops))
    rate = Rate(2 * sum(len(source.shifts) for source in wanted))

    def run(changed: Recording, under: Setup) -> Calibration:
        again = calibrate(method, changed, under, **options)
        progress(f"uncertainty budget: {rate.after_one(0)}")
        return again

    lines += [_propagated(source, found, run, recording, setup) for source in wanted]
    return found, UncertaintyBudget(tuple(lines), {n: e.unit for n, e in found.parameters.items()})


def _type_a(found: Calibration) -> Line:
    sigmas = {n: e.sigma for n, e in found.parameters.items()}
    return Line("noise of the record", "A", 0.0, "", "normal", 0.0, sigmas)


def _propagated(
    source: Source,
    found: Calibration,
    run: Callable[[Recording, Setup], Calibration],
    recording: Recording,
    setup: Setup,
) -> Line:
    total = dict.fromkeys(found.parameters, 0.0)
    u = source.standard
    for shift in source.shifts:
        up, down = (run(*shift(size, recording, setup)) for size in (u, -u))
        for name in total:
            total[name] += ((up.value(name) - down.value(name)) / 2) ** 2
    contributions = {n: float(np.sqrt(v)) for n, v in total.items()}
    return Line(source.name, "B", source.size, source.unit, source.distribution, u, contributions)
