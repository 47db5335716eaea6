"""Correcting a recording with a calibration, in fixed memory: piece in, piece out.

What came of correcting a stream: counts, and notes for the user.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from tiltcal.calibration.result import Calibration, setup_of, tilt_angles
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import force_of_tilt, tilt_of_force
from tiltcal.core.units import COLUMN_UNITS, DEG
from tiltcal.effects.curve_coordinates import coordinate_named
from tiltcal.effects.learned import Learned
from tiltcal.effects.sense import Sense
from tiltcal.instrument.temperature import (
    TemperatureCourse,
    TemperatureTerms,
    ThermalStream,
    at_rows,
    held,
)
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.samples import Samples
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup


@dataclass
class Corrected:
    """What came of a stream: rows written, readings of each axis left empty because its table does
    not hold there, the range of every channel, and curves that follow past moves.
    """

    rows: int = 0
    of_moves: tuple[str, ...] = ()
    beyond: dict[str, int] = field(default_factory=dict)
    range: dict[str, tuple[float, float]] = field(default_factory=dict)

    def count(self, chunk: Recording, added: dict[str, Array], calibration: Calibration) -> None:
        """Add a chunk. added: columns of the chunk, (n,) each."""
        self.rows += len(chunk)
        for name in added:
            self._widen(chunk, name)
        for key in calibration.bias_tables:
            name, _, axis = key.partition(".")
            sampled = np.isfinite(chunk.column(str(chunk.channel(f"{name}_{axis}"))))
            column = next(c for c in added if c.startswith(f"{name}_{axis}_corrected_"))
            self.beyond[key] = self.beyond.get(key, 0) + int(
                np.sum(sampled & np.isnan(added[column]))
            )

    def _widen(self, chunk: Recording, corrected: str) -> None:
        """Take up the least and the largest reading behind a corrected column."""
        name = chunk.channel(corrected.partition("_corrected_")[0])
        if "_corrected_" not in corrected or name is None:
            return
        values = chunk.column(name)
        if np.isfinite(values).any():
            low, high = self.range.get(name, (np.inf, -np.inf))
            self.range[name] = (
                min(low, float(np.nanmin(values))),
                max(high, float(np.nanmax(values))),
            )

    @property
    def notes(self) -> list[str]:
        """What the user should know."""
        notes = [
            f"{n} readings of {key} at placing angles that its table does not hold are left empty"
            for key, n in self.beyond.items()
            if n
        ]
        notes += [
            f"a curve follows {words}, which no stream tells: corrected as at a standstill"
            for words in self.of_moves
        ]
        dead = [name for name, (low, high) in self.range.items() if low == high]
        if dead and self.rows > 1:
            notes.append(f"{', '.join(dead)}: constant throughout, dead or disconnected")
        return notes


@dataclass(frozen=True)
class Force:
    """What an accelerometer triad reads where all its channels were sampled.

    Args:
        time: s, (n,); values: m/s2, (n, 3).
    """

    time: Array
    values: Array

    @classmethod
    def beside(cls, gyro: str, recording: Recording, setup: Setup) -> "Force":
        """That of the triad beside a gyro, by its name.

        Raises:
            TiltcalError: it has no triad.
        """
        triads = [s for s in setup.sensors("accelerometer") if len(s.axes) == 3]
        there = [s for s in triads if recording.has_columns(s)]
        if not there:
            raise _no_triad(recording, gyro)
        samples = recording.sensor(there[0])
        known = ~np.isnan(samples.values).any(axis=1)
        return cls(samples.time[known], samples.values[known])

    @classmethod
    def none(cls) -> "Force":
        """No reading."""
        return cls(np.zeros(0), np.zeros((0, 3)))

    def __getitem__(self, part: slice) -> "Force":
        return Force(self.time[part], self.values[part])

    def then(self, later: "Force") -> "Force":
        """These readings and later ones."""
        return Force(*(np.concatenate(two) for two in zip(self, later, strict=True)))

    def __iter__(self) -> Iterator[Array]:
        return iter((self.time, self.values))


@dataclass(frozen=True)
class Surroundings:
    """The recording around a piece of it.

    Args:
        began: its first stamp, s.
        before: the piece before; None of the first.
        after: the piece after; None of the last.
    """

    began: float
    before: Recording | None = None
    after: Recording | None = None

    def turn_rates(self, piece: Recording, setup: Setup) -> dict[str, Array]:
        """Rates of the table axes that were read, by the rows on either side, rad/s, (n,)."""
        return {
            axis: np.interp(piece.time, time, _central_rate(time, angle))
            for axis in setup.rig.axis_names
            for time, angle in [self._read(axis, piece)]
            if len(time)
        }

    def _read(self, axis: str, piece: Recording) -> tuple[Array, Array]:
        """When an axis was read, s, and where it was, rad, (m,) each: in the piece, and once before
        and after it.
        """
        parts = []
        for recording, rows in (
            (self.before, slice(-1, None)),
            (piece, slice(None)),
            (self.after, slice(1)),
        ):
            angle = None if recording is None else recording.table(axis)
            if recording is not None and angle is not None:
                read = np.flatnonzero(~np.isnan(angle))[rows]
                parts.append((recording.time[read], angle[read]))
        if not parts:
            return np.zeros(0), np.zeros(0)
        return np.concatenate([t for t, _ in parts]), np.concatenate([u for _, u in parts])


def _central_rate(time: Array, angle: Array) -> Array:
    """Rate of the parabola through a row and its neighbours, at the ends of the line to the only
    one, rad/s, (m,). As it depends on no other row, a piece has the rates of the whole to the bit:
    np.gradient takes another formula, of other rounding, where all steps are equal.

    Args:
        time: s, increasing, (m,).
        angle: rad, (m,).
    """
    if len(time) < 2:
        return np.zeros(len(time))
    step = np.diff(time)
    slope = np.diff(angle) / step
    inner = (slope[:-1] * step[1:] + slope[1:] * step[:-1]) / (step[1:] + step[:-1])
    return np.concatenate([slope[:1], inner, slope[-1:]])


def corrected_columns(
    recording: Recording,
    calibration: Calibration,
    setup: Setup,
    force: Force | None = None,
    course: TemperatureCourse | None = None,
    around: Surroundings | None = None,
) -> dict[str, Array]:
    """The columns that correction adds, full length: corrected readings in their own unit, and tilt
    where defined. (n,) each.

    ``<sensor>_<axis>_corrected_<unit>``, ``tilt_x_deg``, ``tilt_y_deg``.

    Args:
        recording: what is corrected.
        calibration: whose terms are taken away.
        setup: of the recording.
        force: what g-sensitivities follow; the recording's own unless given.
        course: of the temperature; the recording's own unless given.
        around: the recording that this is a piece of; none unless given.
    """
    columns: dict[str, Array] = {}
    g, around = setup.site.gravity, around or Surroundings(float(recording.time[0]))
    turn_rates = around.turn_rates(recording, setup)
    terms = temperature_terms(calibration, setup)
    if terms is not None and course is None:
        course = thermal_course(recording, ThermalStream(terms))
    for name in calibration.sensors():
        sensor = setup.named(name)
        samples = recording.sensor(sensor)
        values = (
            force_of_tilt(samples.values, g) if sensor.kind == "inclinometer" else samples.values
        )
        given = _given(recording, calibration, setup, sensor, samples, force)
        rates = {axis: rate[samples.rows] for axis, rate in turn_rates.items()}
        given = replace(given, elapsed=samples.time - around.began, turn_rates=rates)
        if course is not None:
            at = at_rows(course, samples.rows)
            warm = at.level - (calibration.of_sensor(sensor, g).reference_degC or 0.0)
            given = replace(given, temperature=warm, temperature_memory=at.memory)
        fixed = calibration.correct(sensor, values, g, given)
        shown = tilt_of_force(fixed, g) if sensor.kind == "inclinometer" else fixed
        for i, axis in enumerate(sensor.axes):
            unit = corrected_unit(samples.units[i], sensor)
            key = f"{name}_{axis}_corrected_{unit}"
            columns[key] = _full(
                shown[:, i] / COLUMN_UNITS[unit].factor, samples.rows, len(recording)
            )
        if sensor.is_accelerometer:
            angles = tilt_angles(fixed, sensor, g)
            # a level of two axes: what its z channel reads is not corrected
            if calibration.bias_tables:
                angles = {
                    axis: tilt_of_force(fixed[:, sensor.axes.index(axis)], g) for axis in angles
                }
            for axis, angle in angles.items():
                columns.setdefault(
                    f"tilt_{axis}_deg", _full(angle / DEG, samples.rows, len(recording))
                )
    return columns


def thermal_course(recording: Recording, stream: ThermalStream) -> TemperatureCourse:
    """The course of a recording's temperature after what the stream has seen.

    Raises:
        TiltcalError: it has no temperature.
    """
    name = recording.channel("temperature")
    if name is None:
        raise TiltcalError(
            recording.source,
            found="no temperature",
            need="a column temperature_degC: the calibration is one over temperature",
            do="record it, or use another calibration",
        )
    return stream.course(recording.time, recording.column(name))


def temperature_terms(calibration: Calibration, setup: Setup) -> TemperatureTerms | None:
    """The terms over temperature of a calibration's sensors, which all follow one course; None
    where it has none.
    """
    for name in calibration.sensors():
        sensor = setup.named(name)
        terms = calibration.of_sensor(sensor, setup.site.gravity).temperature_terms(sensor)
        if terms is not None:
            return terms
    return None


def _given(
    recording: Recording,
    calibration: Calibration,
    setup: Setup,
    sensor: Sensor,
    samples: Samples,
    force: Force | None,
) -> Sense:
    """What is known at the samples of a sensor in addition to the reading: temperature and table
    angles where they are recorded, and the force that a gyro's bias follows, by the accelerometer
    triad recorded with it.
    """
    time, rows = samples.time, samples.rows
    model = calibration.of_sensor(sensor, setup.site.gravity)
    given = Sense.at_rest(sensor, model.gravity, np.zeros((len(time), 3)))
    given = replace(given, time=time)
    reference = model.reference_degC
    if (name := recording.channel("temperature")) is not None and reference is not None:
        given = replace(given, temperature=held(recording.column(name))[rows] - reference)
    angles = {a: recording.table(a) for a in setup.rig.axis_names}
    given = replace(given, angles={a: held(v)[rows] for a, v in angles.items() if v is not None})
    if model.follows_force(sensor) is None:
        return given
    force = Force.beside(sensor.name, recording, setup) if force is None else force
    if not len(force.time):
        raise _no_triad(recording, sensor.name)
    along = [np.interp(time, force.time, force.values[:, i]) for i in range(3)]
    return replace(given, force=np.column_stack(along))


def _no_triad(recording: Recording, gyro: str) -> TiltcalError:
    return TiltcalError(
        recording.source,
        found=f"no accelerometer triad with {gyro}",
        need="the force its g-sensitivity follows",
        do="record one, or calibrate without gsens",
    )


def corrected_unit(written: str, sensor: Sensor) -> str:
    """The unit of the reading, or SI where it was raw."""
    known = COLUMN_UNITS[written].quantity
    return (
        written
        if known != "raw"
        else {"acceleration": "m_s2", "angle": "deg", "rate": "rad_s"}[sensor.quantity]
    )


def _full(values: Array, rows: "np.ndarray[tuple[int], np.dtype[np.intp]]", n: int) -> Array:
    full = np.full(n, np.nan)
    full[rows] = values
    return full


def correct_pieces(
    pieces: Iterable[Recording], calibration: Calibration, write: Callable[[Recording], None]
) -> Corrected:
    """Correct a recording piece by piece.

    Args:
        pieces: of one recording, in order.
        calibration: with the set-up it was made with.
        write: takes each piece with the columns of ``corrected_columns`` added.

    Raises:
        TiltcalError: the recording lacks the calibrated sensor.
    """
    setup = setup_of(calibration)
    curves = [e for e in calibration.effects if isinstance(e, Learned)]
    followed = [coordinate_named(e.coordinate) for e in curves]
    of_moves = dict.fromkeys(one.words for one in followed if one.follows == "move")
    done = Corrected(of_moves=tuple(of_moves))
    terms = temperature_terms(calibration, setup)
    stream = None if terms is None else ThermalStream(terms)
    for piece, force, around in _with_surroundings(_with_force(pieces, calibration, setup)):
        course = None if stream is None else thermal_course(piece, stream)
        added = corrected_columns(piece, calibration, setup, force, course, around)
        write(piece.with_columns(added))
        done.count(piece, added, calibration)
    return done


def _with_force(
    pieces: Iterable[Recording], calibration: Calibration, setup: Setup
) -> Iterator[tuple[Recording, Force | None]]:
    """Each piece, and the force to interpolate within it: from the last reading of the triad before
    it to the first one after it. A piece waits for that one.
    """
    gyros = [setup.named(n) for n in calibration.sensors()]
    g = setup.site.gravity
    pulled = [s.name for s in gyros if calibration.of_sensor(s, g).follows_force(s) is not None]
    if not pulled:
        yield from ((piece, None) for piece in pieces)
        return
    last, waiting = Force.none(), list[tuple[Recording, Force]]()
    for piece in pieces:
        now = Force.beside(pulled[0], piece, setup)
        if len(now.time):
            for earlier, force in waiting:
                yield earlier, last.then(force).then(now[:1])
                last = force[-1:] if len(force.time) else last
            waiting = []
        waiting.append((piece, now))
    for piece, force in waiting:
        yield piece, last.then(force)
        last = force[-1:] if len(force.time) else last


def _with_surroundings(
    pieces: Iterable[tuple[Recording, Force | None]],
) -> Iterator[tuple[Recording, Force | None, Surroundings]]:
    """Each piece with its force and those around it. A piece waits for the next one."""
    began, before, waiting = 0.0, None, None
    for coming in pieces:
        if waiting is None:
            began = float(coming[0].time[0])
        else:
            yield *waiting, Surroundings(began, before, coming[0])
            before = waiting[0]
        waiting = coming
    if waiting is not None:
        yield *waiting, Surroundings(began, before)
