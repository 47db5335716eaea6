"""Uncertain references: what one standard uncertainty of each stated source changes in the
readings of a sensor.

The readings are predicted with the source at plus and at minus one standard uncertainty; half the
difference is its column. An error that is drawn at each stop has one column for each.

Source: JCGM 100:2008 (GUM), 5.1.3 note 2 (numerical sensitivities).
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Self

import numpy as np

from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.core.errors import TiltcalError, nearest
from tiltcal.core.frames import force_of_tilt, tilt_of_force
from tiltcal.core.units import PARAMETER_UNITS, split_unit
from tiltcal.effects import make_effect
from tiltcal.effects.base import AngleEffect, DelayEffect, Effect, FrameEffect, SignalEffect
from tiltcal.effects.environment.world import GravityMagnitude
from tiltcal.effects.sense import Sense
from tiltcal.effects.sensor.gyro import FogAxisError
from tiltcal.effects.table.readout import EncoderZero, SettingScatter
from tiltcal.forward.kinematics import closed_form
from tiltcal.forward.signal_chain import CONVERSION, make_sense, readings
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.replay import replay
from tiltcal.recordings.samples import Samples
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.setup.sources import SourceTable
from tiltcal.setup.trajectory import Drive
from tiltcal.statistics.least_squares import CommonErrors, no_common_errors

OF_SITE = ("latitude", "heading")
OTHER_NAMES = {
    "gravity": (GravityMagnitude.id, "gravity_", "gravity_error_"),
    "fog_axis": (FogAxisError.id, "", ""),
}
"""Sources that have a name of their own: effect, and the beginning of its key in both."""
DIVISOR = {"normal": 1.0, "rectangular": np.sqrt(3), "expanded": 2.0}


@dataclass(frozen=True)
class Source:
    """A reference with its uncertainty: one parameter of a ``[[budget]]`` table.

    Args:
        name: as text.
        size: as stated, in ``unit``, with its distribution.
        assumed: whether it stands in the budget only.
        effects: what one unit of it does to the readings; several are independent of each other.
        site: key of the statement about the site that it is an error of, if it is one.
        at_stops: whether it is drawn again at each stop.
    """

    name: str
    size: float
    unit: str
    distribution: str
    assumed: bool = False
    effects: tuple[Effect, ...] = ()
    site: str = ""
    at_stops: bool = False

    @property
    def standard(self) -> float:
        """Standard uncertainty, in ``unit``."""
        return float(self.size / DIVISOR[self.distribution])

    def models(self, setup: Setup, sign: float) -> Iterator[tuple[Setup, Effect | None]]:
        """The set-up and the effect with each of its independent errors at one standard
        uncertainty times ``sign``.
        """
        size = sign * self.standard
        if self.site:
            yield site_with_error(setup, self.site, size), None
        for effect in self.effects:
            values = {name: value * size for name, value in effect.values.items()}
            yield setup, replace(effect, values=values)


def sources_of(setup: Setup) -> tuple[Source, ...]:
    """One source a parameter of each ``[[budget]]`` table.

    Raises:
        TiltcalError: an id or parameter is unknown.
    """
    found = []
    for k, table in enumerate(setup.budget, start=1):
        for key, size in (table.model_extra or {}).items():
            unit = split_unit(key, PARAMETER_UNITS)[1] or ""
            where = table.axis or table.sensor
            stem = key.removesuffix(f"_{unit}")
            named = f"{table.id}{f'[{where}]' if where else ''}"
            name = named if stem == table.id else f"{named} {stem}"
            source = Source(name, float(size), unit, table.distribution, table.assumed)
            found.append(_bound(source, table, key, setup, f"budget {k}"))
    return tuple(found)


def _bound(source: Source, table: SourceTable, key: str, setup: Setup, subject: str) -> Source:
    """The source with what it does."""
    if table.id in OF_SITE:
        return replace(source, site=key)
    effect = _effect(table, key, setup, subject)
    if table.id != SettingScatter.id:
        return replace(source, effects=(effect,))
    # index errors are drawn at each stop: there each is an error of the encoder's zero
    axes = [table.axis] if table.axis else setup.rig.kind.turning
    zeros = tuple(
        make_effect(EncoderZero.id, {f"{axis}_zero_arcsec": 1.0}, setup, subject=subject)
        for axis in axes
    )
    factor = sum(effect.values.values()) / PARAMETER_UNITS["arcsec"].factor
    scaled = tuple(
        replace(zero, values={n: v * factor for n, v in zero.values.items()}) for zero in zeros
    )
    return replace(source, effects=scaled, at_stops=True)


def effect_of_source(id: str, key: str) -> tuple[str, str]:
    """Effect and key of a source that may have a name of its own."""
    effect, own, theirs = OTHER_NAMES.get(id, (id, "", ""))
    return effect, theirs + key.removeprefix(own) if own else key


def _effect(table: SourceTable, key: str, setup: Setup, subject: str) -> Effect:
    """The effect behind a source, at the size of one unit."""
    id, name = effect_of_source(table.id, key)
    try:
        return make_effect(
            id, {name: 1.0}, setup, sensor=table.sensor, axis=table.axis, subject=subject
        )
    except TiltcalError as error:
        if "unknown effect" in error.found:
            names = [*OTHER_NAMES, *OF_SITE]
            raise TiltcalError(
                subject,
                found=f"source '{table.id}'",
                need="an effect, or one of " + ", ".join(names),
                do=nearest(table.id, names),
            ) from error
        raise


def site_with_error(setup: Setup, key: str, size: float) -> Setup:
    """The set-up with its latitude or heading changed. key: with the unit of ``size``."""
    name, unit = split_unit(key, PARAMETER_UNITS)
    stated = getattr(setup.site, f"{name}_deg", None)
    stated = 0.0 if stated in (None, "unknown") else stated
    angle = size * PARAMETER_UNITS[unit or "rad"].factor
    changed = {f"{name}_deg": float(stated + np.degrees(angle))}
    return setup.model_copy(update={"site": setup.site.model_copy(update=changed)})


@dataclass(frozen=True)
class References:
    """The uncertain references of some readings.

    Args:
        sources: what was stated.
        owner: source of each column, (q,).
        columns: what one standard uncertainty adds to the readings, sensing form, SI, (q, m, k).
    """

    sources: tuple[Source, ...] = ()
    owner: Index = field(default_factory=lambda: np.zeros(0, np.intp))
    columns: Array = field(default_factory=lambda: np.zeros((0, 0, 0)))

    @property
    def fitted(self) -> Mask:
        """Columns that are part of the covariance, (q,): those of stated sources."""
        return np.array([not self.sources[s].assumed for s in self.owner], bool)

    def stated(self, shape: tuple[int, ...]) -> Array:
        """The columns that are part of the covariance, (q, m, k). shape: (m, k) of the readings."""
        return self.columns[self.fitted] if len(self.owner) else np.zeros((0, *shape))

    def at(self, rows: Mask | Index) -> Self:
        """Of some rows. rows: (m,) or their numbers."""
        return replace(self, columns=self.columns[:, rows]) if len(self.owner) else self

    def of(self, channels: Sequence[int], signs: "Array | Sequence[int] | None" = None) -> Self:
        """Of some channels, with another sign. channels: their numbers, (c,); signs: (c,)."""
        if not len(self.owner):
            return self
        columns = self.columns[:, :, list(channels)]
        return replace(self, columns=columns if signs is None else columns * np.array(signs))

    def whitened(self, whiten: Array) -> CommonErrors:
        """As errors common to the whitened readings. whiten: W of each row, (m, k, k)."""
        if not len(self.owner):
            return no_common_errors(whiten.shape[0] * whiten.shape[1])
        return self.common(np.einsum("mij,qmj->qmi", whiten, self.columns))

    def along(self, slopes: Array) -> CommonErrors:
        """As errors common to one function of each row. slopes: with the readings, (m, k)."""
        if not len(self.owner):
            return no_common_errors(len(slopes))
        return self.common(np.einsum("mj,qmj->qm", slopes, self.columns))

    def common(self, columns: Array) -> CommonErrors:
        """Whitened columns, (q, ...), as errors common to the observations."""
        return CommonErrors(columns.reshape(len(self.owner), -1).T, self.fitted)

    def shares(self, contributions: Array) -> Array:
        """Standard uncertainty by each source: the root sum of squares of its columns.

        Args:
            contributions: of each column to each parameter, (p, q).

        Returns:
            (p, sources)
        """
        each = np.arange(len(self.sources)) == self.owner[:, None]
        return np.asarray(np.sqrt(contributions**2 @ each))

    def turning(self, posterior: Array) -> tuple[tuple[Effect, ...], Array]:
        """Errors that turn the instrument, at what the readings say of them.

        Args:
            posterior: of each column, in its standard uncertainties, and its own, (2, q).

        Returns:
            The effects, and the error of each column, in its standard uncertainties, (q,); 0 of a
            column that turns nothing.
        """
        effects, values = [], np.zeros(len(self.owner))
        for number, (source, found) in enumerate(
            zip(self.sources, self.single(posterior), strict=True)
        ):
            turns = [e for e in source.effects if isinstance(e, AngleEffect | FrameEffect)]
            if found is not None and turns:
                size = found[0] * source.standard
                effects += [
                    replace(e, values={n: v * size for n, v in e.values.items()}) for e in turns
                ]
                values[self.owner == number] = found[0]
        return tuple(effects), values

    def single(self, posterior: Array | None) -> list[tuple[float, float] | None]:
        """Of each source what its columns have, where that is one that was fitted. posterior: of
        each column, (2, q).
        """
        found: list[tuple[float, float] | None] = []
        for number, source in enumerate(self.sources):
            own = np.flatnonzero(self.owner == number)
            usable = posterior is not None and len(own) == 1 and not source.assumed
            if usable and posterior is not None and posterior.shape[1] == len(self.owner):
                found.append((float(posterior[0, own[0]]), float(posterior[1, own[0]])))
            else:
                found.append(None)
        return found


NO_REFERENCES = References()


def references(
    setup: Setup, evaluate: Callable[[Setup, Effect | None], Array], stop: Index
) -> References:
    """The columns of all sources.

    Args:
        setup: with its ``[[budget]]`` tables.
        evaluate: what is observed under a set-up and an effect, one row an observation, (m, k).
        stop: number of the standstill of each observation, -1 in motion, (m,).

    Raises:
        TiltcalError: a source is unknown, or does not fit the set-up.
    """
    sources = sources_of(setup)
    columns, owner = [], []
    for number, source in enumerate(sources):
        pairs = zip(source.models(setup, 1.0), source.models(setup, -1.0), strict=True)
        for up, down in pairs:
            column = (evaluate(*up) - evaluate(*down)) / 2
            if source.at_stops:
                each = [
                    np.where((stop == k)[:, None], column, 0.0) for k in np.unique(stop[stop >= 0])
                ]
            else:
                each = [column]
            columns += each
            owner += [number] * len(each)
    if not columns:
        return References()
    return References(sources, np.array(owner, np.intp), np.array(columns))


@dataclass(frozen=True)
class Standstills:
    """Dwells at which the references of a sensor act.

    Args:
        sensor: which.
        drive: the table at each, one row a dwell; None where it was not read.
        sense: what the sensor senses at each, (m,) rows.
        errors: of the table, about which those of the references are counted.
    """

    sensor: Sensor
    drive: Drive | None
    sense: Sense
    errors: tuple[Effect, ...] = ()

    def reading(self, setup: Setup, effect: Effect | None) -> Array:
        """Predicted means in the sensing form, SI, (m, k).

        Raises:
            TiltcalError: the effect needs a table, and none was read.
        """
        sense, gravity = self.sense, setup.site.gravity
        if isinstance(effect, SignalEffect):
            return _read(self.sensor, sense, effect, gravity)
        if isinstance(effect, DelayEffect):
            return sense.true_input()
        if isinstance(effect, GravityMagnitude):
            force = sense.force * (1 + effect.value("gravity_error"))
            return replace(sense, force=force).true_input()
        if self.drive is None:
            if effect is not None:
                raise _without_table(effect.id)
            return sense.true_input()  # the site is in the readings already
        where = setup.seen_by(self.sensor)
        effects = self.errors if effect is None else (*self.errors, effect)
        motion = closed_form(where, self.drive, effects)
        moved = make_sense(self.sensor, where, motion, self.drive).true_input()
        return np.asarray(np.where(self.drive.known[:, None], moved, sense.true_input()))


def _read(sensor: Sensor, sense: Sense, effect: SignalEffect, gravity: float) -> Array:
    """What a sensor reads with one of its effects, sensing form, SI, (m, k)."""
    reading = sense.true_input()
    if effect.sensor != sensor.name or effect.random:
        return reading
    if sensor.kind != "inclinometer" or effect.order < CONVERSION:
        return effect.apply(reading, sense, None)
    return force_of_tilt(effect.apply(tilt_of_force(reading, gravity), sense, None), gravity)


def log_reader(
    recording: Recording,
    setup: Setup,
    sensor: Sensor,
    time: Array,
    by_kind: Mapping[str, Array],
) -> Callable[[Setup, Effect | None], Array]:
    """What predicts a sensor of a log under a set-up and an effect, sensing form, SI, (n, k).

    Args:
        recording: the log.
        setup: of the recording.
        sensor: which.
        time: at which it is predicted, s, (n,).
        by_kind: readings of each kind of sensor then, body axes, SI, (n, 3).
    """
    if setup.rig.axes:
        course = replay(recording, setup)

        def on_table(where: Setup, effect: Effect | None) -> Array:
            effects = () if effect is None else (effect,)
            return readings(where, course, {sensor.name: time}, effects)[sensor.name]

        return on_table
    warm = recording.temperature()
    warm = None if warm is None else np.interp(time, recording.time, warm)
    return Standstills(
        sensor, None, sense_without_table(sensor, setup, time, by_kind, warm)
    ).reading


@dataclass(frozen=True)
class ChangedRecording(Recording):
    """A recording with something added to the readings of some sensors.

    Args:
        added: by sensor, SI, one row for each of its samples, (n, k).
    """

    added: Mapping[str, Array] = field(default_factory=dict)

    @classmethod
    def of(cls, recording: Recording, added: Mapping[str, Array]) -> "ChangedRecording":
        """A recording with this added. added: by sensor, SI, (n, k) each."""
        own = {f.name: getattr(recording, f.name) for f in fields(recording)}
        return cls(**own, added=added)

    def sensor(self, sensor: Sensor) -> Samples:
        """The readings of one sensor with what is added to them."""
        samples = super().sensor(sensor)
        more = self.added.get(sensor.name)
        return samples if more is None else replace(samples, values=samples.values + more)


def _without_table(what: str) -> TiltcalError:
    return TiltcalError(
        f"budget, {what}",
        found="a hand-held instrument, or a table without a readout",
        need="an effect of a sensor, or gravity, fog_axis",
        do="leave it out",
    )


def sense_without_table(
    sensor: Sensor,
    setup: Setup,
    time: Array,
    readings: Mapping[str, Array],
    temperature: Array | None,
) -> Sense:
    """What a sensor senses where no table was read: its readings are used as its true input (their
    errors are of second order here).

    Args:
        sensor: which.
        setup: of the recording.
        time: s, (n,).
        readings: of each kind of sensor, body axes, SI, (n, 3).
        temperature: degC, (n,); None: not recorded.
    """
    n = len(time)
    force = readings.get("accelerometer", np.zeros((n, 3)))
    plain = Sense.at_rest(sensor, setup.site.gravity, force)
    warm = np.zeros(n) if temperature is None else temperature - np.nanmean(temperature)
    return replace(
        plain,
        time=time,
        elapsed=time - time[:1].sum(),
        rate=readings.get("gyro", np.zeros((n, 3))),
        temperature=warm,
        input_vector=sensor.input_vector if sensor.kind == "fog" else plain.input_vector,
    )
