"""Laboratories: who makes recordings, a simulated one or a real table."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol, runtime_checkable

import numpy as np

from tiltcal import __version__
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.effects.base import DelayEffect, Effect, SignalEffect, WritingEffect
from tiltcal.effects.events import active_in
from tiltcal.effects.sense import Sense
from tiltcal.forward.kinematics import closed_form
from tiltcal.forward.signal_chain import CONVERSION, Mover, readings, streams_of
from tiltcal.laboratory.hand_motion import smoothed_readings
from tiltcal.laboratory.handheld import predicted_readings
from tiltcal.laboratory.long_recordings import (
    Stamps,
    first_stamps,
    in_pieces,
    piece_stamps,
    require_recordable,
    whole,
    works_in_pieces,
)
from tiltcal.laboratory.scenario import Scenario
from tiltcal.laboratory.sensor_columns import columns_like, sensor_columns
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.replay import Replay, replay
from tiltcal.setup.setup import Setup
from tiltcal.setup.tables import CHANNEL
from tiltcal.setup.trajectory import Course, Drive, Jet

# fingerprint of a recording that does not exist yet: events that were seen in another are over
NEW = ""


class Laboratory(Protocol):
    """Makes recordings."""

    def record(self, scenario: Scenario, seed: int | None = None) -> Recording:
        """A recording of the scenario's sequence; ``seed`` None: without random effects and
        quantisation.
        """

    def predict(
        self,
        scenario: Scenario,
        motion: Recording,
        seed: int | None = None,
        by_others: bool = False,
    ) -> Recording:
        """Prediction of ``motion`` by the model: its stamps and readout replayed."""


@dataclass(frozen=True)
class SimulatedLaboratory:
    """A laboratory that runs the effects of a scenario; this one moves by the closed form.

    Args:
        mover: what turns angles into motion.
    """

    mover: Mover = field(default=closed_form)

    def course(self, scenario: Scenario, seed: int | None) -> Course:
        """The scenario's schedule, prescribed.

        Raises:
            TiltcalError: it has ``[dynamics]``.
        """
        if scenario.dynamics is not None:
            raise TiltcalError(
                f"scenario {scenario.name}",
                found="[dynamics]",
                need="a laboratory with mechanics",
                do="use the MuJoCo one",
            )
        return scenario.schedule

    def record(self, scenario: Scenario, seed: int | None = None) -> Recording:
        """A recording of the scenario's sequence."""
        course, stamps = self._sampled(scenario, seed)
        effects = active_in(scenario.effects, NEW)
        changes = first_stamps(scenario, stamps)
        return self._recorded(scenario, course, whole(stamps), effects, seed, changes)

    def record_pieces(self, scenario: Scenario, seed: int | None = None) -> Iterator[Recording]:
        """The same recording piece by piece where it is long and its effects allow it, otherwise
        in one piece.
        """
        course, stamps = self._sampled(scenario, seed, in_parts=True)
        effects = active_in(scenario.effects, NEW)
        changes = first_stamps(scenario, stamps)
        if not works_in_pieces(scenario, stamps):
            require_recordable(scenario)
            yield self._recorded(scenario, course, whole(stamps), effects, seed, changes)
            return
        going = in_pieces(scenario, effects, stamps, seed)
        for own in piece_stamps(stamps):
            yield self._recorded(scenario, course, own, going, seed, changes)

    def _sampled(
        self, scenario: Scenario, seed: int | None, in_parts: bool = False
    ) -> tuple[Course, dict[str, Stamps]]:
        """What the table does, and when each sensor is sampled.

        Raises:
            TiltcalError: there is no sensor, or the recording is over the budget.
        """
        if not scenario.sensor:
            raise TiltcalError(
                f"scenario {scenario.name}",
                found="no sensors",
                need="at least one [[sensor]]",
                do="add one",
            )
        require_recordable(scenario, in_one_go=not in_parts)
        course = self.course(scenario, seed)
        return course, {s.name: Stamps.between(*course.times, s.rate_hz) for s in scenario.sensor}

    def _recorded(
        self,
        scenario: Scenario,
        course: Course,
        own: dict[str, Array],
        effects: Sequence[Effect],
        seed: int | None,
        changes: Array,
    ) -> Recording:
        """What is recorded at the stamps of each sensor, ``own``; mountings and labels change at
        ``changes``, of the whole recording.
        """
        values = readings(scenario, course, own, effects, seed=seed, mover=self.mover)
        time = own[scenario.sensor[0].name]
        for one in own.values():
            if not np.array_equal(one, time):
                time = np.union1d(time, one)
        drive = course.drive(time)
        columns = scenario.rig.kind.columns(written_readout(scenario.effects, drive))
        for sensor in scenario.sensor:
            rows = np.searchsorted(time, own[sensor.name])
            columns |= sensor_columns(sensor, values[sensor.name], rows, len(time), seed)
        columns["temperature_degC"] = drive.temperature
        return Recording.from_columns(
            written_stamps(scenario.effects, time),
            columns,
            labels=scenario.schedule.labels(time)
            if any(scenario.schedule.labels(changes))
            else None,
            metadata=_metadata(scenario, seed) | _mountings(scenario, changes),
            source=f"recording of {scenario.name}",
        )

    def predict(
        self,
        scenario: Scenario,
        motion: Recording,
        seed: int | None = None,
        by_others: bool = False,
    ) -> Recording:
        """Prediction of ``motion`` by the model.

        Args:
            scenario: the model.
            motion: its readout, or its readings where it is hand-held, is the motion.
            seed: of the noise that is added; None: no noise.
            by_others: hand-held, predict each sensor from the others alone. Otherwise its own
                readings count as well, which leaves less noise but follows its errors.
        """
        effects = active_in(scenario.effects, motion.fingerprint)
        if not scenario.rig.axes:
            hand_held = predicted_readings if by_others else smoothed_readings
            values = hand_held(scenario, motion.require_increasing(), effects)
        else:
            course = restored(replay(motion, scenario, scenario.climate.reference_degC), effects)
            times = {s.name: motion.time for s in scenario.sensor}
            values = readings(scenario, course, times, effects, seed=seed, mover=self.mover)
            for value in values.values():
                value[~course.known] = np.nan
        columns: dict[str, Array] = {}
        for sensor in scenario.sensor:
            if sensor.name in values:
                columns |= columns_like(sensor, values[sensor.name], motion, seed)
        kept = {
            n: motion.column(n)
            for n in motion.column_names
            if n.startswith((CHANNEL, "temperature_"))
        }
        metadata = dict(motion.metadata) | _metadata(scenario, seed) | {"predicts": motion.source}
        return Recording.from_columns(
            motion.time,
            kept | columns,
            labels=motion.labels,
            metadata=metadata,
            source="prediction",
        )

    def true_up(self, scenario: Scenario, seed: int | None, time: Array) -> Array:
        """The world's up in the body frame at these instants of ``record``, (n, 3): what an
        estimator should have found.
        """
        geometry = [
            e
            for e in scenario.effects
            if not isinstance(e, SignalEffect | DelayEffect | WritingEffect)
        ]
        return self.mover(
            scenario, self.course(scenario, seed).drive(time), geometry, streams_of(seed)
        ).up


@runtime_checkable
class TruthfulLaboratory(Laboratory, Protocol):
    """A laboratory that knows what truly happened: a simulated one."""

    def true_up(self, scenario: Scenario, seed: int | None, time: Array) -> Array:
        """The world's up in the body frame, (n, 3)."""


def written_readout(effects: Sequence[Effect], drive: Drive) -> dict[str, Array]:
    """The readout of each axis as the file has it, rad, (n,): what WritingEffects make of it."""
    found = {}
    for name, jet in drive.axes.items():
        angle = np.asarray(jet.x)
        for effect in effects:
            if isinstance(effect, WritingEffect) and not effect.is_identity:
                changed = effect.written(
                    name, replace(drive, axes={**drive.axes, name: Jet(angle, jet.v, jet.a)})
                )
                angle = angle if changed is None else changed
        found[name] = angle
    return found


def written_stamps(effects: Sequence[Effect], time: Array) -> Array:
    """The stamps as the file has them, s, (n,)."""
    for effect in effects:
        if isinstance(effect, WritingEffect) and not effect.is_identity:
            time = effect.stamps(time)
    return time


def restored(course: Replay, effects: Sequence[Effect]) -> Replay:
    """A replayed readout with known writing faults undone."""
    for effect in reversed(effects):
        if isinstance(effect, WritingEffect) and not effect.is_identity:
            angles = {
                n: effect.restored(n, course.time, angle) for n, angle in course.angles.items()
            }
            lost = [effect.undetermined(n, course.time, a) for n, a in course.angles.items()]
            course = course.with_angles(angles)
            for rows in lost:
                course = course if rows is None else replace(course, known=course.known & ~rows)
    return course


def _mountings(scenario: Scenario, time: Array) -> dict[str, str]:
    """The mountings of a recording as metadata, where they are not the stated one throughout."""
    mounts = scenario.schedule.mountings(time)
    if len(mounts) == 1 and mounts[0][1] == scenario.rig.mount:
        return {}
    parts = (text if row == 0 else f"{time[row]:.6g} s: {text}" for row, text in mounts)
    return {"mount": "; ".join(parts)}


def _metadata(scenario: Scenario, seed: int | None) -> dict[str, str]:
    return {
        "scenario": scenario.name,
        "seed": "none (noise off)" if seed is None else str(seed),
        "made by": f"tiltcal {__version__}",
    }


def true_readings(setup: Setup, up: Array, effects: Sequence[Effect]) -> dict[str, Array]:
    """Readings of accelerometers and inclinometers at rest by their own effects, without noise.

    Args:
        setup: site, rig, sensors.
        up: unit vectors in the body frame, (n, 3).
        effects: those that act on a sensor are used.
    """
    found = {}
    for sensor in setup.sensors("accelerometer", "inclinometer"):
        sense = Sense.at_rest(sensor, setup.site.gravity, setup.site.gravity * up)
        reading = sense.true_input()
        for effect in effects:
            if (
                isinstance(effect, SignalEffect)
                and effect.sensor == sensor.name
                and not effect.random
                and effect.order < CONVERSION
            ):
                reading = effect.apply(reading, sense, None)
        found[sensor.name] = reading
    return found
